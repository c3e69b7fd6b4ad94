"""The cabinet's load data against its external torque, at the end of a run and in `doctor`.

Here: the samples, from the finished recording or from messages just heard, and the words. Not here: the fit
(`identification.load_data`). After a run it is called once the arm is at rest and the file is closed; what goes wrong
here costs nothing but the sentence.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np
from mcap.exceptions import McapError
from mcap.reader import make_reader

from daemon.api import RunOutcome, RunRequest
from daemon.doctor.host_checks import DoctorCheck
from daemon.log.cdr import state_counters
from daemon.motion.torque_foresight import TorqueForesight
from fri_client.messages import MonitoringMessage
from identification.arrays import FloatArray
from identification.errors import IdentificationError
from identification.load_data import LEAST_SHARE, UnknownLoad, moment_at_rest, unknown_load, weight_at_rest
from identification.mismatch.settings import DIFFERENT
from identification.robots import load_robot
from identification.robots.flange import IIWA_FLANGE
from identification.robots.installation import Installation
from safety.geometry import FLANGE_M

SPACING_S = 0.01
AT_REST_RAD = 1e-3
LEAST_MASS_AT_REST_KG = 0.5
"""Static friction of the joints alone looks like some hundred grams in one posture."""
LEAST_MESSAGES = 20
LEAST_TORQUE_NM = 2.0
"""Of such a mass; where it has less, friction hides it."""
LONGEST_S = 120.0
"""So much of a run settles it; an hour of it would only take longer."""
_STATE = struct.Struct("<4x35d")
"""The encapsulation, then measured position, torque, commanded position, torque and external torque, 7 each."""


def with_load_check(outcome: RunOutcome) -> RunOutcome:
    """The account of a run, with a sentence where the load data do not fit; unchanged where they do or none can say."""
    request = outcome.request
    if request is None or not outcome.samples_in_periods or not outcome.recordings:
        return outcome
    send_period_ms = (None if outcome.loop is None else outcome.loop.send_period_ms) or 1.0
    sentence = load_remark(Path(outcome.recordings[0]), request, 1e-3 * send_period_ms)
    return outcome if not sentence else msgspec.structs.replace(outcome, sentences=(*outcome.sentences, sentence))


def check_load_at_rest(messages: Sequence[MonitoringMessage]) -> DoctorCheck | None:
    """What the external torque of an arm at rest says of the load data; None where it moves or nothing is known.

    FRI does not say which arm of the family it is; both have nearly the same lengths, and the iiwa 14's are taken.
    """
    known = [
        (each.monitor_data.measured_joint_position, each.monitor_data.external_torque)
        for each in messages
        if each.monitor_data is not None and each.monitor_data.external_torque is not None
    ]
    positions, external = (np.array([row[place] for row in known], dtype=np.float64) for place in (0, 1))
    if (
        positions.shape[1:] != (7,)
        or external.shape != positions.shape
        or np.ptp(positions, axis=0).max() > AT_REST_RAD
    ):
        return None
    mean = external.mean(axis=0)
    mass, share, per_kilogram = weight_at_rest(load_robot("iiwa14"), positions.mean(axis=0), mean, FLANGE_M)
    worst = int(np.argmax(np.abs(mean)))
    seen = f"At rest the external torque is at most {abs(mean[worst]):.2f} Nm (A{worst + 1})"
    if per_kilogram * LEAST_MASS_AT_REST_KG < LEAST_TORQUE_NM:
        return DoctorCheck("load data", "ok", f"{seen}; in this posture a load hardly shows.")
    if abs(mass) >= LEAST_MASS_AT_REST_KG and share >= LEAST_SHARE:
        whose = (
            "that the cabinet does not know of" if mass > 0.0 else "that the cabinet believes in and that is not there"
        )
        what = f"about {abs(mass):.1f} kg on the flange {whose}"
    else:
        torque, chance = moment_at_rest(load_robot("iiwa14"), positions.mean(axis=0), mean)
        if torque < LEAST_TORQUE_NM or chance > DIFFERENT:
            return DoctorCheck("load data", "ok", f"{seen}: no sign of wrong load data.")
        what = "a load whose centre is not where the load data have it"
    return DoctorCheck(
        "load data",
        "warning",
        f"{seen}, as of {what}, or of somebody who leans on the arm.",
        "set the tool's load data on the cabinet, then look again with nobody near the arm.",
    )


def load_before_motion(
    positions: FloatArray, torques: FloatArray, request: RunRequest, foresight: TorqueForesight
) -> str:
    """What the measured torque of an arm at rest, (N, 7) rad and Nm with the vendor's sign, says of the declared tool;
    empty where it fits, where the arm moves or where a load hardly shows.

    A model is wrong by its own errors, and one posture cannot tell a load from a hand on the arm: only half a kilogram
    that explains most of what is left is worth a word.
    """
    if len(positions) < LEAST_MESSAGES or np.ptp(positions, axis=0).max() > AT_REST_RAD:
        return ""
    here = positions.mean(axis=0)
    stand = None if request.gravity_m_s2 is None else Installation(request.gravity_m_s2)
    left = torques.mean(axis=0) + foresight.at_rest(here)
    mass, share, per_kilogram = weight_at_rest(load_robot(request.robot, stand), here, left, FLANGE_M)
    if abs(mass) < LEAST_MASS_AT_REST_KG or share < LEAST_SHARE or per_kilogram * abs(mass) < LEAST_TORQUE_NM:
        return ""
    more, advice = (
        ("more", "give it with --tool, unless somebody leans on the arm.")
        if mass > 0.0
        else ("less", "mount it, or give with --tool what is there (none: nothing), unless somebody holds the arm up.")
    )
    worst = int(np.argmax(np.abs(left)))
    return (
        f"Before the motion the arm bears about {abs(mass):.1f} kg {more} on its flange than was declared (tool: "
        f"{request.tool}): its torque at rest is {abs(left[worst]):.1f} Nm from the predicted one on A{worst + 1}. "
        f"Torque limits, distances and the fit count with the declared tool: {advice}"
    )


def load_remark(recording: Path, request: RunRequest, send_period_s: float) -> str:
    """The sentence for a recording; empty where the load data fit, or where it cannot be read."""
    try:
        states = _motion_of(recording, send_period_s)
        if states is None:
            return ""
        stand = None if request.gravity_m_s2 is None else Installation(request.gravity_m_s2)
        found = unknown_load(load_robot(request.robot, stand), *states)
    except (OSError, McapError, struct.error, IdentificationError, np.linalg.LinAlgError):
        return ""
    return "" if found is None else load_sentence(found)


def load_sentence(found: UnknownLoad) -> str:
    """What was found and what to do about it."""
    worst = int(np.argmax(found.rms_before))
    return (
        f"The load data on the cabinet do not fit: its external torque is that {_difference(found)} "
        f"({found.rms_before[worst]:.2f} Nm RMS on A{worst + 1}, {found.rms_after[worst]:.2f} Nm without it). "
        "Set the tool's load data there: the limit on external torque and the robot's own control use them."
    )


def _difference(found: UnknownLoad) -> str:
    if not found.weighs:
        # About the flange, in its axes: where the load data are given.
        turn = np.column_stack([-IIWA_FLANGE.rotation.T @ IIWA_FLANGE.origin, IIWA_FLANGE.rotation.T])
        moment = turn @ np.array([found.mass, *found.moment])
        half = 1.96 * np.sqrt(np.diag(turn @ found.covariance @ turn.T))
        each = ", ".join(f"{value:.3f} ± {width:.3f}" for value, width in zip(moment, half, strict=True))
        return (
            f"of a load with another centre: its mass differs by {found.mass:.2f} ± "
            f"{1.96 * np.sqrt(found.covariance[0, 0]):.2f} kg from that in the load data, its first moment (mass times "
            f"centre, from the flange) by ({each}) kg m"
        )
    place = IIWA_FLANGE.point(found.center)
    where = f"({', '.join(f'{value:.2f}' for value in place)}) m from the flange"
    if found.mass > 0.0:
        return f"of {found.mass:.2f} kg at {where} that the cabinet does not know of"
    return f"of {-found.mass:.2f} kg at {where} that the cabinet believes in and that is not there"


def _motion_of(recording: Path, send_period_s: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray] | None:
    """q, dq, ddq and external torque every SPACING_S of the periods, (S, 7) each; None where there are too few.

    Velocity and acceleration are central differences of the neighbours; over a gap there are none.
    """
    step = max(1, round(SPACING_S / send_period_s))
    rows, counters = [], []
    with recording.open("rb") as stream:
        for _, _, message in make_reader(stream).iter_messages(topics=["/fri/state"]):
            _, counter, period = state_counters(message.data)
            if period < 0 or counter % step:
                continue
            rows.append(_STATE.unpack_from(message.data))
            counters.append(counter)
            if len(rows) * step * send_period_s > LONGEST_S:
                break
    if len(rows) < 3:
        return None
    table, spacing = np.array(rows), step * send_period_s
    q, external = table[:, :7], table[:, 28:35]
    whole = (np.diff(counters)[1:] == step) & (np.diff(counters)[:-1] == step)
    dq, ddq = (q[2:] - q[:-2]) / (2.0 * spacing), (q[2:] - 2.0 * q[1:-1] + q[:-2]) / spacing**2
    kept = whole & np.isfinite(external[1:-1]).all(axis=1) & np.isfinite(ddq).all(axis=1)
    return q[1:-1][kept], dq[kept], ddq[kept], external[1:-1][kept]
