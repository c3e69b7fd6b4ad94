"""Where the numbers of a fit come from: inputs, robot, settings, versions, and one digest."""

from __future__ import annotations

import hashlib
import json
import platform
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from identification.arrays import FloatArray
from identification.base_parameters import WIDTH, BaseRegressor
from identification.fitting.processing import Processed
from identification.fitting.settings import FitSettings
from identification.model_file import SPEED
from identification.recordings.independence import prints_to_keep, rows_to_keep
from identification.robots import BUILT_IN_ROBOTS, RobotModel
from identification.robots.installation import FILE_BASE, PAPER_BASE
from identification.robots.same_arm import frames_of

WITHOUT_PART_IN_THE_BASE = ("physical", "bounds", "full_consistency", "starts", "seed", "check_torque_sign")
"""Settings that only the programs with constraints ask for, or none."""
LIBRARIES = ("iiwa-ident", "numpy", "scipy", "pin", "clarabel")


def provenance(
    processed: list[Processed],
    robot: RobotModel,
    regressor: BaseRegressor,
    settings: FitSettings,
    facts: dict[str, Any],
) -> dict[str, Any]:
    """Plain JSON types. facts: what the data chose of the nominal model, and on what grounds."""
    return {
        "inputs": [
            {
                "file": Path(item.recording.source.path).name,
                "sha256": item.recording.source.sha256,
                "kind": item.recording.source.kind,
                "samples": item.recording.samples,
                "samples_kept": prints_to_keep(item.recording),
                "rows_kept": rows_to_keep(item.recording),
                "pipeline": item.pipeline,
                "import_report": item.recording.report.to_json(),
                "stretches": [
                    {name: value for name, value in stretch.facts.items() if name != "notes"}
                    for stretch in item.stretches
                ],
            }
            for item in processed
        ],
        "robot": {
            "name": robot.name,
            "source": Path(robot.source).name,
            "digest": robot.digest,
            "gravity_m_s2": robot.gravity.tolist(),
            "gravity_frame": PAPER_BASE if robot.name in BUILT_IN_ROBOTS else FILE_BASE,
            "joints": frames_of(robot),
        },
        SPEED: _speed(processed).tolist(),
        "regressor": regressor.options.to_json(),
        "settings": settings.to_json(),
        "digest": _digest(processed, robot, regressor, settings),
        "seed": settings.seed,
        "versions": {"python": platform.python_version(), **{name: _version(name) for name in LIBRARIES}},
        **facts,
    }


def _speed(processed: list[Processed]) -> FloatArray:
    """(n,) rad/s (m/s), RMS of each joint's velocity over all that was fitted: friction is known at such speeds."""
    velocity = np.concatenate([stretch.velocity for item in processed for stretch in item.stretches])
    return np.asarray(np.sqrt((velocity**2).mean(axis=0)))


def _digest(processed: list[Processed], robot: RobotModel, regressor: BaseRegressor, settings: FitSettings) -> str:
    """SHA-256 of all that the base parameters follow from: inputs, robot, options and settings, but for rounding."""
    told = {name: value for name, value in settings.to_json().items() if name not in WITHOUT_PART_IN_THE_BASE}
    widths = [f"{width:.4g}" for width in np.ravel(regressor.options.coulomb_velocity)]
    options = {**regressor.options.to_json(), WIDTH: widths}
    inputs = [item.recording.source.sha256 for item in processed]
    text = json.dumps([inputs, robot.digest, options, told], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


@cache
def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"
