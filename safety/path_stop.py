"""Stops that stay on the table's own path: the path parameter is slowed, the geometry is kept.

Lives here: the slowing of the path parameter, the positions between two rows, and the check of a whole slowed stretch
against the limits. Lives elsewhere: stops of the joints each on its own (ramps.py), which of the two is driven and when
(fri_client.motion). What the preflight found about the path (distances between links, to floor and walls) holds for
these stops as well, since they visit no other position; of a joint-space stop it has to be found out separately.

The path parameter s counts rows of the table. In motion it grows by one command's rows per tick; a stop takes its rate
from there to 0 by a one-dimensional plan of Ruckig with limited acceleration and jerk, so joint velocities and
accelerations along the path, dq/ds ds/dt and d²q/ds² (ds/dt)² + dq/ds d²s/dt², begin with those of the motion and end
with 0. The plans depend on no joint and no row: they are made once, one for each rung of a ladder, and a stop at run
time is a matter of picking rows and weights.

Between two rows the path is the periodic cubic spline through all rows of the table: it passes through each row and is
continuous in velocity and acceleration. Its distance from a smooth path is 5/384 h⁴ |q''''|, which is 2e-11 rad for a
sinusoid of 1 Hz and 1 rad on a grid of 1 ms.
"""

from __future__ import annotations

import math

import numpy as np
import ruckig
from numpy.typing import NDArray

from safety.guard import ACCELERATION_TOLERANCE, POSITION_TOLERANCE_RAD, VELOCITY_TOLERANCE
from safety.limits import JERK_PER_ACCELERATION_HZ, FloatArray, JointLimits

SLOWING_RATES_HZ = (20.0, 14.0, 10.0, 7.0, 5.0, 3.5, 2.5, 1.8, 1.2)
"""Ladder: largest deceleration of the path parameter, as a share of its rate per second; from 0.14 s to 0.93 s to rest.

The jerk of the path parameter is limited to JERK_PER_ACCELERATION_HZ times that, the ratio the joints have. The first
rung whose whole stretch is inside the joint limits is taken: the shortest stop the path allows."""

JERK_TOLERANCE = 0.01
"""Relative slack on the table's own jerk: a third difference at 1 ms turns 1e-10 rad of a spline into 0.1 rad/s³."""

_HISTORY = 3
"""Commands before the stop that its first differences reach back to."""


class PathStop:
    """A checked stop along the path, as the positions of its commands; the counterpart of `safety.ramps.Ramp`.

    duration_s: from the last command of the motion to the first one at rest. rows: length of the stop on the path, in
    rows of the table.
    """

    def __init__(self, positions: FloatArray, period_s: float, rows: float) -> None:
        self._positions: list[list[float]] = positions.tolist()
        self._period = period_s
        self.duration_s = len(positions) * period_s
        self.rows = rows

    def position_at(self, time_s: float) -> list[float]:
        """Position, n plain floats, rad, at the command tick nearest to `time_s` after the last command before."""
        tick = round(time_s / self._period) - 1
        return self._positions[min(max(tick, 0), len(self._positions) - 1)]


class PathStops:
    """Plans stops along one periodic table; construct it before the motion, ask `plan` when the stop is due.

    table: (N, n) rad on the grid table_period_s, row N would be row 0 again; stride: rows per command;
    limits: what the commands of a stop have to keep to.
    """

    def __init__(self, table: FloatArray, table_period_s: float, stride: int, limits: JointLimits) -> None:
        rungs = [_Rung(rate, table_period_s, stride, limits.joint_count) for rate in SLOWING_RATES_HZ]
        self._rungs = rungs
        self._count = len(table)
        self._period = table_period_s * stride
        self._lower = limits.position_lower - POSITION_TOLERANCE_RAD
        self._upper = limits.position_upper + POSITION_TOLERANCE_RAD
        # Steps instead of rates: one comparison for each difference, no division, while a robot waits for its answer.
        self._velocity_step = limits.velocity * (1.0 + VELOCITY_TOLERANCE) * self._period
        self._acceleration_step = limits.acceleration * (1.0 + ACCELERATION_TOLERANCE) * self._period**2
        self._history = np.arange(-_HISTORY, 1) * stride
        steps = np.diff(table[np.arange(-_HISTORY, len(table))], axis=0) / table_period_s
        own_jerk = np.abs(np.diff(steps, n=2, axis=0)).max(axis=0) / table_period_s**2
        # A table may have more jerk than our limit (it is reported, not refused); slowing it must only not add any.
        jerk = np.where(own_jerk < limits.jerk, limits.jerk, own_jerk * (1.0 + JERK_TOLERANCE))
        self._jerk_step = jerk * self._period**3
        # Positions and curvatures side by side, and the beginning again behind the end: a stop is then one slice.
        whole = np.hstack((table, spline_curvature(table)))
        ahead = int(max(rung.rows for rung in rungs)) + 2
        self._spline = np.take(whole, np.arange(len(table) + ahead), axis=0, mode="wrap")
        self._table = table

    def plan(self, row: int) -> PathStop | None:
        """The shortest stop after the command of `row` (of the table, any period) that is inside every limit, or None.

        The commands before are taken to be those of the path; judged are the differences of the commands themselves
        up to the jerk, from the last three commands of the motion to the first three at rest.
        """
        row %= self._count
        before = self._table[(row + self._history) % self._count]
        spline = self._spline[row:]
        for rung in self._rungs:
            stretch = rung.positions(spline)
            if self.fits(np.concatenate((before, stretch, stretch[[-1] * _HISTORY]))):
                return PathStop(stretch, self._period, rung.rows)
        return None

    def positions_at(self, rows: FloatArray) -> FloatArray:
        """Positions on the path, (m, n) rad, at places that need be no whole rows and may lie in any period."""
        whole = np.floor(rows).astype(np.int64)
        ahead = (rows - whole)[:, None]
        behind = 1.0 - ahead
        here, there = self._spline[whole % self._count], self._spline[(whole + 1) % self._count]
        n = self._table.shape[1]
        positions: FloatArray = behind * here[:, :n] + ahead * there[:, :n]
        positions += ((behind**3 - behind) * here[:, n:] + (ahead**3 - ahead) * there[:, n:]) / 6.0
        return positions

    def fits(self, positions: FloatArray) -> bool:
        """Whether commands, (m, n) rad, one per period, are inside every limit; of the jerk see JERK_TOLERANCE."""
        steps = np.diff(positions, axis=0)
        seconds = np.diff(steps, axis=0)
        thirds = np.diff(seconds, axis=0)
        # The jerk first, since it is what mostly refuses a rung.
        return not (
            (np.abs(thirds) > self._jerk_step).any()
            or (np.abs(seconds) > self._acceleration_step).any()
            or (np.abs(steps) > self._velocity_step).any()
            or (positions < self._lower).any()
            or (positions > self._upper).any()
        )


class _Rung:
    """One way of slowing the path parameter: rows and weights of the spline for each command, the same at every row."""

    def __init__(self, rate_hz: float, table_period_s: float, stride: int, joints: int) -> None:
        period = table_period_s * stride
        request = ruckig.InputParameter(1)
        request.control_interface = ruckig.ControlInterface.Velocity
        # In units of rows per second; the motion's own rate is 1 / table_period_s.
        request.current_velocity = [1.0 / table_period_s]
        request.max_velocity = [1.0 / table_period_s]
        request.max_acceleration = [rate_hz / table_period_s]
        request.max_jerk = [rate_hz * JERK_PER_ACCELERATION_HZ / table_period_s]
        trajectory = ruckig.Trajectory(1)
        result = ruckig.Ruckig(1).calculate(request, trajectory)
        assert result in (ruckig.Result.Working, ruckig.Result.Finished), result  # no input of an operator is in it
        ticks = max(1, math.ceil(trajectory.duration / period - 1e-9))
        place = np.array([trajectory.at_time(min(k * period, trajectory.duration))[0][0] for k in range(1, ticks + 1)])
        self.rows = float(place[-1])
        self._row = np.floor(place).astype(np.int64)
        ahead = (place - self._row)[:, None]
        behind = 1.0 - ahead
        # For the columns of PathStops._spline: n positions, then n curvatures.
        self._behind = np.repeat(np.hstack((behind, (behind**3 - behind) / 6.0)), joints, axis=1)
        self._ahead = np.repeat(np.hstack((ahead, (ahead**3 - ahead) / 6.0)), joints, axis=1)

    def positions(self, spline: FloatArray) -> FloatArray:
        """The commands of the stop after the first row of `spline`, (ticks, n) rad."""
        parts = self._behind * spline[self._row] + self._ahead * spline[self._row + 1]
        joints = parts.shape[1] // 2
        positions: FloatArray = parts[:, :joints] + parts[:, joints:]
        return positions


def spline_curvature(table: FloatArray) -> NDArray[np.float64]:
    """Second derivative d²q/ds² at each row of the periodic cubic spline through the rows, (N, n) rad per row².

    It solves m[i-1] + 4 m[i] + m[i+1] = 6 (q[i-1] - 2 q[i] + q[i+1]) with indices modulo N, which the discrete Fourier
    transform turns into N scalar divisions by 4 + 2 cos(2 pi k / N) >= 2.
    """
    count = len(table)
    cosine = np.cos(2.0 * np.pi * np.arange(count // 2 + 1) / count)[:, None]
    # The second difference itself, not its spectrum: a difference of two large spectra would lose digits.
    second = np.roll(table, 1, axis=0) - 2.0 * table + np.roll(table, -1, axis=0)
    curvature: FloatArray = np.fft.irfft(6.0 * np.fft.rfft(second, axis=0) / (4.0 + 2.0 * cosine), n=count, axis=0)
    return curvature
