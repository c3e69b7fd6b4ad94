"""Validation: a model on recordings that were not used for it, as in section 4.6 and Table 4 of the paper.

Here: RMS per joint of identified models on recordings. The split of one recording into fitted and held-out rows is a
setting of the fit (`Split`). Called by the command line (`validate`) and the demo.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from identification.base_parameters import BaseRegressor
from identification.fit import FitResult
from identification.fitting.blocks import Block, build_block, rms_over
from identification.fitting.processing import process
from identification.fitting.rms import RmsRow, RmsTable
from identification.fitting.settings import FitSettings, Split
from identification.model_file import Model
from identification.recordings.recording import Recording
from identification.robots import RobotModel

__all__ = ["RmsRow", "RmsTable", "Split", "validate_model"]

FloatArray = npt.NDArray[np.float64]
Progress = Callable[[str, float], None]


def validate_model(
    model: Model | FitResult,
    recordings: Sequence[Recording],
    settings: FitSettings | None = None,
    *,
    robot: RobotModel | None = None,
    progress: Progress | None = None,
) -> RmsTable:
    """RMS per joint of a model on each recording: lines "NAME, base" and, where the model has them, "NAME, physical".

    settings: which pipeline the recordings go through; default the one of the model's fit (cutoffs and sign included).
    robot: overrides the robot the model names. Periodic recordings are compared on their mean period without any
    filter; the others through the low-pass of the aperiodic pipeline, on rows in which the joint moves.
    Raises ModelFileError if the model is of another robot, RecordingError if a recording cannot be used.
    """
    if isinstance(model, FitResult):
        robot = robot if robot is not None else model.robot
        regressor = BaseRegressor(robot, model.regressor.options)
        sets = {"base": model.values}
        if model.constrained is not None:
            sets["physical"] = model.constrained.base_values
        chosen = settings if settings is not None else _of_fit(model.settings)
    else:
        robot = robot if robot is not None else model.load_robot()
        regressor = BaseRegressor(robot, model.options)
        sets = {"base": model.base_values(regressor)}
        physical = model.physical_base_values(regressor)
        if physical is not None:
            sets["physical"] = physical
        chosen = settings if settings is not None else _of_file(model)
    rows = []
    for number, recording in enumerate(recordings):
        name = Path(recording.source.path).name
        if progress is not None:
            progress(f"validating on {name}", number / len(recordings))
        blocks = _blocks(recording, robot, regressor, chosen)
        parts = [block.evaluation for block in blocks]
        floors = np.array([block.signals.noise_floor_nm for block in blocks])
        floor = np.sqrt(np.mean(floors**2, axis=0))
        torque = rms_over(parts, None)
        rows += [RmsRow(f"{name}, {label}", rms_over(parts, values), torque, floor) for label, values in sets.items()]
    return RmsTable(tuple(rows))


def _blocks(recording: Recording, robot: RobotModel, regressor: BaseRegressor, settings: FitSettings) -> list[Block]:
    stretches = process(recording, robot, settings).stretches
    built = [
        build_block(stretch, regressor, None, float(recording.time[0]), recording.duration_s) for stretch in stretches
    ]
    return [block for block in built if block is not None]


def _of_fit(settings: FitSettings) -> FitSettings:
    """The settings of a fit as far as they concern how a recording is processed."""
    return FitSettings(
        low_pass_hz=settings.low_pass_hz,
        motion_bandwidth_hz=settings.motion_bandwidth_hz,
        torque_bandwidth_hz=settings.torque_bandwidth_hz,
        flip_torque=settings.flip_torque,
    )


def _of_file(model: Model) -> FitSettings:
    noted = model.data.get("provenance", {}).get("settings", {})
    known = {
        name: noted[name]
        for name in ("low_pass_hz", "motion_bandwidth_hz", "torque_bandwidth_hz", "flip_torque")
        if name in noted
    }
    return FitSettings(**known)
