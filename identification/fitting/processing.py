"""Which pipeline a recording goes through, and its processed stretches."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from identification.errors import RecordingError, UndeterminedParametersError
from identification.fitting.settings import FitSettings
from identification.recordings.joint_choice import for_robot
from identification.recordings.recording import Recording
from identification.robots import RobotModel
from identification.signals.alike import notes_on_alike, one_of_alike
from identification.signals.aperiodic import process_aperiodic
from identification.signals.paper_chain import process_as_in_paper
from identification.signals.periodic import PeriodicSettings, process_periodic
from identification.signals.periods import period_table
from identification.signals.processed import ProcessedSignals

SMALLEST_MOTION = 1e-3
"""rad (m); a joint that moves less stands still."""


@dataclass(frozen=True, slots=True)
class Processed:
    """A recording's stretches in the order of time, the pipeline they went through, and sentences on what was done."""

    recording: Recording
    pipeline: str
    stretches: tuple[ProcessedSignals, ...]
    notes: tuple[str, ...]


def check_recording(recording: Recording, robot: RobotModel) -> None:
    """Raises RecordingError if the torque is in another unit, nothing moves, or what moves has no measured torque."""
    if recording.torque_unit != "Nm":
        raise RecordingError.named(
            recording.source.path,
            f"its torque is in {recording.torque_unit}; multiply each joint's current by its torque constant "
            "and gear ratio and import it in Nm",
            field="tau_unit",
        )
    travel = np.ptp(recording.position, axis=0)
    if float(travel.max()) < SMALLEST_MOTION:
        raise RecordingError.named(
            recording.source.path,
            f"no joint moves by more than {SMALLEST_MOTION} rad; parameters need a motion",
            field="q",
        )
    dead = [j for j in robot.driven if travel[j] >= SMALLEST_MOTION and np.ptp(recording.torque[:, j]) == 0.0]
    if dead:
        joints = ", ".join(str(joint + 1) for joint in dead)
        raise RecordingError.named(
            recording.source.path,
            f"the torque of joint {joints} never changes although the joint moves: it was not measured, or "
            "too coarsely, and the parameters of all joints would be bent to it",
            field="tau",
            joint=dead[0] + 1,
        )


@contextmanager
def naming_joints_at_rest(recordings: Sequence[Recording], robot: RobotModel) -> Iterator[None]:
    """Where parameters stay undetermined inside and joints stand still, each in one place: how to fit without them.

    The columns of such a joint's friction are zero, which no option that leaves parameters out takes away.
    """
    try:
        yield
    except UndeterminedParametersError as error:
        ends = np.array([(item.position.min(axis=0), item.position.max(axis=0)) for item in recordings])
        low, high = ends[:, 0].min(axis=0), ends[:, 1].max(axis=0)
        still = [joint for joint in robot.driven if high[joint] - low[joint] < SMALLEST_MOTION]
        if not still:
            raise
        locks = [f"--lock {robot.joint_names[j]}={0.5 * (low[j] + high[j]):z.4g}" for j in still]
        if any(item.joint_names is None for item in recordings):
            moving = [str(column) for column, joint in enumerate(robot.driven, 1) if joint not in still]
            locks.append(f"--joints {','.join(moving)}")
        which = ", ".join(str(joint + 1) for joint in still)
        one = len(still) == 1
        advice = (
            f"Joint{'' if one else 's'} {which} {'stands' if one else 'stand'} still: move {'it' if one else 'them'} "
            f"too, or fit without {'it' if one else 'them'}, {' '.join(locks)}."
        )
        raise UndeterminedParametersError(error.parameters, error.rank, error.size, advice) from error


def process(recording: Recording, robot: RobotModel, settings: FitSettings) -> Processed:
    """Check a recording against the robot and send it through the pipeline that the settings ask for.

    "auto": the periodic pipeline where the recording has periods, repeats with them and no split is asked for; else
    the aperiodic one, with a note why. Raises RecordingError when the recording cannot be used that way.
    """
    recording = for_robot(recording, robot)
    check_recording(recording, robot)
    whole = process_whole_periods(recording, settings)
    return process_without_periods(recording, settings) if whole is None else whole


def process_whole_periods(recording: Recording, settings: FitSettings) -> Processed | None:
    """The recording through the paper's or the periodic pipeline; None where it has to go through the aperiodic one."""
    if settings.split is not None and settings.pipeline in ("periodic", "paper"):
        raise RecordingError(
            f"The {settings.pipeline} pipeline fits whole periods and cannot be split by time; "
            "hold out another recording instead, or use the aperiodic pipeline"
        )
    recording = one_of_alike(_upright(recording, settings))
    alike = notes_on_alike(recording)
    if settings.pipeline == "paper":
        signals = process_as_in_paper(recording)
        return Processed(recording, "paper", (signals,), (*alike, *signals.facts["notes"]))
    if not _has_whole_periods(recording, settings):
        return None
    periodic = PeriodicSettings(settings.motion_bandwidth_hz, settings.torque_bandwidth_hz)
    try:
        signals = process_periodic(recording, periodic, bound_outliers=settings.estimator == "huber")
    except RecordingError as error:
        if settings.pipeline == "periodic" or error.field != "period_s":
            raise
        return None
    return Processed(recording, "periodic", (signals,), (*alike, *signals.facts["notes"]))


def process_without_periods(recording: Recording, settings: FitSettings) -> Processed:
    """The recording through the aperiodic pipeline, with a note where it states a period that does not hold."""
    recording = _upright(recording, settings)
    notes: tuple[str, ...] = ()
    if _has_whole_periods(recording, settings):
        try:
            period_table(recording)
        except RecordingError as error:
            notes = (f"{str(error).removeprefix(f'{recording.source.path}: ')}; used as not periodic",)
    stretches = process_aperiodic(recording, settings.low_pass_hz)
    return Processed(recording, "aperiodic", tuple(stretches), notes)


def _upright(recording: Recording, settings: FitSettings) -> Recording:
    return replace(recording, torque=-recording.torque) if settings.flip_torque else recording


def _has_whole_periods(recording: Recording, settings: FitSettings) -> bool:
    return settings.pipeline == "periodic" or (
        settings.pipeline == "auto" and recording.is_periodic and settings.split is None
    )


def process_stretches(recording: Recording, settings: FitSettings) -> tuple[ProcessedSignals, ...]:
    """Another measurement of a checked recording's motion through the pipeline of the settings, sign as it is."""
    if settings.pipeline == "paper":
        return (process_as_in_paper(recording),)
    if settings.pipeline == "periodic" or (settings.pipeline == "auto" and recording.is_periodic):
        return (
            process_periodic(recording, PeriodicSettings(settings.motion_bandwidth_hz, settings.torque_bandwidth_hz)),
        )
    return tuple(process_aperiodic(recording, settings.low_pass_hz))
