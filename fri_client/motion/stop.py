"""The stop of one motion: why it was asked for, which one it is, and its commands one by one.

Here: the choice between a stop along the verified path and one of each joint on its own, and its progress. Not here:
when a motion stops and what its phases are called (`motion`), the shapes of stops (`safety`). `MotionProgram` owns one.

A stop keeps to the verified path where it can: on the table and in a re-entry, with a reason that leaves the table
above suspicion, and with room for it in the limits. Else each joint stops on its own: on the start ramp, after a
verdict on the table's own command, after an internal error.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from fri_client.handover.ring import EventCode
from fri_client.motion.stop_reason import StopKind, StopReason
from safety.guard import CommandGuard, GuardVerdict, Judged
from safety.limits import JointLimits
from safety.path_stop import PathStop
from safety.ramps import Ramp, RampError, plan_stop_ramp


class MotionStop:
    """`ask`, then `plan` at the last command that moved along the path, then `propose` and `commit` per command.

    asked: the reason the stop was asked for, None where the motion is to go on or came to its end. reason: the same,
    or why no stop inside the limits was found. overruled: commands of the stop that went out although the arm does not
    follow. is_refused: the guard does not let the next command of the stop go out.
    """

    def __init__(self, limits: JointLimits, guard: CommandGuard, end_ramp: Ramp, command_period_s: float) -> None:
        """end_ramp: the stop from the last row of the last period, planned ahead."""
        self._limits = limits
        self._guard = guard
        self._end_ramp = end_ramp
        self._command_period_s = command_period_s
        self._ramp: Ramp | PathStop | None = None
        self._path_tried = False
        self._steps = 0
        self._is_over = False
        self._planned: StopKind | None = None
        self._objected = False
        self.is_refused = False
        self.asked: StopReason | None = None
        self.reason: StopReason | None = None
        self.overruled = 0

    @property
    def kind(self) -> StopKind | None:
        """How the arm stops; None before the first command of the stop went out."""
        return self._planned if self._steps else None

    @property
    def duration_s(self) -> float:
        """Time from the last command of the motion to the first at rest, s; 0 while no stop is planned."""
        return 0.0 if self._ramp is None or not self._steps else self._ramp.duration_s

    @property
    def rows(self) -> float:
        """Rows of the table a stop on the path goes on for; 0 for any other."""
        return self._ramp.rows if isinstance(self._ramp, PathStop) else 0.0

    def ask(self, reason: StopReason) -> None:
        """Ask for a stop; the first reason counts."""
        if self.asked is None:
            self.asked = self.reason = reason

    def plan(self, along_path: Callable[[], PathStop | None] | None, *, table_is_done: bool) -> None:
        """Choose the stop from the guard's state.

        along_path: plans the stop on the path from the last command, None where there is none. table_is_done: that
        was the last row of the last period.
        """
        self._steps = 0
        self._ramp = None if along_path is None else self._on_path(along_path)
        self._planned = "joint_space" if self._ramp is None else "path"
        if self._ramp is not None:
            return
        if self.asked is None and table_is_done:
            self._ramp = self._end_ramp
            return
        guard = self._guard
        try:
            self._ramp = plan_stop_ramp(guard.position, guard.velocity, guard.acceleration, self._limits)
        except RampError as error:
            # Better late than not at all: the firmest stop there is; without one, the last accepted command is held.
            self._ramp = error.firmest
            if self.reason is None:
                self.reason = StopReason(EventCode.RAMP_ERROR, str(error), error.joint or 0, error.value, error.limit)

    def abandon(self) -> None:
        """The arm stands already: nothing of the stop follows."""
        self._is_over = True

    def propose(self, measured_position: Sequence[float] | None) -> Judged | None:
        """The next command of the stop; None where there is none (any more), or where `is_refused`.

        The stop was checked against every limit when it was planned. What the guard can still say against it is that
        the arm does not follow, and stopping remains the best answer to that; or that it was planned from a state that
        is no longer the last one that went out, and then nothing goes out.
        """
        ramp = self._ramp
        self.is_refused = self._objected = False
        if ramp is None or self._is_over:
            return None
        command = ramp.position_at((self._steps + 1) * self._command_period_s)
        outcome = self._guard.examine(command, measured_position, stopping=True)
        if isinstance(outcome, GuardVerdict) and outcome.criterion == "distance_to_measured":
            self._objected = True
            outcome = self._guard.examine(command, None, stopping=True)
        if isinstance(outcome, GuardVerdict):
            self.is_refused = True
            return None
        return outcome

    def commit(self) -> None:
        """The command last proposed went out."""
        ramp = self._ramp
        if ramp is None or self._is_over:
            return
        self._steps += 1
        self.overruled += self._objected
        self._is_over = self._steps * self._command_period_s >= ramp.duration_s

    def _on_path(self, plan: Callable[[], PathStop | None]) -> PathStop | None:
        """The stop that keeps to the path, or None; tried once: a fault in it costs a tick and not the stop."""
        if self._path_tried or (self.asked is not None and not self.asked.path_is_good):
            return None
        self._path_tried = True
        return plan()
