"""The motion of one acquisition as a state machine that is driven by ticks and knows neither sockets nor clocks.

Here: the order of the phases, the label of each sample, a stop from any tick, and when the arm counts as standing
still. Not here: where on its path the motion is (`course`), which stop it is (`stop`), the shape of ramps and stops
and the judgement of commands (`safety`), the session (`session`), who calls (`loop`).

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
from collections.abc import Sequence
from typing import NamedTuple

from fri_client.handover.motion_phase import MotionPhase
from fri_client.handover.ring import EventCode
from fri_client.motion.course import Course
from fri_client.motion.standstill import Standstill
from fri_client.motion.stop import MotionStop
from fri_client.motion.stop_reason import StopKind, StopReason, too_much_torque
from fri_client.motion.table import MotionError, checked_table, command_stride
from safety.guard import CommandGuard, GuardVerdict, Judged
from safety.limits import FloatArray, JointLimits

__all__ = ["Foreseen", "MotionError", "MotionProgram", "StopKind", "StopReason", "command_stride"]

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
    label the command last committed. stopping: the stop, once one is asked for or due.
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
        self._samples_per_command = samples_per_command
        self.guard = CommandGuard(limits, command_period_s, maximum_distance_to_measured=maximum_distance_to_measured)
        self._external_torque_limit = None if external_torque_limit is None else tuple(external_torque_limit)
        self._course = Course(
            table,
            limits,
            command_period_s=command_period_s,
            table_period_s=table_period_s,
            periods=periods,
            lead_in_s=lead_in_s,
        )
        self.stopping = MotionStop(limits, self.guard, self._course.end_ramp, command_period_s)
        self._last: Sequence[float] = ()
        self.phase = _WAITING
        self.period = -1
        self.sample_in_period = -1
        self.standstill = Standstill(command_period_s / samples_per_command)

    @property
    def periods_completed(self) -> int:
        """Periods of which every command went out."""
        return self._course.periods_completed

    @property
    def commanded(self) -> bool:
        """True once a motion was begun."""
        return bool(self._last)

    @property
    def waits(self) -> bool:
        """True until it is begun or stopped."""
        return self.phase == _WAITING

    @property
    def watches_external_torque(self) -> bool:
        """Whether external torque beyond a limit stops it."""
        return self._external_torque_limit is not None

    def prepare(self, ipo_position: tuple[float, ...]) -> None:
        """Plan the start ramp from the IPO position (rad) ahead of time; cheap where it is planned already.

        Raises RampError with joint and numbers when there is no ramp inside the limits.
        """
        self._course.prepare(ipo_position)

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

    def stop(self, reason: StopReason) -> None:
        """Ask for a stop ramp at the next tick; the first reason counts, and none does once the arm is stopping."""
        if self.stopping.asked is None and self.phase < _STOP_RAMP:
            self.stopping.ask(reason)
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
            if limits is not None and external_torque is not None and self.stopping.asked is None:
                for joint, value in enumerate(external_torque):
                    if not -limits[joint] <= value <= limits[joint]:
                        self.stop(too_much_torque(joint + 1, value, limits[joint]))
                        break
            if self.stopping.asked is None:
                command = self._course.upcoming()
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
            self.stopping.commit()

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
        if self.stopping.asked is not None or not _START_RAMP <= self.phase < _STOP_RAMP:
            return None
        command = self._course.upcoming()
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
            self.stopping.abandon()
        course = self._course
        if not _START_RAMP <= self.phase < _STOP_RAMP or not course.has_begun or course.stands:
            return
        self.guard.come_to_rest()
        if not course.take_up_from_rest():
            sentence = "Too many cycles were lost, and the path leaves no room to take it up again from rest."
            self.stop(StopReason(EventCode.RAMP_ERROR, sentence))

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
            self.stopping.abandon()
        self.phase = _LATCHED
        self.period = self.sample_in_period = -1
        self.standstill.reset()

    def _advance(self) -> None:
        """The command of the path went out: the labels move with it."""
        place = self._course.advance()
        if self.phase == _START_RAMP and self._course.has_left_the_ramp:
            self.phase = _LEAD_IN
        if place < 0:
            self.period = self.sample_in_period = -1
            return
        self.phase = _EXCITATION
        self.period, sample = divmod(place, self._course.commands_per_period)
        self.sample_in_period = sample * self._samples_per_command

    def _begin_stop(self) -> None:
        self._plan_stop()
        self.phase = _STOP_RAMP
        self.period = self.sample_in_period = -1

    def _plan_stop(self) -> None:
        if not self._course.stands:
            is_done = self.phase == _EXCITATION and self._course.is_done
            self.stopping.plan(self._course.stop_along(), table_is_done=is_done)

    def _propose_stop(self, measured_position: Sequence[float] | None) -> Judged | None:
        judged = self.stopping.propose(measured_position) if self.phase in (_STOP_RAMP, _LATCHED) else None
        if judged is not None:
            return judged
        if self.stopping.is_refused:
            return None
        if self.phase == _STOP_RAMP:
            self.phase = _HOLD
            self.standstill.reset()
        held = self.guard.examine(self._last, None, stopping=True)
        return None if isinstance(held, GuardVerdict) else held
