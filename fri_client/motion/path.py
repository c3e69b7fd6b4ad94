"""Start ramp and table as one path: positions at any step of it.

Here: geometry alone, in steps counted from the first command of the motion, which need be no whole numbers. Not here:
which step is due (`motion`).
"""

from __future__ import annotations

import numpy as np

from safety.limits import FloatArray
from safety.path_stop import PathStops
from safety.ramps import Ramp


class MotionPath:
    """first: command of the table after the start ramp; stride: table rows per command."""

    def __init__(self, stops: PathStops, first: int, stride: int, command_period_s: float) -> None:
        self._stops = stops
        self._first = first
        self._stride = stride
        self._period = command_period_s
        self._ramp: Ramp | None = None
        self._ticks = 0

    def begin(self, ramp: Ramp, ticks: int) -> None:
        """The start ramp is planned; `ticks` is its number of commands."""
        self._ramp, self._ticks = ramp, ticks

    def positions_at(self, steps: FloatArray) -> FloatArray:
        """Positions, (m, n) rad, at steps of the path, (m,)."""
        on_table = steps >= self._ticks
        on_rows = self._stops.positions_at((self._first + steps[on_table] - self._ticks) * self._stride)
        positions = np.empty((len(steps), on_rows.shape[1]))
        positions[on_table] = on_rows
        if self._ramp is not None:
            times = (steps[~on_table] * self._period).tolist()
            positions[~on_table] = np.reshape([self._ramp.position_at(time) for time in times], (-1, on_rows.shape[1]))
        return positions
