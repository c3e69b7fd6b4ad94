"""How a recording was made, asked without a model of the arm: gravity, signs, clock, units, order, rows, constancy,
one body, delay, load.

A verdict for each, in seconds. What in single rows and signs is wrong comes from `data_faults`, how the base stands
from the audit's `mount`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from identification.arrays import evenly
from identification.audit.comparison import LEAST_SIGMAS
from identification.audit.mount import Mounting, mounting_of
from identification.audit.otherwise import CHANGING, Otherwise, other_readings
from identification.audit.places import misplaced_joints
from identification.audit.reading import Reading, in_degrees
from identification.audit.rows import WIDEST_HZ
from identification.base_parameters import BaseRegressor, RegressorOptions
from identification.errors import RecordingError
from identification.fitting.result import FitResult
from identification.load_data import unknown_load
from identification.mismatch.data_faults.faults import clock_in_doubt, find_data_faults, upright
from identification.mismatch.findings import DataFault
from identification.mismatch.nominal import nominal_fit
from identification.mismatch.settings import DiagnosisSettings
from identification.recordings.clock import clock_by_velocity
from identification.recordings.independence import recording_names
from identification.recordings.recording import Recording
from identification.recordings.units import wrong_torque_unit
from identification.robots.model import RobotModel
from identification.signals.aperiodic import sixth_order_difference, zero_phase_low_pass

Status = Literal["ok", "warning", "failed"]

FAULTS = {
    "torque signs": (("inverted_torque_sign",), "Every torque sensor has the sign of the arm's own inertia."),
    "clock": (("wrong_time_base",), "Inertia and velocity go by the clock as stated."),
    "rows": (
        ("lost_samples", "garbled_rows", "saturated_sensor"),
        "No rows are lost, repeated or garbled, and no sensor is at its end or stands.",
    ),
}
LATEST_S = 0.005
"""A torque later than this shifts what a fit finds, where it shows."""
_LOAD_ROWS = 4000


@dataclass(frozen=True, slots=True)
class SetUpCheck:
    """One question to a recording: its name, the verdict, and a sentence."""

    name: str
    status: Status
    sentence: str


UNKNOWN_SIGNS = SetUpCheck("torque signs", "warning", "Signs cannot be told while joints are exchanged or turned.")
SIGNS_OF_PARTS = SetUpCheck("torque signs", "warning", "Signs cannot be told while a torque becomes another one.")
UNKNOWN_STAND = SetUpCheck(
    "gravity", "warning", "How the base stands cannot be told while joints are exchanged or turned."
)


def examine_set_up(recordings: Sequence[Recording], robot: RobotModel) -> tuple[SetUpCheck, ...]:
    """Every check of some recordings of one robot. Raises RecordingError for those that are too short or at rest."""
    fit = nominal_fit(recordings, robot, DiagnosisSettings())
    regressor = BaseRegressor(robot) if fit is None else fit.regressor
    faults = data_faults_of(recordings, robot, regressor)
    checks = set_up_checks(recordings, robot, [fault for own in faults for fault in own], _delay(fit))
    doubt = _clock_in_doubt([upright(*each) for each in zip(recordings, faults, strict=True)], regressor)
    return tuple(doubt if doubt and (each.name, each.status) == ("clock", "ok") else each for each in checks)


def data_faults_of(
    recordings: Sequence[Recording], robot: RobotModel, regressor: BaseRegressor
) -> tuple[tuple[DataFault, ...], ...]:
    """As `find_data_faults`; under the gravity that the recordings show where signs seem wrong under the stated one."""

    def turned(faults: Sequence[Sequence[DataFault]]) -> bool:
        return any(fault.fault == "inverted_torque_sign" for own in faults for fault in own)

    found = find_data_faults(recordings, regressor)
    if not turned(found):
        return found
    try:
        stand = mounting_of(recordings, robot)
    except RecordingError:  # too short to tell
        return found
    if stand is None or not stand.is_other:
        return found
    options = RegressorOptions(rotor_inertia=True, offset=True)
    there = find_data_faults(recordings, BaseRegressor(replace(robot, gravity=stand.gravity), options))
    return found if turned(there) else there


def set_up_checks(
    recordings: Sequence[Recording],
    robot: RobotModel,
    faults: Sequence[DataFault],
    delay: SetUpCheck | None = None,
    *,
    large: bool = True,
) -> tuple[SetUpCheck, ...]:
    """As `examine_set_up`, where the faults of the data are known already, and the delay, which needs a fit.

    large: whether the misfit is (`may_be_read_otherwise`), as far as it is known.
    """
    stand = mounting_of(recordings, robot)
    other = stand.gravity if stand is not None and stand.is_other else None
    misplaced = misplaced_joints(recordings, robot, other)
    order = _places(misplaced, faults)
    there = robot if other is None else replace(robot, gravity=other)
    turned = {fault.recording for fault in faults if fault.fault == "inverted_torque_sign"}
    named = [name in turned for name in recording_names(recordings)]
    asked = [] if order.status == "failed" else other_readings(recordings, there, named, large=large)
    read = [item for item in asked if item is not None]
    if there is not robot:  # a stand that was found is known to its interval only, and other bodies take the rest
        read = [item for item in read if item.kind == "changes"]
    if any(fault.fault == "wrong_time_base" for fault in faults):  # the clock is said by its own check
        read = [item for item in read if item.kind != "clock"]
    constancy = _constancy(read)
    checks = (
        UNKNOWN_STAND if misplaced is not None and misplaced.moves_motion else _gravity(stand),
        *(_of_faults(name, kinds, well, faults) for name, (kinds, well) in FAULTS.items()),
        _units(recordings, robot, gravity_acts=stand is not None),
        order,
        constancy,
        _one_body(read),
        *(() if delay is None else (delay,)),
        _load(recordings, robot),
        *_damaged_files(recordings),
    )
    unknown = UNKNOWN_SIGNS if order.status == "failed" else SIGNS_OF_PARTS if constancy.status == "failed" else None
    return tuple(
        unknown if unknown and (item.name, item.status) == (unknown.name, "failed") else item for item in checks
    )


def _places(misplaced: Reading | None, faults: Sequence[DataFault]) -> SetUpCheck:
    """Whether torques, positions and velocities stand under their own joints, none of which counts the other way."""
    if misplaced is not None:
        return SetUpCheck("order of joints", "failed", misplaced.sentence)
    order = "No torque goes clearly better with the motion of another joint."
    velocities = " ".join(fault.sentence for fault in faults if fault.fault == "wrong_joint_order")
    # No fit uses a recorded velocity.
    return SetUpCheck("order of joints", "warning" if velocities else "ok", f"{order} {velocities}".rstrip())


def _damaged_files(recordings: Sequence[Recording]) -> tuple[SetUpCheck, ...]:
    """A warning where bytes of a file are damaged or missing; of whole files nothing is said."""
    found = [
        f"{name}: {finding.sentence}."
        for recording, name in zip(recordings, recording_names(recordings), strict=True)
        for kind in ("truncated_file", "damaged_attachment")
        for finding in recording.report.of_kind(kind)
    ]
    return (SetUpCheck("file", "warning", " ".join(found)),) if found else ()


def _gravity(found: Mounting | None) -> SetUpCheck:
    if found is None:
        return SetUpCheck("gravity", "ok", "Gravity acts on no joint of this arm.")
    doubtful = found.contradicts and not found.tells
    return SetUpCheck("gravity", "failed" if found.is_other else "warning" if doubtful else "ok", found.sentence)


def _of_faults(name: str, kinds: Sequence[str], well: str, faults: Sequence[DataFault]) -> SetUpCheck:
    found = [fault for fault in faults if fault.fault in kinds]
    if not found:
        return SetUpCheck(name, "ok", well)
    # Rows that are lost are left out; what is read with the wrong sign or clock spoils everything.
    status: Status = "warning" if name == "rows" else "failed"
    return SetUpCheck(name, status, " ".join(fault.sentence for fault in found))


def _clock_in_doubt(recordings: Sequence[Recording], regressor: BaseRegressor) -> SetUpCheck | None:
    """A warning where another clock would do better, though physics that nobody has named would, too."""
    for recording, name in zip(recordings, recording_names(recordings), strict=True):
        # A recorded velocity that goes with the positions has the clock right.
        found = None if clock_by_velocity(recording) else clock_in_doubt(recording, regressor)
        if found is not None:
            return SetUpCheck(
                "clock",
                "warning",
                f"{name}: inertia goes better with gravity by a clock of {found[0]:.3g} ± {1.96 * found[1]:.2g} times "
                "the stated rate; physics beyond the model may look like that, too. Check the sampling rate.",
            )
    return None


def _units(recordings: Sequence[Recording], robot: RobotModel, *, gravity_acts: bool) -> SetUpCheck:
    degrees = [item for item in recordings if in_degrees(item, robot.kinematics.revolute) is not None]
    if degrees:
        return SetUpCheck("units", "failed", f"{degrees[0].source.path}: the positions are in degrees.")
    units = {recording.torque_unit for recording in recordings}
    if units != {"Nm"}:
        return SetUpCheck("units", "warning", f"The torque is in {', '.join(sorted(units))}: masses will be scaled.")
    span = max(float(np.ptp(item.position, axis=0).max()) for item in recordings)
    torque = max(float(np.abs(item.torque).max()) for item in recordings)
    if wrong := wrong_torque_unit(torque, robot, gravity_acts=gravity_acts):
        return SetUpCheck("units", "failed", wrong)
    doubts = [finding.sentence for item in recordings for finding in item.report.of_kind("unlikely_value")]
    if doubts:
        return SetUpCheck("units", "warning", f"{'; '.join(doubts)}.")
    return SetUpCheck("units", "ok", f"Positions span {span:.3g} rad and torques reach {torque:.3g} Nm, as stated.")


def _constancy(read: Sequence[Otherwise]) -> SetUpCheck:
    """Whether every torque is of one law throughout each recording. read: as what else they go better."""
    found = [item.sentence for item in read if item.kind in CHANGING]
    if not found:
        return SetUpCheck("constancy", "ok", "No torque becomes clearly another one within a recording.")
    return SetUpCheck("constancy", "failed", f"{'. '.join(found)}.")


def _one_body(read: Sequence[Otherwise]) -> SetUpCheck:
    """Whether zeros, scales, clock, signs and filters are as one rigid body has them."""
    found = [item.sentence for item in read if item.kind not in CHANGING]
    if not found:
        return SetUpCheck(
            "one body", "ok", "No other zero, scale, clock or filter goes far better with one rigid body."
        )
    return SetUpCheck("one body", "failed", f"{'. '.join(found)}.")


def _delay(fit: FitResult | None) -> SetUpCheck:
    if fit is None or not np.isfinite(fit.torque_delay.common):
        return SetUpCheck("late torque", "ok", "The motion does not tell whether the torque is late.")
    delay, half = fit.torque_delay.common, 1.96 * fit.torque_delay.std_between_joints
    which = "later" if delay > 0 else "earlier"
    said = f"The torque is {which} than the position by {1e3 * abs(delay):.1f} ± {1e3 * half:.1f} ms"
    # That there is a delay the joints tell together; by how much, only as well as they agree.
    if abs(delay) > LATEST_S and abs(delay) > LEAST_SIGMAS * fit.torque_delay.common_std:
        return SetUpCheck("late torque", "warning", f"{said}; friction beyond the model looks like that too.")
    return SetUpCheck("late torque", "ok", f"{said}.")


def _load(recordings: Sequence[Recording], robot: RobotModel) -> SetUpCheck:
    known = [item for item in recordings if item.external_torque is not None]
    if not known:
        return SetUpCheck("load data", "ok", "The recording has no external torque: load data cannot be judged by it.")
    recording = known[0]
    step = recording.sampling_period_s
    cutoff = min(WIDEST_HZ, 0.1 / step)
    q = zero_phase_low_pass(recording.position, step, cutoff)
    dq = sixth_order_difference(q, step)
    ddq = sixth_order_difference(dq, step)
    assert recording.external_torque is not None, "chosen above"
    chosen = evenly(len(q), _LOAD_ROWS)
    external = np.nan_to_num(recording.external_torque[chosen])
    found = unknown_load(robot, q[chosen], dq[chosen], ddq[chosen], external)
    if found is None:
        return SetUpCheck("load data", "ok", "The external torque shows no load that the cabinet does not know of.")
    whose = "lack" if found.mass > 0.0 else "have too much by"
    what = f"{whose} {abs(found.mass):.2g} kg at the flange" if found.weighs else "have the centre of the load wrong"
    return SetUpCheck(
        "load data",
        "failed",
        f"The cabinet's load data {what}: that explains {100.0 * found.share:.0f} % of the external torque.",
    )
