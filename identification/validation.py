"""Validation: a model on recordings that were not used for it, as in section 4.6 and Table 4 of the paper.

Here: what base parameters leave of the torque of a recording (`torque_left`, for whoever compares models with
recordings), RMS per joint of identified models, and folds over recordings. The split of one recording into fitted and
held-out rows is a setting of the fit (`Split`). Effects of a model file: `mismatch.prediction`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from identification.arrays import FloatArray
from identification.base_parameters import BaseRegressor
from identification.errors import EstimationError
from identification.fitting.delay import earlier
from identification.fitting.processing import process
from identification.fitting.rms import RmsRow, RmsTable, rms_of_rows
from identification.fitting.settings import OF_SIGNALS, FitSettings, Progress
from identification.model_file import Model
from identification.recording_fit import FitResult, fit_recordings
from identification.recordings.independence import recording_names, refuse_repeated
from identification.recordings.recording import Recording
from identification.robots import RobotModel
from identification.signals.aperiodic import cutoff_as_far_as
from identification.signals.processed import ProcessedSignals


def validate_model(
    model: Model | FitResult,
    recordings: Sequence[Recording],
    *,
    robot: RobotModel | None = None,
    left_to: Sequence[Recording] | None = None,
) -> RmsTable:
    """RMS per joint of a model on each recording: lines "NAME, base" and, where the model has them, "NAME, physical".

    The recordings go through the pipeline of the model's fit, cutoffs and sign included. A torque that the fit took
    earlier is taken earlier here, too.
    robot: overrides the robot the model names. left_to: the recordings as the base parameters have to explain them,
    where the model predicts more (`mismatch.prediction`). Periodic recordings are compared on their mean period
    without any filter; the others through the low-pass of the aperiodic pipeline, on rows in which the joint moves.
    Raises ModelFileError if the model is of another robot, RecordingError if a recording cannot be used or comes twice.
    """
    refuse_repeated(recordings)
    if isinstance(model, FitResult):
        robot = robot if robot is not None else model.robot
        regressor = BaseRegressor(robot, model.regressor.options)
        sets = {"base": model.values}
        if model.constrained is not None:
            sets["physical"] = model.constrained.base_values
        noted, shift = model.settings.to_json(), model.torque_shift
    else:
        robot = robot if robot is not None else model.load_robot()
        regressor = BaseRegressor(robot, model.options)
        sets = {"base": model.base_values(regressor)}
        physical = model.physical_base_values(regressor)
        if physical is not None:
            sets["physical"] = physical
        noted, shift = model.data.get("provenance", {}).get("settings", {}), model.torque_shift(robot.n)
    rows = []
    names, left_to = recording_names(recordings), recordings if left_to is None else left_to
    for recording, remaining, name in zip(recordings, left_to, names, strict=True):
        settings = as_fitted(noted, recording)
        stretches = process(recording, robot, settings).stretches
        torque = rms_of_rows(measured_torque(stretches, robot, shift))
        if remaining is not recording:
            stretches = process(remaining, robot, settings).stretches
        left = torque_left(stretches, regressor, list(sets.values()), shift)
        floor = np.sqrt(np.mean([stretch.noise_floor_nm**2 for stretch in stretches], axis=0))
        rows += [
            RmsRow(f"{name}, {label}", rms_of_rows(each), torque, floor) for label, each in zip(sets, left, strict=True)
        ]
    return RmsTable(tuple(rows))


def measured_torque(stretches: Sequence[ProcessedSignals], robot: RobotModel, shift: FloatArray) -> FloatArray:
    """(E, n) Nm, the torque of processed stretches over time, each joint's taken earlier by its shift (n,) s.

    nan in rows in which a joint stands still, or follows another and has no torque of its own.
    """
    return np.concatenate([_evaluated(signals, _at_motion(signals, shift), robot) for signals in stretches])


def torque_left(
    stretches: Sequence[ProcessedSignals], regressor: BaseRegressor, sets: Sequence[FloatArray], shift: FloatArray
) -> tuple[FloatArray, ...]:
    """(E, n) Nm of each set of base parameters (p,): `measured_torque` minus what the set predicts.

    Both go through the filter of the stretch.
    """
    left: list[list[FloatArray]] = [[] for _ in sets]
    for signals in stretches:
        torque = _at_motion(signals, shift)
        columns = regressor.joint_columns(signals.position, signals.velocity, signals.acceleration)
        for values, parts in zip(sets, left, strict=True):
            predicted = np.column_stack([values[used] @ packed for packed, used in columns])
            parts.append(_evaluated(signals, torque - predicted, regressor.robot))
    return tuple(np.concatenate(parts) for parts in left)


def _at_motion(signals: ProcessedSignals, shift: FloatArray) -> FloatArray:
    return earlier(signals, shift).torque if shift.any() else signals.torque


def _evaluated(signals: ProcessedSignals, torque: FloatArray, robot: RobotModel) -> FloatArray:
    counts = signals.evaluated & np.isin(np.arange(robot.n), robot.driven)
    return np.where(counts, signals.evaluate(torque), np.nan)


def cross_validate(
    recordings: Sequence[Recording],
    robot: RobotModel,
    settings: FitSettings | None = None,
    folds: int | None = None,
    *,
    progress: Progress | None = None,
) -> RmsTable:
    """RMS per joint on each recording of a model that was fitted without it, then the mean square over all of them.

    folds: number K of groups, recording i in group i mod K; each group is scored by a fit of all the others. None
    leaves out one recording at a time. Lines as `validate_model` labels them, and last "all left out, base" (and
    "… physical"), in which every recording counts alike. Raises EstimationError for fewer than 2 folds or more folds
    than recordings, and what `fit_recordings` raises where the rest of the recordings cannot be fitted.
    """
    count = len(recordings) if folds is None else folds
    if not 2 <= count <= len(recordings):
        raise EstimationError(
            f"{count} folds over {len(recordings)} recordings are not possible; give at least two recordings and 2 to "
            f"{len(recordings)} folds"
        )
    of_recording: list[tuple[RmsRow, ...]] = [()] * len(recordings)
    for fold in range(count):
        if progress is not None:
            progress(f"fold {fold + 1} of {count}", fold / count)
        rest = [recording for i, recording in enumerate(recordings) if i % count != fold]
        result = fit_recordings(rest, robot, settings)
        for i in range(fold, len(recordings), count):
            of_recording[i] = validate_model(result, [recordings[i]]).rows
    labels = ("base", "physical")
    lines = [
        replace(row, label=f"{name}, {label}")
        for name, rows in zip(recording_names(recordings), of_recording, strict=True)
        for label, row in zip(labels, rows, strict=False)
    ]
    together = []
    for label, column in zip(labels, zip(*of_recording, strict=True), strict=False):
        rms, torque, floor = (
            np.sqrt(np.mean([getattr(line, name) ** 2 for line in column], axis=0))
            for name in ("rms_nm", "torque_rms_nm", "noise_floor_nm")
        )
        together.append(RmsRow(f"all left out, {label}", rms, torque, floor))
    return RmsTable((*lines, *together))


def as_fitted(noted: Mapping[str, Any], recording: Recording) -> FitSettings:
    """The settings of a fit as far as they concern how a recording is processed.

    A recording without whole periods goes through the pipeline for such ones, whatever the fitted ones had, and is
    compared up to what its rate allows.
    """
    pipeline = noted.get("pipeline", "auto")
    if noted.get("split") is not None:
        pipeline = "aperiodic"
    elif pipeline == "periodic" or not recording.is_periodic:
        pipeline = "auto"
    signals = {name: noted[name] for name in OF_SIGNALS if name in noted}
    signals["low_pass_hz"] = cutoff_as_far_as(signals.get("low_pass_hz"), recording.sampling_period_s)
    return FitSettings(pipeline=pipeline, **signals)
