"""What leaps from one row to the next: angles that start anew after a whole turn, and rows that even time stamps hide.

Drivers of joints that turn without end report angles within one turn. A whole turn makes no torque, so it is put back.
Any other leap that no joint can make is a place where rows are missing, or where two recordings were joined. Pure
functions of arrays.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from identification.arrays import FloatArray, IntArray
from identification.errors import RecordingError
from identification.recordings.held import is_coarse
from identification.recordings.recording import Finding, Recording
from identification.robots.model import RobotModel

TURN = 2.0 * math.pi
NEAR_A_TURN = 1.0
"""rad that a leap may differ from a whole turn: what the joint itself turns between two rows."""
WITHIN_A_TURN = TURN + 0.1
"""rad that angles reported within one turn reach over, noise included; degrees that nobody stated reach further."""
NEIGHBOURING = 3.5
"""Sampling periods between two rows that nothing but rows left out stands between; in a longer gap a joint may turn."""
LEAST_RANGE = TURN - 0.02
"""rad between the limits of a joint whose angle may be reported within one turn."""
OVER_SPEED = 3.0
"""Times a joint's velocity limit that no row can show, noise and coarse stamps included."""
OVER_NEIGHBOURS = 10.0
"""Times the steps around it, and the joint's ordinary step, that a leap is: noise and a coarse encoder are less."""
NEIGHBOURS = 3
GAP_FACTOR = 1.5
"""Sampling periods: a longer step of the stamps is a gap, and hides no row."""
FEWEST_TWICE = 10
"""Rows that all joints reach by twice the step beside them, at least: recordings that lost none have not one."""
NEAR_TWICE = 0.2
"""Of the step beside, by which it may differ from twice that, all joints together."""
HIDDEN_GAPS = "hidden_gaps"
"""The kind of what is found of them."""
FASTEST_RAD_S = 100.0
"""Of a joint whose description has no limit."""


def with_whole_turns(recording: Recording, robot: RobotModel) -> Recording:
    """The recording with the angles of joints that turn without end continued beyond a turn, and findings that say so.

    Its columns are the robot's joints, or the driven ones of an arm with followers, in rad. Commanded and second
    positions of such joints are those within half a turn of the measured one.
    """
    joints = np.arange(robot.n) if recording.n == robot.n else np.array(robot.driven)
    lower, upper = robot.position_lower[joints], robot.position_upper[joints]
    # An empty range, or none that is a number, is no limit.
    limited = (lower < upper) & (upper - lower < LEAST_RANGE)
    endless = np.flatnonzero(robot.kinematics.revolute[joints] & ~limited)
    angles = recording.arrays(("position", "command_position", "link_position"))
    arrays: dict[str, Any] = {name: np.array(values) for name, values in angles.items()}
    findings = list(recording.report.findings)
    for column in endless:
        position = arrays["position"][:, column]
        turns, leaps = _turns(
            position, np.diff(recording.time), recording.sampling_period_s, _fastest(robot, joints[column])
        )
        position += TURN * turns
        for values in (arrays[name][:, column] for name in arrays if name != "position"):
            with np.errstate(invalid="ignore"):
                values += TURN * np.round((position - values) / TURN)
        if leaps.size:
            sentence = (
                f"joint {column + 1}: q starts anew after a whole turn, {leaps.size} time{'s' * (leaps.size > 1)} "
                f"(first at t = {recording.time[leaps[0] + 1]:.6g} s); it was continued"
            )
            rows = int(leaps[0]) + 2, int(leaps[-1]) + 2
            findings.append(Finding("whole_turns", *rows, int(leaps.size), sentence, int(column) + 1))
    report = replace(recording.report, findings=tuple(sorted(findings, key=lambda finding: finding.first_row)))
    return replace(recording, report=report, **arrays)


def rows_behind_hidden_gaps(time: FloatArray, position: FloatArray) -> IntArray:
    """Rows (from 0) that all joints together reach by twice the step of their neighbours, while the stamps are even.

    A row is missing before each. None where as many steps are one and a half: such are noise, and so is the rest. The
    slower half of the steps is not asked, nor a coarse encoder. time: (N,) s; position: (N, n) rad (m).
    """
    steps, elapsed = np.diff(position, axis=0), np.diff(time)
    size = np.sqrt((steps**2).mean(axis=0))
    if not size.any() or is_coarse(position[:, size > 0.0]):
        return np.zeros(0, dtype=np.int64)
    steps = steps[:, size > 0.0] / size[size > 0.0]
    a, b, c, d = steps[:-4], steps[1:-3], steps[3:-1], steps[4:]
    # The median of four is half way between those that are neither the largest nor the smallest.
    beside = 0.5 * (np.maximum(np.minimum(a, b), np.minimum(c, d)) + np.minimum(np.maximum(a, b), np.maximum(c, d)))
    speed = np.sqrt((beside**2).sum(axis=1))
    asked = (speed > np.median(speed)) & (elapsed[2:-2] < GAP_FACTOR * np.median(elapsed))

    def near(times: float) -> IntArray:
        off = np.sqrt(((steps[2:-2] - times * beside) ** 2).sum(axis=1))
        return np.flatnonzero(asked & (off < NEAR_TWICE * speed)) + 3

    twice = near(2.0)
    return twice if twice.size >= FEWEST_TWICE and twice.size > near(1.5).size else twice[:0]


def _turns(angle: FloatArray, elapsed: FloatArray, period_s: float, fastest: float) -> tuple[FloatArray, IntArray]:
    """(R,) whole turns to add to an angle (R,), and the rows (from 0) after which it leaps by one.

    elapsed: (R - 1,) s between the rows. None where the angle is not within one turn, as it was never reported so, nor
    across a gap in which the joint can have turned as far.
    """
    if np.ptp(angle) > WITHIN_A_TURN:
        return np.zeros(angle.size), np.zeros(0, dtype=np.int64)
    steps = np.diff(angle)
    impossible = (elapsed <= NEIGHBOURING * period_s) | (np.abs(steps) > OVER_SPEED * fastest * elapsed)
    leaps = np.flatnonzero((np.abs(np.abs(steps) - TURN) < NEAR_A_TURN) & impossible)
    turns = np.zeros(angle.size)
    turns[leaps + 1] = -np.sign(steps[leaps])
    return np.cumsum(turns), leaps


def _fastest(robot: RobotModel, joint: int) -> float:
    limit = float(robot.velocity[joint])
    return limit if 0.0 < limit < np.inf else FASTEST_RAD_S


def refuse_leaps(recording: Recording, robot: RobotModel) -> None:
    """Raises RecordingError where a joint leaps further than it can turn since it last moved, among smaller steps.

    Since it last moved: a log may be faster than its sensor, and holds each value for some rows.
    """
    for joint in range(recording.n):
        limit = _fastest(robot, joint)
        steps = np.abs(np.diff(recording.position[:, joint]))
        moved = np.flatnonzero(steps > 0.0)
        if not moved.size:
            continue
        since = np.diff(recording.time[np.concatenate([[0], moved + 1])])
        fast = moved[steps[moved] > OVER_SPEED * limit * np.maximum(since, recording.sampling_period_s)]
        ordinary = float(np.median(steps[moved]))
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
