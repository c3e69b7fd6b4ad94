"""Robots and models written for other programs to read: URDF, SDF and MJCF, each checked by reading it back."""

from __future__ import annotations

from identification.export.check import Agreement, check_export
from identification.export.effects import EffectsNote, effects_note
from identification.export.kinematic_urdf import kinematic_urdf
from identification.export.parameters import ModelParameters, parameters_of, principal_slack, refuse_inconsistent
from identification.export.write import FORMATS, ExportResult, export_model

__all__ = [
    "FORMATS",
    "Agreement",
    "EffectsNote",
    "ExportResult",
    "ModelParameters",
    "check_export",
    "effects_note",
    "export_model",
    "kinematic_urdf",
    "parameters_of",
    "principal_slack",
    "refuse_inconsistent",
]
