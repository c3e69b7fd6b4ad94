"""How far along its path a motion is: start ramp, lead-in, periods, and the way back to its pace after a pause.

Here: the next command of the path, the step that was done, re-entries, and the stop that keeps to the path from there.
Not here: whether a command may go out (`safety`), phases, labels and stops (`program`), geometry alone (`path`).

A course moves by the commands that went out and by nothing else, so a message that was lost delays it and cannot make
a step larger than planned.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from fri_client.motion.path import MotionPath
from fri_client.motion.re_entry import ReEntry, plan_braking, plan_re_entry, re_entry_steps
from fri_client.motion.table import command_stride, state_of_row
from safety.limits import FloatArray, JointLimits
from safety.path_stop import PathStop, PathStops
from safety.ramps import Ramp, plan_start_ramp, plan_stop_ramp

_ROWS_BEFORE_PATH_STOP = 3
"""Commands on the table before a stop may keep to it: its first differences reach back so far."""


class _Pace(NamedTuple):
    """A re-entry that is over: step it began at, its commands, how many of them went out."""

    start: float
    ticks: int
    sent: int


class Course:
    """`prepare` the start ramp, then `upcoming` and `advance` per command; `take_up_from_rest` after a pause.

    table: (N, n) positions of one period in rad on the grid table_period_s (s), periodic. end_ramp: the stop from the
    last row of the last period. Raises MotionError for a command period that is no multiple of the table's, and
    RampError when the motion could not be stopped at its end.
    """

    def __init__(
        self,
        table: FloatArray,
        limits: JointLimits,
        *,
        command_period_s: float,
        table_period_s: float,
        periods: int,
        lead_in_s: float,
    ) -> None:
        stride = command_stride(len(table), table_period_s, command_period_s)
        self._limits = limits
        self._command_period_s = command_period_s
        self._stride = stride
        # Tuples of floats: a tick then takes one out and makes nothing new.
        self._rows: list[tuple[float, ...]] = list(map(tuple, table[::stride].tolist()))
        self._lead_in = round(lead_in_s / command_period_s)
        first = -self._lead_in * stride % len(table)
        self._first = first // stride
        self._start_state = state_of_row(table, first, table_period_s)
        self.end_ramp = plan_stop_ramp(*state_of_row(table, len(table) - stride, table_period_s), limits)
        self._stops = PathStops(table, table_period_s, stride, limits)
        self._path = MotionPath(self._stops, self._first, stride, command_period_s)
        self._table_total = self._lead_in + periods * len(self._rows)
        self._periods = periods
        self._start_ramp: Ramp | None = None
        self._start_position: tuple[float, ...] = ()
        self._start_ticks = 0
        self._on_ramp = 0  # commands of the start ramp that went out
        self._on_table = 0  # and of the table
        self._re_entry: ReEntry | None = None
        self._re_entry_step = 0
        self._last_re_entry: _Pace | None = None
        self._straight_from = 0  # commands on the table that were no part of the last re-entry begin here

    @property
    def commands_per_period(self) -> int:
        """Rows of the table that are commanded in a period."""
        return len(self._rows)

    @property
    def periods_completed(self) -> int:
        """Periods of which every command went out."""
        return min(self._periods, max(0, self._on_table - self._lead_in) // len(self._rows))

    @property
    def has_left_the_ramp(self) -> bool:
        """Whether a command of the table went out."""
        return self._on_table > 0

    @property
    def is_done(self) -> bool:
        """Whether the last command of the last period went out."""
        return self._on_table >= self._table_total

    @property
    def stands(self) -> bool:
        """Whether the arm stands where the path is to be taken up, and no command of the re-entry went out."""
        return self._re_entry is not None and not self._re_entry_step

    def prepare(self, position: tuple[float, ...]) -> None:
        """Plan the start ramp from that position, rad; cheap where it is planned already. Raises RampError."""
        if self._start_ramp is not None and position == self._start_position:
            return
        self._start_ramp = plan_start_ramp(
            position, *self._start_state, self._limits, command_period_s=self._command_period_s
        )
        self._start_position = position
        self._start_ticks = round(self._start_ramp.duration_s / self._command_period_s)
        self._path.begin(self._start_ramp, self._start_ticks)

    def upcoming(self) -> Sequence[float] | None:
        """The next command, rad; None when the table is done. Nothing moves."""
        if self._re_entry is not None:
            positions = self._re_entry.positions
            return positions[self._re_entry_step] if positions else None
        if self._on_ramp < self._start_ticks and self._start_ramp is not None:
            return self._start_ramp.position_at(self._on_ramp * self._command_period_s)
        if self.is_done:
            return None
        return self._rows[(self._first + self._on_table) % len(self._rows)]

    def advance(self) -> int:
        """The upcoming command went out: its place, counted from the first one of the first period.

        Negative for what belongs to no period: ramp, lead-in and re-entry.
        """
        if self._re_entry is not None:
            self._advance_re_entry(self._re_entry)
            return -1
        if self._on_ramp < self._start_ticks:
            self._on_ramp += 1
            return -1
        place = self._on_table - self._lead_in
        self._on_table += 1
        return place

    def take_up_from_rest(self) -> bool:
        """The arm stands on the last command: plan the way back to the path's pace. False where none fits."""
        start = float(self._on_ramp + self._on_table - 1)
        if self._re_entry is not None:
            ended = self._pace_of(self._re_entry)
            start = float(re_entry_steps(ended.start, ended.ticks)[ended.sent - 1])
            self._last_re_entry = ended
        self._re_entry_step = 0
        # Broken off again and again, past the end; or nothing fits, and the stop finds an arm that stands.
        stand = ReEntry(start, 0, [])
        if start >= self._start_ticks + self._table_total - 1:
            self._on_ramp, self._on_table = self._start_ticks, self._table_total
            self._re_entry = stand
            return True
        found = plan_re_entry(start, self._command_period_s, self._path.positions_at, self._stops.fits)
        self._re_entry = found or stand
        return found is not None

    @property
    def has_begun(self) -> bool:
        """Whether any command of it went out."""
        return self._on_ramp > 0

    def stop_along(self) -> Callable[[], PathStop | None] | None:
        """What plans the stop on the path from the last command; None on the start ramp, and just after it."""
        straight = self._on_table - self._straight_from
        if self._re_entry is None and straight >= _ROWS_BEFORE_PATH_STOP:
            row = (self._first + self._on_table - 1) * self._stride
            return lambda: self._stops.plan(row)
        if self._re_entry is not None:
            pace, straight = self._pace_of(self._re_entry), 0
        elif self._straight_from and self._last_re_entry is not None:
            pace = self._last_re_entry
        else:
            return None
        steps = re_entry_steps(pace.start, pace.ticks)[: pace.sent]
        recent = np.concatenate(([pace.start] * 4, steps, steps[-1] + np.arange(1.0, straight + 1.0)))[-4:]
        return lambda: plan_braking(recent, self._command_period_s, self._path.positions_at, self._stops.fits)

    def _pace_of(self, re_entry: ReEntry) -> _Pace:
        return _Pace(re_entry.start, len(re_entry.positions), self._re_entry_step)

    def _advance_re_entry(self, re_entry: ReEntry) -> None:
        self._re_entry_step += 1
        if self._re_entry_step < len(re_entry.positions):
            return
        self._last_re_entry = self._pace_of(re_entry)
        self._re_entry = None
        done = re_entry.landing + 1
        self._on_ramp = min(done, self._start_ticks)
        self._on_table = self._straight_from = done - self._on_ramp
