"""The gate: the one place from which anything goes out to the robot.

Here: which of the robot's cycles a command would reach, whether a position may go out in it, and the bookkeeping of
what really went out. Nothing else holds the channel's `send`. Not here: which position is wanted (`pilot`, `motion`).

A position goes out only as a `Judged` of the guard: judged against the last position that went out, and against no
other. So velocity and acceleration are always those between commands that went out, whatever was planned, refused by
the network, or lost to a stall in between. The gate adds the robot's time (`Pace`):

- Too early: the robot may still be in the cycle of the last command, or cannot have sent this message yet. A second
  command would replace the first, and both steps would reach the arm as one. Nothing goes out; the robot bridges a
  cycle without a command. An answer that left near the end of its cycle may have reached the next one: what counts is
  the latest cycle that it may have reached.
- Next: one step follows the last one. Up to 10 ms without a command the robot bridges (`re_entry`).
- Unclear: on the edge of that time. Nothing goes out until it is over for sure.
- Stands: the robot has had no command for longer, and stands on the last one. The next begins from rest.

A command that only repeats the last one of an arm at rest is good at any time.

What is decided for a message is worth nothing once its cycle is over: an answer that a stall made late does not go out.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from enum import IntEnum
from typing import NamedTuple

from fri_client.loop.channel import Address, Channel
from fri_client.motion.re_entry import BRIDGED_S
from fri_client.session.robot_clock import EARLY_NS, Moment, RobotClock
from fri_client.session.robot_counter import WRAP
from safety.guard import CommandGuard, Judged

_IN_CYCLE = 0.8
"""Share of a send period within which an answer still reaches the cycle of its message: what is left is twice the way
through the network, 0.1 ms each on a plain cable. Two commands have reached two cycles for sure if they left no nearer
than a command period less this."""

_LATE_APART = 0.8
"""Share of a period by which an answer to a late message leaves after the last one at least. That it reaches another
cycle follows from where cycles begin alone, which forgeries may have told wrongly; a message that is not late was sent
by the robot in its own cycle."""

_EDGE_NS = 600_000
"""What may be wrong in a time between two commands: how unevenly messages arrive."""


class Pace(IntEnum):
    """Where in the robot's time a command would arrive, seen from the last one."""

    FIRST = 0
    TOO_EARLY = 1
    NEXT = 2
    UNCLEAR = 3
    STANDS = 4


_FIRST, _TOO_EARLY, _NEXT, _UNCLEAR, _STANDS = Pace
"""Looked up at every tick: the names of an enumeration are slow."""


class _Window(NamedTuple):
    """The times of receipt, ns, from and before which a message that was expected gets its answer: the gate admits it.

    due_ns: of the clock when this was worked out. over_ns: when the answer has left at the latest.
    """

    judged: Judged
    moment: Moment
    due_ns: int
    from_ns: int
    before_ns: int
    over_ns: int


class CommandGate:
    """`pace` for a message, then `send` for a position that the guard judged, or `send_header`.

    What `send` asks may be asked while nobody waits: `expect` the next message, then `send_expected`.

    guard: judges positions; another one once the robot has said its period. clock_ns: CLOCK_MONOTONIC. last_send_ns:
    when anything went out last, 0: never.
    """

    def __init__(self, channel: Channel, clock: RobotClock, clock_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self._channel = channel
        self._clock = clock
        self._clock_ns = clock_ns
        self._at_ns: int | None = None  # beginning of the earliest cycle that the last position may have reached
        self._latest_ns = 0  # and of the latest one
        self._at_counter = 0
        self._left_ns = 0  # when that position left
        self._landed_ns = 0  # so much later it has reached the robot for sure, before the message that came then left
        self._period_ns = self._bridged_ns = self._edge_ns = self._phase_ns = self._in_cycle_ns = self._apart_ns = 0
        self._send_period_ns = self._apart_by_ns = self._late_apart_ns = 0
        self._samples = 1
        self._window: _Window | None = None
        self.guard: CommandGuard | None = None
        self.last_send_ns = 0

    def use(self, guard: CommandGuard, command_period_s: float, samples_per_command: int) -> None:
        """Judge by this guard from now on, at this command period and receive multiplier; nothing is known of where the
        arm is.
        """
        self.guard = guard
        period_ns = self._period_ns = round(command_period_s * 1e9)
        self._samples = samples_per_command
        # Half a period behind the last command that still comes within what the robot bridges, in whole periods.
        self._bridged_ns = (2 * (round(BRIDGED_S * 1e9) // period_ns) + 3) * period_ns // 2
        # At which message of several the robot's command cycle begins is not told: it may end with the next one.
        self._in_cycle_ns = int(_IN_CYCLE * period_ns / samples_per_command)
        self._apart_ns = period_ns - self._in_cycle_ns
        self._send_period_ns = period_ns // samples_per_command
        self._apart_by_ns = period_ns - self._send_period_ns // 2
        self._late_apart_ns = int(_LATE_APART * period_ns)
        self._phase_ns = (period_ns - period_ns // samples_per_command) // 2
        self._edge_ns = max(min(4 * period_ns // 10, _EDGE_NS), self._phase_ns)
        self._at_ns = self._window = None

    @property
    def is_followed(self) -> bool:
        """Whether a position went out that the robot may still stand on."""
        return self._at_ns is not None

    def forget(self) -> None:
        """The robot does not command any more: the next position is the first one."""
        self._at_ns = self._window = None
        if self.guard is not None:
            self.guard.release()

    def pace(self, moment: Moment) -> Pace:
        """The pace at which an answer to the message of that moment would arrive."""
        at_ns = self._at_ns
        if at_ns is None:
            return _FIRST
        cycle_ns, time_ns, counter, is_late = moment
        if counter - self._at_counter & WRAP < self._samples or cycle_ns - time_ns > EARLY_NS:
            return _TOO_EARLY
        clock, edge, bridged = self._clock, self._edge_ns, self._bridged_ns
        if clock.simulated:
            edge = self._phase_ns
        elif self._is_too_near(time_ns, is_late=is_late):
            return _TOO_EARLY
        if cycle_ns - self._latest_ns < self._apart_by_ns:
            return _TOO_EARLY
        # By a message that was read late the robot may be a cycle further than the message says.
        if time_ns - at_ns < bridged - edge:
            return _NEXT
        # A forgery before the motion may have told a wrong beginning of cycles: it has to be over by our own clock too.
        stands = cycle_ns - self._latest_ns > bridged + edge and (
            clock.simulated or time_ns - self._left_ns > bridged + self._period_ns // 2
        )
        return _STANDS if stands else _UNCLEAR

    def _is_too_near(self, time_ns: int, *, is_late: bool) -> bool:
        """Whether, by our own clock, a position that leaves now may reach the robot in the cycle of the last one."""
        if time_ns - self._left_ns < (self._landed_ns if self._clock.is_settled else self._period_ns):
            return True
        return is_late and self._clock_ns() - self._left_ns < self._late_apart_ns

    def robot_stands(self, time_ns: int) -> bool:
        """Whether the robot has had no command for longer than it bridges, or none at all."""
        return self._at_ns is None or time_ns - self._latest_ns > self._bridged_ns + self._edge_ns

    def send(self, judged: Judged, datagram: bytes, address: Address, moment: Moment) -> int | None:
        """Send the position that was judged, as that datagram. When it left, ns; 0: the network refused it; None: the
        gate did.

        moment: of the message that it answers.
        """
        if not self.admits(judged, moment):
            return None
        return self._dispatch(judged, datagram, address, moment)

    def expect(self, judged: Judged, counter: int) -> None:
        """Work out when that position may go out in answer to the message after the newest one, of that counter.

        It holds until anything else goes out or another message is noted. Undisturbed motion alone is answered so, not
        a robot whose time is simulated.
        """
        clock, at_ns, guard, due_ns = self._clock, self._at_ns, self.guard, self._clock.due_ns
        self._window = None
        if clock.simulated or not clock.is_settled or due_ns is None or at_ns is None or guard is None:
            return
        if judged.generation != guard.generation or counter - self._at_counter & WRAP < self._samples:
            return
        cycle_ns = clock.cycle_of(1, due_ns)
        if cycle_ns - self._latest_ns < self._apart_by_ns:
            return
        from_ns = max(clock.earliest_ns(1), cycle_ns - EARLY_NS, self._left_ns + self._landed_ns)
        before_ns = min(2 * cycle_ns - due_ns - EARLY_NS, at_ns + self._bridged_ns - self._edge_ns)
        moment = Moment(cycle_ns, cycle_ns, counter)
        self._window = _Window(judged, moment, due_ns, from_ns, before_ns, at_ns + self._bridged_ns)

    def is_expected(self, time_ns: int) -> bool:
        """Whether the position that `expect` was told may go out now, in answer to a message received at that time."""
        window = self._window
        if window is None or window.due_ns != self._clock.due_ns or not window.from_ns <= time_ns < window.before_ns:
            return False
        now_ns = self._clock_ns()
        return now_ns - time_ns <= self._in_cycle_ns and now_ns <= window.over_ns

    def send_expected(self, datagram: bytes, address: Address, time_ns: int) -> int | None:
        """`send` for the position that `expect` was told, where the message it was told of came at that time."""
        window = self._window
        if window is None or not self.is_expected(time_ns):
            return None
        return self._dispatch(window.judged, datagram, address, window.moment)

    def _dispatch(self, judged: Judged, datagram: bytes, address: Address, moment: Moment) -> int:
        guard = self.guard
        assert guard is not None
        if not self._channel.send(datagram, address):
            return 0
        left_ns = self.last_send_ns = self._left_ns = self._clock_ns()
        self._window = None
        # What waits already may be the next message, sent before this command came, and read after any stall.
        disturbed = self._channel.is_waiting()
        self._landed_ns = self._apart_ns + disturbed * self._period_ns
        cycle_ns, _, self._at_counter, is_late = moment
        self._latest_ns = cycle_ns
        # Late (see _LATE_APART), or while a clock that is learnt anew may be wrong on where cycles begin: one before.
        self._at_ns = cycle_ns - (is_late or not self._clock.is_settled) * self._period_ns
        if not self._clock.simulated:  # on the grid of messages: at which of several a cycle begins is not told
            send_ns = self._send_period_ns
            self._latest_ns += (left_ns - cycle_ns + send_ns - self._in_cycle_ns) // send_ns * send_ns
        guard.accept(judged)
        return left_ns

    def admits(self, judged: Judged, moment: Moment) -> bool:
        """Whether that position may go out now, in answer to the message of that moment; nothing is changed by asking.

        Not one that was judged after another command than the last one, at a pace that does not allow it, or for a
        cycle that is over.
        """
        guard = self.guard
        if guard is None or judged.generation != guard.generation:
            return False
        pace = self.pace(moment)
        is_late = False
        if not self._clock.simulated:
            now_ns = self._clock_ns()
            is_late = now_ns - moment.time_ns > self._in_cycle_ns
            if pace is _NEXT and self._at_ns is not None:  # by now the bridge may be over
                is_late = is_late or now_ns - self._at_ns > self._bridged_ns
        return (pace is _NEXT and not is_late) or self._is_harmless(judged, pace, is_late=is_late)

    def _is_harmless(self, judged: Judged, pace: Pace, *, is_late: bool) -> bool:
        """Whether a position may go out at another pace than the next one, or late."""
        guard = self.guard
        assert guard is not None
        if not guard.at_rest:
            return False
        return guard.repeats(judged.command) or (not is_late and pace in (Pace.FIRST, Pace.STANDS))

    def send_header(self, datagram: bytes, address: Address) -> int:
        """Send an answer without a position, which moves nothing; when it left, ns, 0 where it did not."""
        if not self._channel.send(datagram, address):
            return 0
        self.last_send_ns = self._clock_ns()
        return self.last_send_ns
