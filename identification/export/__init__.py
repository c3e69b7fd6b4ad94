"""Robots and models written for other programs to read."""

from __future__ import annotations

from identification.export.kinematic_urdf import kinematic_urdf

__all__ = ["kinematic_urdf"]
