"""The check of a whole table of commands before any of them is sent: `check` and `run` ask it, nothing moves without
it.

Lives here: the list of checks and the report. Lives elsewhere: the limits (limits.py), the stops (ramps.py,
braking.py), the distances (collision.py). Velocities and accelerations are the same finite differences that the guard
takes cycle by cycle, the seam of a periodic table included, so a table that passes here passes there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from safety.braking import stopping_travel
from safety.collision import Clearance, Workspace
from safety.errors import TrajectoryShapeError
from safety.geometry import SELF_COLLISION_MARGIN_M, WORKSPACE_MARGIN_M, RobotGeometry
from safety.guard import ACCELERATION_TOLERANCE, POSITION_TOLERANCE_RAD, VELOCITY_TOLERANCE
from safety.limits import FloatArray, JointLimits
from safety.preflight_distance import Distances, SampledPath, sample
from safety.preflight_report import Check, PreflightReport
from safety.ramps import RampError, plan_start_ramp, plan_stop_ramp

RAMP_SAMPLES_S = 0.02
"""Stops and the start ramp are sampled so densely; what they do in between is part of the bound on distances."""


def preflight(
    positions: FloatArray,
    sample_period_s: float,
    limits: JointLimits,
    *,
    torque: FloatArray | None = None,
    geometry: RobotGeometry | None = None,
    workspace: Workspace | None = None,
    self_collision_margin_m: float = SELF_COLLISION_MARGIN_M,
    workspace_margin_m: float = WORKSPACE_MARGIN_M,
    stop_stride: int = 10,
    start_row: int | None = None,
    start_position: ArrayLike | None = None,
) -> PreflightReport:
    """Check one period of a table of positions, (N, n) rad, sent one row per sample_period_s, again and again.

    torque: (N, n) Nm expected along the table, checked where given. geometry: shape of the arm, e.g.
    load_geometry("iiwa14"); None leaves out self-collision and workspace. stop_stride: without a geometry a stop is
    planned and checked at every so many rows only, and at the rows with least room, with one at every row; the closed
    form of braking.py is asked at every row.
    start_row: where a start ramp hands over to the table; with start_position (default: the mean of the table) the
    ramp is planned and checked as well.

    Raises TrajectoryShapeError for a table of the wrong shape or a period that is not above 0. Values that are not
    finite are an answer (check "finite"), not an error; the other checks are then left out.
    """
    table = np.asarray(positions, dtype=np.float64)
    n = limits.joint_count
    if table.ndim != 2 or table.shape[1] != n or table.shape[0] < 4:
        raise TrajectoryShapeError(f"The table has shape {table.shape}, but at least 4 rows of {n} joints are needed.")
    if not (math.isfinite(sample_period_s) and sample_period_s > 0.0):
        raise TrajectoryShapeError(f"The sample period is {sample_period_s} s, but it has to be above 0 s.")
    finite = _finite(table)
    if not finite.passed:
        return PreflightReport((finite,))
    motion = _Motion.of(table, sample_period_s, True, limits)
    checks = [
        finite,
        _position(table, limits),
        _magnitude("velocity", motion.velocity, limits.velocity, VELOCITY_TOLERANCE, "rad/s"),
        _magnitude("acceleration", motion.acceleration, limits.acceleration, ACCELERATION_TOLERANCE, "rad/s²"),
        _jerk(motion.jerk, limits),
    ]
    stops: FloatArray | None = None
    if all(check.passed for check in checks):
        checks.append(_stopping_velocity(motion, limits, sample_period_s))
        stop_check, stops = _stops(table, motion, limits, stop_stride if geometry is None else 1)
        checks.append(stop_check)
    starts: list[SampledPath] = []
    if start_row is not None:
        start_check, starts = _start(table, motion, limits, sample_period_s, start_row, start_position)
        checks.append(start_check)
    if torque is not None:
        checks.append(_torque(np.asarray(torque, dtype=np.float64), table, limits))
    clearances: tuple[Clearance, ...] = ()
    if geometry is not None:
        # A table outside its limits may still be looked at: the operator then learns all that is wrong at once.
        path = SampledPath(np.vstack([table, table[:1]]), sample_period_s)
        distances = Distances(geometry, workspace or Workspace(), limits, self_collision_margin_m, workspace_margin_m)
        found = [distances.check([path], "motion")]
        if stops is not None:
            found.append(distances.check_stops(stops, RAMP_SAMPLES_S))
        if starts:
            found.append(distances.check(starts, "start ramp"))
        for answers, closest in found:
            checks += answers
            clearances += closest
    return PreflightReport(tuple(checks), clearances)


def start_path(
    positions: FloatArray, sample_period_s: float, limits: JointLimits, start_row: int
) -> SampledPath | None:
    """The start ramp that the preflight of a repeated table looks at, from the mean of its rows to `start_row`.

    positions: (N, n) rad. None where no ramp fits.
    """
    motion = _Motion.of(positions, sample_period_s, True, limits)
    _, paths = _start(positions, motion, limits, sample_period_s, start_row, None)
    return paths[0] if paths else None


def stops_on_path(
    positions: FloatArray, sample_period_s: float, limits: JointLimits, stride: int
) -> tuple[Check, FloatArray | None]:
    """The stops of each joint on its own from a path that is driven once, such as a start ramp.

    positions: (N, n) rad, one row per sample_period_s. Planned from every `stride`-th row, as the loop would plan them
    there: whether they fit, and where they go, (rows, m, n) rad every RAMP_SAMPLES_S, None where one does not fit.
    """
    return _stops(positions, _Motion.of(positions, sample_period_s, False, limits), limits, stride)


@dataclass(frozen=True, slots=True)
class _Motion:
    """Finite differences of a table as the guard sees them at each row, (N, n); rows without a past are left out."""

    rows: NDArray[np.int64]
    """Table rows the differences belong to, (N,)."""
    velocity: FloatArray
    acceleration: FloatArray
    jerk: FloatArray
    at_velocity: FloatArray
    """Velocity at the row itself, third order, where the ramp hands over."""
    at_acceleration: FloatArray
    stop_velocity: FloatArray
    """State from which the guard would have a stop planned (braking.stopping_state)."""
    stop_acceleration: FloatArray

    @staticmethod
    def of(table: FloatArray, period: float, periodic: bool, limits: JointLimits) -> _Motion:
        if periodic:
            # Three rows of the period before: then every row has its past, and the seam is a row like any other.
            extended, rows = np.vstack([table[-3:], table]), np.arange(table.shape[0], dtype=np.int64)
        else:
            extended, rows = table, np.arange(3, table.shape[0], dtype=np.int64)
        velocity = np.diff(extended, axis=0) / period
        acceleration = np.diff(velocity, axis=0) / period
        jerk = np.diff(acceleration, axis=0) / period
        velocity, acceleration = velocity[2:], acceleration[1:]
        at_acceleration = acceleration + period * jerk
        at_velocity = velocity + 0.5 * period * acceleration + period**2 / 3.0 * jerk
        stop_velocity, stop_acceleration = _stopping_states(velocity, acceleration, limits, period)
        return _Motion(
            rows, velocity, acceleration, jerk, at_velocity, at_acceleration, stop_velocity, stop_acceleration
        )


def _stopping_states(
    velocity: FloatArray, acceleration: FloatArray, limits: JointLimits, period: float
) -> tuple[FloatArray, FloatArray]:
    """braking.stopping_state for whole arrays, (N, n); a test holds the two against each other."""
    now = velocity + 0.5 * period * acceleration
    remaining = now + acceleration * np.abs(acceleration) / (2.0 * limits.jerk)
    shift = np.clip(remaining / period, -limits.jerk * period, limits.jerk * period)
    start = np.clip(acceleration - shift, -limits.acceleration, limits.acceleration)
    return now + (start - acceleration) * period / 3.0, start


def _finite(table: FloatArray) -> Check:
    bad = np.argwhere(~np.isfinite(table))
    if bad.size == 0:
        return Check("finite", True, None, 0.0, 0.0, "", f"All {table.size} positions are finite numbers.")
    row, column = int(bad[0, 0]), int(bad[0, 1])
    sentence = (
        f"Row {row} of the table holds {table[row, column]} for joint {column + 1}; {len(bad)} of its positions are "
        "not finite numbers."
    )
    return Check("finite", False, column + 1, float(len(bad)), 0.0, "", sentence, row)


def _position(table: FloatArray, limits: JointLimits) -> Check:
    beyond = np.maximum(limits.position_lower - table, table - limits.position_upper)
    row, column = _where_largest(beyond)
    value = float(table[row, column])
    near_lower = limits.position_lower[column] - value >= value - limits.position_upper[column]
    limit = float((limits.position_lower if near_lower else limits.position_upper)[column])
    passed = bool(beyond[row, column] <= POSITION_TOLERANCE_RAD)
    side = "inside" if passed else "beyond"
    sentence = f"Joint {column + 1} comes to {value:.4f} rad in row {row}, {side} its limit of {limit:.4f} rad."
    if abs(value) > 2.0 * np.pi:  # no joint of an arm turns by more than once
        sentence += " Is the table in degrees?"
    return Check("position", passed, column + 1, value, limit, "rad", sentence, row)


def _magnitude(name: str, values: FloatArray, limit: FloatArray, tolerance: float, unit: str) -> Check:
    row, column = _where_largest(np.abs(values) / limit)
    value, bound = float(abs(values[row, column])), float(limit[column])
    sentence = (
        f"Joint {column + 1} reaches {value:.3f} {unit} in row {row}, {100.0 * value / bound:.1f} % of its {name} "
        f"limit of {bound:.3f} {unit}."
    )
    return Check(name, value <= bound * (1.0 + tolerance), column + 1, value, bound, unit, sentence, row)


def _jerk(jerk: FloatArray, limits: JointLimits) -> Check:
    row, column = _where_largest(np.abs(jerk) / limits.jerk)
    value, bound = float(abs(jerk[row, column])), float(limits.jerk[column])
    # Reported only: the limit is ours, and a table rounded to 1e-7 rad already shows 100 rad/s³ that nobody feels.
    sentence = (
        f"Joint {column + 1} reaches a jerk of {value:.1f} rad/s³ in row {row} (reported only; stops are planned with "
        f"{bound:.1f} rad/s³)."
    )
    return Check("jerk", True, column + 1, value, bound, "rad/s³", sentence, row)


def _stopping_velocity(motion: _Motion, limits: JointLimits, period: float) -> Check:
    peak = np.abs(
        motion.stop_velocity + motion.stop_acceleration * np.abs(motion.stop_acceleration) / (2.0 * limits.jerk)
    )
    allowed = limits.velocity * (1.0 + VELOCITY_TOLERANCE) + limits.jerk * period**2
    row, column = _where_largest(peak / allowed)
    value, limit, begins = float(peak[row, column]), float(limits.velocity[column]), int(motion.rows[row])
    sentence = (
        f"A stop that begins in row {begins} takes joint {column + 1} to {value:.3f} rad/s; its velocity "
        f"limit is {limit:.3f} rad/s."
    )
    passed = bool(value <= allowed[column])
    return Check("stopping_velocity", passed, column + 1, value, limit, "rad/s", sentence, begins)


def _stops(table: FloatArray, motion: _Motion, limits: JointLimits, stride: int) -> tuple[Check, FloatArray | None]:
    """The stop from every row in closed form, and planned by Ruckig at every stride-th row and at the tightest rows.

    The planned ones are sampled every RAMP_SAMPLES_S, (rows, m, n) rad; None where one of them does not fit.
    """
    here = table[motion.rows]
    room = np.empty_like(here)
    extreme = np.empty_like(here)
    acceleration_bound = np.maximum(limits.acceleration, np.abs(motion.stop_acceleration))
    for column in range(limits.joint_count):
        lower, upper = float(limits.position_lower[column]), float(limits.position_upper[column])
        jerk = float(limits.jerk[column])
        for row, (q, v, a, bound) in enumerate(
            zip(
                here[:, column].tolist(),
                motion.stop_velocity[:, column].tolist(),
                motion.stop_acceleration[:, column].tolist(),
                acceleration_bound[:, column].tolist(),
                strict=True,
            )
        ):
            highest = q + stopping_travel(v, a, bound, jerk)
            lowest = q - stopping_travel(-v, -a, bound, jerk)
            upwards = upper - highest <= lowest - lower
            extreme[row, column] = highest if upwards else lowest
            room[row, column] = upper - highest if upwards else lowest - lower
    row, column = _where_largest(-room)
    value = float(extreme[row, column])
    limit = float((limits.position_upper if value > table[:, column].mean() else limits.position_lower)[column])
    passed = bool(room[row, column] >= -POSITION_TOLERANCE_RAD)
    sentence = (
        f"The firmest stop takes joint {column + 1} no further than {value:.4f} rad (row {motion.rows[row]}); its "
        f"limit is {limit:.4f} rad."
    )
    tightest = np.argsort(room.min(axis=1))[:20]
    ramps = []
    for k in sorted({*range(0, here.shape[0], max(1, stride)), *tightest.tolist()}):
        try:
            ramps.append(plan_stop_ramp(here[k], motion.stop_velocity[k], motion.stop_acceleration[k], limits))
        except RampError as error:
            return _no_ramp("stop", error, f"No stop fits in row {motion.rows[k]}: {error}", int(motion.rows[k])), None
    times = np.arange(math.ceil(max(ramp.duration_s for ramp in ramps) / RAMP_SAMPLES_S) + 1) * RAMP_SAMPLES_S
    stops = np.array([[ramp.position_at(time) for time in times.tolist()] for ramp in ramps])
    return Check("stop", passed, column + 1, value, limit, "rad", sentence, int(motion.rows[row])), stops


def _start(
    table: FloatArray,
    motion: _Motion,
    limits: JointLimits,
    period: float,
    start_row: int,
    start_position: ArrayLike | None,
) -> tuple[Check, list[SampledPath]]:
    at = int(np.argmin(np.abs(motion.rows - start_row % table.shape[0])))
    begin = table.mean(axis=0) if start_position is None else np.asarray(start_position, dtype=np.float64)
    row = int(motion.rows[at])
    try:
        ramp = plan_start_ramp(
            begin, table[row], motion.at_velocity[at], motion.at_acceleration[at], limits, command_period_s=period
        )
    except RampError as error:
        return _no_ramp("start_ramp", error, str(error), row), []
    share = 100.0 * ramp.fraction
    sentence = f"A start ramp of {ramp.duration_s:.2f} s leads to row {row} at {share:.0f} % of the limits."
    check = Check("start_ramp", True, None, ramp.duration_s, math.nan, "s", sentence, row)
    return check, [SampledPath(sample(ramp, RAMP_SAMPLES_S), RAMP_SAMPLES_S, row)]


def _no_ramp(name: str, error: RampError, sentence: str, row: int) -> Check:
    return Check(name, False, error.joint, error.value, error.limit, error.unit, sentence, row)


def _torque(torque: FloatArray, table: FloatArray, limits: JointLimits) -> Check:
    if torque.shape != table.shape:
        raise TrajectoryShapeError(f"The torques have shape {torque.shape}, but the table has shape {table.shape}.")
    bad = np.argwhere(~np.isfinite(torque))
    if bad.size:
        row, column = int(bad[0, 0]), int(bad[0, 1])
        sentence = f"The expected torque of joint {column + 1} in row {row} is not a finite number."
        return Check("torque", False, column + 1, math.nan, float(limits.torque[column]), "Nm", sentence, row)
    found = _magnitude("torque", torque, limits.torque, 0.0, "Nm")
    return replace(found, sentence=f"Predicted: {found.sentence[0].lower()}{found.sentence[1:]}")


def _where_largest(values: FloatArray) -> tuple[int, int]:
    row, column = np.unravel_index(int(np.argmax(values)), values.shape)
    return int(row), int(column)
