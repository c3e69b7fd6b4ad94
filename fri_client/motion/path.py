"""Start ramp and table as one path: positions at any step of it, and the commands of a motion rebuilt from its plan.

Here: geometry alone, in steps counted from the first command of the motion, which need be no whole numbers. Not here:
which step is due (`motion`). A motion keeps no list of what it commanded; whoever reports asks for it here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fri_client.motion.re_entry import re_entry_steps
from safety.path_stop import PathStops
from safety.ramps import Ramp

__all__ = ["MotionPath"]

FloatArray = NDArray[np.float64]


class MotionPath:
    """rows: commands per period of the table; first: the one after the start ramp; stride: table rows per command."""

    def __init__(self, stops: PathStops, rows: int, first: int, stride: int, command_period_s: float) -> None:
        self._stops = stops
        self._rows = rows
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

    def stretches(
        self,
        start_position: Sequence[float],
        re_entries: Sequence[tuple[float, int, int]],
        done: int,
        stop: Sequence[Sequence[float]],
    ) -> list[FloatArray]:
        """What was commanded, (M, n) rad: one stretch, or several where the robot stood in between.

        Each begins with three commands at rest. Of more than two periods on the table the repetitions are left out
        (they change no peak). re_entries: start, ticks and how many of them went out; done: commands of the path;
        stop: those of the stop.
        """
        found: list[FloatArray] = []
        here: int | None = 0
        parts = [np.array([start_position] * 3)]
        for start, ticks, sent in re_entries:
            if here is not None:
                parts.append(self._between(here, math.floor(start) + 1))
            found.append(np.concatenate(parts))
            parts = [found[-1][[-1] * 3]]
            if sent:
                parts.append(self.positions_at(re_entry_steps(start, ticks)[:sent]))
            # One that was broken off is followed by no whole step of the path.
            here = math.ceil(start) + ticks // 2 + 1 if sent == ticks else None
        if here is not None:
            parts.append(self._between(here, done))
        if stop:
            parts.append(np.array(stop))
        found.append(np.concatenate(parts))
        return found

    def _between(self, begin: int, end: int) -> FloatArray:
        """Positions from step begin to before end; of many periods all but some two are left out, whole ones."""
        surplus = max(0, (end - max(begin, self._ticks)) // self._rows - 2) * self._rows
        return self.positions_at(np.arange(begin, end - surplus, dtype=np.float64))
