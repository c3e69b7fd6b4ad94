"""The motion of one acquisition as a state machine that is driven by ticks and knows neither sockets nor clocks.

Here: the order of the phases, the label of each sample, a stop from any tick, and when the arm counts as standing
still. Not here: which stop it is (`stop`), the shape of ramps and stops and the judgement of commands
(`safety`), the session (`session`), who calls (`loop`).

    WAITING -> START_RAMP -> LEAD_IN -> EXCITATION x periods -> STOP_RAMP -> HOLD -> DONE
                   any stop reason at any tick ------------------> STOP_RAMP
                   a drop of the session at any tick ------------> LATCHED

`propose` names the next command and moves nothing; `commit` moves the path by that step once the command went out
(`gate`). So a message that was lost, came late or could not be answered delays the path and cannot make a step larger
than planned. After a pause that the robot cannot bridge `resume_from_rest` takes the path up again from rest
(`re_entry`); a stop that was under way has ended by itself then.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fri_client.handover.motion_phase import MotionPhase
from fri_client.handover.ring import EventCode
from fri_client.motion.path import MotionPath
from fri_client.motion.re_entry import ReEntry, plan_braking, plan_re_entry, re_entry_steps
from fri_client.motion.standstill import Standstill
from fri_client.motion.stop import MotionStop
from fri_client.motion.stop_reason import StopKind, StopReason, too_much_torque
from fri_client.motion.table import MotionError, checked_table, command_stride, state_of_row
from safety.guard import CommandGuard, GuardVerdict, Judged
from safety.limits import JointLimits
from safety.path_stop import PathStop, PathStops
from safety.ramps import Ramp, plan_start_ramp, plan_stop_ramp

__all__ = ["Foreseen", "MotionError", "MotionProgram", "StopKind", "StopReason", "command_stride"]

FloatArray = NDArray[np.float64]

_ROWS_BEFORE_PATH_STOP = 3
"""Commands on the table before a stop may keep to it: its first differences reach back so far."""

_WAITING, _START_RAMP, _LEAD_IN, _EXCITATION, _STOP_RAMP, _HOLD, _LATCHED, _DONE = (int(phase) for phase in MotionPhase)


class Foreseen(NamedTuple):
    """The next command, and what its sample has to lie within (limits included) to be answered so:

    measured position in rad, 7, then external torque in Nm, 7.
    """

    judged: Judged
    lower: tuple[float, ...]
    upper: tuple[float, ...]


class MotionProgram:
    """One acquisition's motion: `prepare` while waiting, `begin` at COMMANDING_ACTIVE, then `propose` and `commit`.

    table: (N, 7) positions of one period in rad on the grid table_period_s (s), periodic: row N would be row 0 again.
    command_period_s: send period times receive multiplier, s; samples_per_command: the receive multiplier.
    lead_in_s: the last seconds of the period, driven once before the first period. external_torque_limit: Nm per
    joint, None: not watched. Raises MotionError, and RampError when the motion could not be stopped at its end.

    phase, period (from 0, -1 outside EXCITATION) and sample_in_period (-1 outside; on the grid of the send period)
    label the command last committed.
    """

    def __init__(
        self,
        table: FloatArray,
        limits: JointLimits,
        *,
        command_period_s: float,
        periods: int,
        lead_in_s: float = 1.0,
        table_period_s: float = 0.001,
        samples_per_command: int = 1,
        maximum_distance_to_measured: FloatArray | float = 0.1,
        external_torque_limit: Sequence[float] | None = None,
    ) -> None:
        table = checked_table(table, limits.joint_count)
        stride = command_stride(len(table), table_period_s, command_period_s)
        self._limits = limits
        self.command_period_s = command_period_s
        self._samples_per_command = samples_per_command
        self._periods = periods
        self.guard = CommandGuard(limits, command_period_s, maximum_distance_to_measured=maximum_distance_to_measured)
        self._external_torque_limit = None if external_torque_limit is None else tuple(external_torque_limit)
        # Tuples of floats: a tick then takes one out and makes nothing new.
        self._path: list[tuple[float, ...]] = list(map(tuple, table[::stride].tolist()))
        self._lead_in = round(lead_in_s / command_period_s)
        first = -self._lead_in * stride % len(table)
        self._start_state = state_of_row(table, first, table_period_s)
        self._stride = stride
        self._path_stops = PathStops(table, table_period_s, stride, limits)
        end_ramp = plan_stop_ramp(*state_of_row(table, len(table) - stride, table_period_s), limits)
        self._stop = MotionStop(limits, self.guard, end_ramp, command_period_s)
        self._first = first // stride
        self._motion_path = MotionPath(self._path_stops, len(self._path), self._first, stride, command_period_s)
        self._step = 0  # steps done within the current phase
        self._total = periods * len(self._path)
        self._start_ramp: Ramp | None = None
        self._start_position: tuple[float, ...] = ()
        self._start_ticks = 0
        self._last: Sequence[float] = ()
        self._start_done = 0
        self._on_path = 0
        self._re_entry: ReEntry | None = None
        self._re_entry_step = 0
        self._re_entries: list[tuple[float, int, int]] = []  # start, ticks, how many of them went out
        self._straight_from = 0  # commands on the table that were no part of the last re-entry begin here
        self.phase = _WAITING
        self.period = -1
        self.sample_in_period = -1
        self.standstill = Standstill(command_period_s / samples_per_command)

    @property
    def samples_per_period(self) -> int:
        """Monitoring messages per period."""
        return len(self._path) * self._samples_per_command

    @property
    def periods_completed(self) -> int:
        """Periods of which every command went out."""
        return min(self._periods, max(0, self._on_path - self._lead_in) // len(self._path))

    @property
    def commanded(self) -> bool:
        """True once a motion was begun."""
        return bool(self._last)

    @property
    def waits(self) -> bool:
        """True until it is begun or stopped."""
        return self.phase == _WAITING

    @property
    def moving(self) -> bool:
        """True while the commands move the arm."""
        return _START_RAMP <= self.phase <= _STOP_RAMP

    @property
    def stop_reason(self) -> StopReason | None:
        """Why the motion was stopped, None where it was not, or came to its end."""
        return self._stop.reason

    @property
    def stop_kind(self) -> StopKind | None:
        """How the arm was brought to rest, None where no command of a stop went out."""
        return self._stop.kind

    @property
    def stop_duration_s(self) -> float:
        """Time from the last command of the motion to the first at rest, s; 0 while no stop is planned."""
        return self._stop.duration_s

    @property
    def stop_rows(self) -> float:
        """Rows of the table a stop on the path goes on for; 0 for any other."""
        return self._stop.rows

    @property
    def overruled(self) -> int:
        """Commands of the stop that the guard objected to."""
        return self._stop.overruled

    def prepare(self, ipo_position: tuple[float, ...]) -> None:
        """Plan the start ramp from the IPO position (rad) ahead of time; cheap where it is planned already.

        Raises RampError with joint and numbers when there is no ramp inside the limits.
        """
        if self._start_ramp is not None and ipo_position == self._start_position:
            return
        self._start_ramp = plan_start_ramp(
            ipo_position, *self._start_state, self._limits, command_period_s=self.command_period_s
        )
        self._start_position = ipo_position
        self._start_ticks = round(self._start_ramp.duration_s / self.command_period_s)
        self._motion_path.begin(self._start_ramp, self._start_ticks)

    def begin(self, ipo_position: tuple[float, ...]) -> None:
        """Anchor on the IPO position of the first COMMANDING_ACTIVE message; the next `tick` returns the first command.

        Raises RampError as `prepare` does, and ValueError when the motion was begun before: there is no second time.
        """
        if self.phase != _WAITING:
            raise ValueError("a motion begins once")
        self.prepare(ipo_position)
        self.guard.anchor(ipo_position)
        self._last = ipo_position
        self.phase = _START_RAMP
        self._step = 0

    def stop(self, reason: StopReason) -> None:
        """Ask for a stop ramp at the next tick; the first reason counts, and none does once the arm is stopping."""
        if self._stop.asked is None and self.phase < _STOP_RAMP:
            self._stop.ask(reason)
            if self.phase == _WAITING:
                self.phase = _DONE

    def propose(
        self, measured_position: Sequence[float], external_torque: Sequence[float] | None = None
    ) -> Judged | None:
        """The next command, in answer to one fresh sample in COMMANDING_ACTIVE; None where none may go out.

        Never a command of the path that the guard refused: the stop from the last accepted one is planned instead.
        """
        if self.phase < _STOP_RAMP:
            limits = self._external_torque_limit
            if limits is not None and external_torque is not None and self._stop.asked is None:
                for joint, value in enumerate(external_torque):
                    if not -limits[joint] <= value <= limits[joint]:
                        self.stop(too_much_torque(joint + 1, value, limits[joint]))
                        break
            if self._stop.asked is None:
                command = self._upcoming()
                if command is not None:
                    outcome = self.guard.examine(command, measured_position)
                    if isinstance(outcome, Judged):
                        return outcome
                    self.stop(StopReason.from_verdict(outcome))
            self._begin_stop()
        return self._propose_stop(measured_position)

    def commit(self, judged: Judged) -> None:
        """The command last proposed or foreseen went out."""
        self._last = judged.command
        if self.phase < _STOP_RAMP:
            self._advance()
        else:
            self._stop.commit()

    def tick(
        self, measured_position: Sequence[float], external_torque: Sequence[float] | None = None
    ) -> Sequence[float]:
        """Propose and commit in one, for a motion without a robot; the last command where none is due."""
        judged = self.propose(measured_position, external_torque)
        if judged is not None:
            self.guard.accept(judged)
            self.commit(judged)
        return self._last

    def foresee(self) -> Foreseen | None:
        """What `propose` will return, if the next sample lies within the bounds; judged in all other respects.

        None: nothing moves along a path, a stop was asked for, or the guard would refuse. Nothing is changed by it.
        """
        if self._stop.asked is not None or not _START_RAMP <= self.phase < _STOP_RAMP:
            return None
        command = self._upcoming()
        judged = None if command is None else self.guard.examine(command, None)
        if not isinstance(judged, Judged):
            return None
        # Narrower than the guard's by more than the round-off of a difference, so that the guard would agree.
        gaps = [distance - 1e-9 for distance in self.guard.distances]
        torque = self._external_torque_limit or (math.inf,) * len(gaps)
        return Foreseen(
            judged,
            (*map(operator.sub, judged.command, gaps), *map(operator.neg, torque)),
            (*map(operator.add, judged.command, gaps), *torque),
        )

    def resume_from_rest(self) -> None:
        """The robot had no command for longer than it bridges: it stands on the last one, and the path begins there.

        A motion goes on along its path; where no re-entry fits into the limits it is stopped, where it stands. A stop
        under way is over.
        """
        if self.phase >= _STOP_RAMP:
            self.guard.come_to_rest()
            self._stop.abandon()
        if not _START_RAMP <= self.phase < _STOP_RAMP or not self._start_done:
            return
        if self._re_entry is not None and not self._re_entry_step:
            return  # no command went out since it was planned
        start = float(self._start_done + self._on_path - 1)
        if self._re_entry is not None:
            ticks = len(self._re_entry.positions)
            start = float(re_entry_steps(self._re_entry.start, ticks)[self._re_entry_step - 1])
            self._re_entries.append((self._re_entry.start, ticks, self._re_entry_step))
        self.guard.come_to_rest()
        self._re_entry_step = 0
        if start >= self._start_ticks + self._lead_in + self._total - 1:  # broken off again and again, past the end
            self._start_done, self._on_path = self._start_ticks, self._lead_in + self._total
            self._re_entry = ReEntry(start, 0, [])
            return
        self._re_entry = plan_re_entry(
            start, self.command_period_s, self._motion_path.positions_at, self._path_stops.fits
        )
        if self._re_entry is None:
            self._re_entry = ReEntry(start, 0, [])  # the stop finds an arm that stands
            sentence = "Too many cycles were lost, and the path leaves no room to take it up again from rest."
            self.stop(StopReason(EventCode.RAMP_ERROR, sentence))

    def skip(self) -> None:
        """A fresh sample that is not answered (receive multiplier above 1): only its label moves on."""
        if self.period >= 0:
            self.sample_in_period += 1

    def observe(self, measured_position: Sequence[float]) -> None:
        """Watch for standstill in HOLD (leads to DONE either way) and in LATCHED; call it for each fresh sample."""
        if self.phase not in (_HOLD, _LATCHED):
            return
        self.standstill.observe(measured_position)
        if self.phase == _HOLD and (self.standstill.confirmed or self.standstill.gave_up):
            self.phase = _DONE

    def latch(self, *, at_rest: bool = False) -> None:
        """The session was lost: no further motion, ever. `propose` may still bring the arm to rest.

        at_rest: the robot has held the last command for so long (silence) that its velocity is gone.
        """
        if self.phase in (_START_RAMP, _LEAD_IN, _EXCITATION):
            if not at_rest:
                self._plan_stop()
        elif self.phase == _STOP_RAMP and at_rest:
            self._stop.abandon()
        self.phase = _LATCHED
        self.period = self.sample_in_period = -1
        self.standstill.reset()

    def commanded_paths(self) -> list[FloatArray]:
        """All commands of the motion so far, (M, 7) rad each, rebuilt from the plan, not stored; see `MotionPath`."""
        if not self._last:
            return []
        entries = list(self._re_entries)
        if self._re_entry is not None:
            entries.append((self._re_entry.start, len(self._re_entry.positions), self._re_entry_step))
        done = self._start_done + self._on_path
        return self._motion_path.stretches(self._start_position, entries, done, self._stop.commands())

    # The path.

    def _advance(self) -> None:
        """One step along ramp, lead-in, table or re-entry; moves the labels."""
        if self._re_entry is not None:
            self._next_of_re_entry(self._re_entry)
            return
        if self.phase == _START_RAMP:
            if self._step < self._start_ticks:
                self._step += 1
                self._start_done = self._step
                return
            self.phase = _LEAD_IN
            self._step = 0
        place = self._on_path - self._lead_in
        self._on_path += 1
        if place >= 0:
            self.phase = _EXCITATION
            self.period, sample = divmod(place, len(self._path))
            self.sample_in_period = sample * self._samples_per_command

    def _upcoming(self) -> Sequence[float] | None:
        """The next command of ramp, lead-in, table or re-entry; None when the table is done. Nothing moves."""
        if self._re_entry is not None:
            positions = self._re_entry.positions
            return positions[self._re_entry_step] if positions else None
        if self.phase == _START_RAMP and self._step < self._start_ticks and self._start_ramp is not None:
            return self._start_ramp.position_at(self._step * self.command_period_s)
        if self._on_path >= self._lead_in + self._total:
            return None
        return self._path[(self._first + self._on_path) % len(self._path)]

    def _next_of_re_entry(self, re_entry: ReEntry) -> None:
        self.period = self.sample_in_period = -1
        self._re_entry_step += 1
        if self._re_entry_step < len(re_entry.positions):
            return
        self._re_entry = None
        self._re_entries.append((re_entry.start, self._re_entry_step, self._re_entry_step))
        done = re_entry.landing + 1
        self._step = self._start_done = min(done, self._start_ticks)
        self._on_path = self._straight_from = done - self._start_done
        if self._on_path and self.phase == _START_RAMP:
            self.phase = _LEAD_IN

    # The stop.

    def _begin_stop(self) -> None:
        self._plan_stop()
        self.phase = _STOP_RAMP
        self.period = self.sample_in_period = -1

    def _plan_stop(self) -> None:
        if self._re_entry is not None and not self._re_entry_step:
            return  # the arm stands
        self._stop.plan(
            self._along_path(),
            table_is_done=self.phase == _EXCITATION and self._on_path == self._lead_in + self._total,
        )

    def _along_path(self) -> Callable[[], PathStop | None] | None:
        """What plans the stop on the path from the last command; None on the start ramp, and just after it."""
        straight = self._on_path - self._straight_from
        if self._re_entry is None and straight >= _ROWS_BEFORE_PATH_STOP:
            row = (self._first + self._on_path - 1) * self._stride
            return lambda: self._path_stops.plan(row)
        if self._re_entry is not None:
            start, ticks, sent, straight = self._re_entry.start, len(self._re_entry.positions), self._re_entry_step, 0
        elif self._straight_from:
            start, ticks, sent = self._re_entries[-1]
        else:
            return None
        steps = re_entry_steps(start, ticks)[:sent]
        recent = np.concatenate(([start] * 4, steps, steps[-1] + np.arange(1.0, straight + 1.0)))[-4:]
        return lambda: plan_braking(
            recent, self.command_period_s, self._motion_path.positions_at, self._path_stops.fits
        )

    def _propose_stop(self, measured_position: Sequence[float] | None) -> Judged | None:
        judged = self._stop.propose(measured_position) if self.phase in (_STOP_RAMP, _LATCHED) else None
        if judged is not None:
            return judged
        if self._stop.is_refused:
            return None
        if self.phase == _STOP_RAMP:
            self.phase = _HOLD
            self.standstill.reset()
        held = self.guard.examine(self._last, None, stopping=True)
        return None if isinstance(held, GuardVerdict) else held
