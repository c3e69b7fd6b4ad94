"""What leaps from one row to the next: angles that start anew after a whole turn, and rows that even time stamps hide.

Drivers of joints that turn without end report angles within one turn. A whole turn makes no torque, so it is put back.
Any other leap that no joint can make is a place where rows are missing, or where two recordings were joined. Pure
functions of arrays.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from identification.arrays import FloatArray, IntArray
from identification.errors import RecordingError
from identification.recordings.recording import Finding, Recording
from identification.recordings.table import RawTable
from identification.robots.model import RobotModel

TURN = 2.0 * math.pi
NEAR_A_TURN = 1.0
"""rad that a leap may differ from a whole turn: what the joint itself turns between two rows."""
WITHIN_A_TURN = TURN + 0.1
"""rad that angles reported within one turn reach over, noise included; degrees that nobody stated reach further."""
LEAST_RANGE = TURN - 0.02
"""rad between the limits of a joint whose angle may be reported within one turn."""
OVER_SPEED = 3.0
"""Times a joint's velocity limit that no row can show, noise and coarse stamps included."""
OVER_NEIGHBOURS = 10.0
"""Times the steps around it, and the joint's ordinary step, that a leap is: noise and a coarse encoder are less."""
NEIGHBOURS = 3
FASTEST_RAD_S = 100.0
"""Of a joint whose description has no limit."""


def with_whole_turns(table: RawTable, robot: RobotModel) -> RawTable:
    """The table with the angles of joints that turn without end continued beyond a turn, and a finding that says so.

    Columns are those of the robot's driven joints, in rad. Commanded and second positions stay within half a turn of
    the measured one.
    """
    driven = list(robot.driven)
    lower, upper = robot.position_lower[driven], robot.position_upper[driven]
    # An empty range, or none that is a number, is no limit.
    limited = (lower < upper) & (upper - lower < LEAST_RANGE)
    endless = robot.kinematics.revolute[driven] & ~limited
    position, optional, findings = table.position, dict(table.optional), list(table.findings)
    for joint in np.flatnonzero(endless):
        turns, leaps = _turns(table.position[:, joint])
        if not leaps.size:
            continue
        position = np.array(position) if position is table.position else position
        position[:, joint] += TURN * turns
        for name in ("command_position", "link_position"):
            if name in optional:
                optional[name] = values = np.array(optional[name])
                with np.errstate(invalid="ignore"):
                    values[:, joint] += TURN * np.round((position[:, joint] - values[:, joint]) / TURN)
        first, last = int(leaps[0]) + 2, int(leaps[-1]) + 2
        sentence = (
            f"joint {joint + 1}: q starts anew after a whole turn, {leaps.size} time{'s' * (leaps.size > 1)} (first at "
            f"row {first}); it was continued"
        )
        findings.append(Finding("whole_turns", first, last, int(leaps.size), sentence, int(joint) + 1))
    return replace(table, position=position, optional=optional, findings=findings)


def _turns(angle: FloatArray) -> tuple[FloatArray, IntArray]:
    """(R,) whole turns to add to an angle (R,), and the rows (from 0) before which it leaps by one.

    None where the angle is not within one turn: it was never reported so.
    """
    known = angle[np.isfinite(angle)]
    if not known.size or np.ptp(known) > WITHIN_A_TURN:
        return np.zeros(angle.size), np.zeros(0, dtype=np.int64)
    steps = np.diff(angle)
    with np.errstate(invalid="ignore"):
        leaps = np.flatnonzero(np.abs(np.abs(steps) - TURN) < NEAR_A_TURN)
    turns = np.zeros(angle.size)
    turns[leaps + 1] = -np.sign(steps[leaps])
    return np.cumsum(turns), leaps


def refuse_leaps(recording: Recording, robot: RobotModel) -> None:
    """Raises RecordingError where a joint leaps further between two rows than it can turn, among smaller steps."""
    period = np.maximum(np.diff(recording.time), recording.sampling_period_s)
    for joint in range(recording.n):
        limit = float(robot.velocity[joint]) if 0.0 < robot.velocity[joint] < np.inf else FASTEST_RAD_S
        steps = np.abs(np.diff(recording.position[:, joint]))
        fast = np.flatnonzero(steps > OVER_SPEED * limit * period)
        if not fast.size:
            continue
        ordinary = float(np.median(steps[steps > 0.0]))
        for row in fast:
            before, after = steps[max(row - NEIGHBOURS, 0) : row], steps[row + 1 : row + NEIGHBOURS + 1]
            around = max(float(before.max(initial=0.0)), float(after.max(initial=0.0)))
            if steps[row] > OVER_NEIGHBOURS * max(ordinary, around):
                _refuse(recording, robot, joint, int(row), float(steps[row]), limit)


def _refuse(recording: Recording, robot: RobotModel, joint: int, row: int, step: float, limit: float) -> None:
    unit = "rad" if robot.kinematics.revolute[joint] else "m"
    speed = step / (recording.time[row + 1] - recording.time[row])
    raise RecordingError(
        f"{Path(recording.source.path).name}: joint {joint + 1} leaps by {step:.3g} {unit} at t = "
        f"{recording.time[row + 1]:.6g} s, {speed:.3g} {unit}/s where it can {limit:.3g}: rows are missing there that "
        "the time stamps hide, or two recordings were joined. State the true times, or split the file there",
        file=recording.source.path,
        field="q",
        joint=joint + 1,
    )
