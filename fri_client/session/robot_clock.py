"""The robot's own time, as far as the client can know it: when a message can have been sent at the earliest.

The robot sends one message per send period and counts them, so its sequence counter is a clock; messages arrive late,
never early. A counter that runs ahead of time is a jump, a forgery or a damaged datagram, whatever else the message
says.

Time is when the message was received, ns of CLOCK_MONOTONIC. A robot whose time is simulated (`simulated`) says it
itself in each message's time stamp, and then that stamp is the time: such a robot waits for answers, and how long its
milliseconds take means nothing.
"""

from __future__ import annotations

from typing import NamedTuple

from fri_client.messages import MonitoringMessage

_WINDOW = 512
"""Messages over which the earliest arrival is looked for: the clocks of two machines drift apart by some 50 µs in so
many milliseconds, and a robot that paused goes on later for good."""

_SETTLED = 20
"""Messages after a start that are taken as they come: the first ones may have waited in the channel, and only a later
one shows how early messages can be."""

_EARLY = 0.25
"""Share of a period by which a message may be earlier than the earliest one seen: clocks are not perfectly even."""

_LEARNT_NS = 20_000
"""By so little at most one early message makes the next ones expected earlier."""


EARLY_NS = 50_000
"""By so much a message may come before the robot's cycle begins that it belongs to, ns: the answer needs twice the way
through the network, so it still comes after that."""


class Moment(NamedTuple):
    """Where in the robot's time a message belongs, ns: the cycle that went on when it was received, when that was, and
    the robot's counter. is_late: the robot sent the message in an earlier cycle, if its cycles begin where we think.
    """

    cycle_ns: int
    time_ns: int
    counter: int
    is_late: bool = False


class RobotClock:
    """`time_of` a message, whether the clock `admits` its counter, and `note` it once it is believed.

    due_ns: the earliest time of the newest message; None before any.
    """

    def __init__(self) -> None:
        self.simulated = False
        self._period_ns = 0
        self.due_ns: int | None = None
        self._least_late_ns = 0
        self._noted = 0
        self._settling = _SETTLED

    def time_of(self, message: MonitoringMessage, receive_ns: int) -> int:
        """Time of a message, ns; only differences mean something."""
        if not self.simulated:
            return receive_ns
        monitor = message.monitor_data
        stamp = None if monitor is None else monitor.timestamp
        return receive_ns if stamp is None else stamp.sec * 1_000_000_000 + stamp.nanosec

    def reset(self) -> None:
        """Take the next message as it comes."""
        self.due_ns = None

    @property
    def is_settled(self) -> bool:
        """Whether enough messages came to know how early they can be: before, any counter is taken as it comes."""
        return self.simulated or (self.due_ns is not None and not self._settling)

    def admits(self, steps: int, time_ns: int) -> bool:
        """Whether the robot can have sent, by that time, the message `steps` counters after the newest one."""
        if self.due_ns is None or (self._settling and not self.simulated):
            return True
        return time_ns >= self.earliest_ns(steps)

    def earliest_ns(self, steps: int) -> int:
        """From when on the message `steps` counters after the newest one is believed, ns; some message was noted."""
        assert self.due_ns is not None
        return self.due_ns + steps * self._period_ns - int(_EARLY * self._period_ns)

    def cycle_of(self, steps: int, time_ns: int) -> int:
        """When the robot's cycle began that goes on at that time, ns, seen from the message `steps` after the newest.

        That message tells where cycles begin; whole periods by which it is late have passed as well.
        """
        if self.due_ns is None or not self._period_ns:
            return time_ns
        due = self.due_ns + steps * self._period_ns
        return due + max(0, time_ns - due + EARLY_NS) // self._period_ns * self._period_ns

    def moment(self, steps: int, time_ns: int, counter: int) -> Moment:
        """Where the message of that counter belongs, `steps` after the newest one, if it comes at that time."""
        cycle_ns = self.cycle_of(steps, time_ns)
        due_ns = cycle_ns if self.due_ns is None else self.due_ns + steps * self._period_ns
        return Moment(cycle_ns, time_ns, counter, cycle_ns > due_ns)

    def next_moment(self, time_ns: int, counter: int) -> Moment | None:
        """Of the message after the newest, if it came at that time; None where the robot cannot have sent it yet."""
        return self.moment(1, time_ns, counter) if self.admits(1, time_ns) else None

    def note(self, steps: int, time_ns: int, period_ms: int | None) -> None:
        """The message `steps` after the newest one came at that time; period_ms: the send period that it states."""
        period_ns = (period_ms or 0) * 1_000_000
        if self.due_ns is None or period_ns != self._period_ns:
            self._period_ns = period_ns
            self.due_ns = time_ns
            self._noted = 0
            self._settling = _SETTLED
            self._least_late_ns = self._period_ns * _WINDOW
            return
        due = self.due_ns + steps * self._period_ns
        late = time_ns - due
        if late < 0:
            # A way that became quicker is learnt in small steps: one early message may be a forgery.
            due, late = due - (-late if not self.is_settled else min(-late, _LEARNT_NS)), 0
        if late < self._least_late_ns:
            self._least_late_ns = late
        self._noted += 1
        if self._settling:
            self._settling -= 1
        if self._noted == _WINDOW:
            due += self._least_late_ns
            self._noted = 0
            self._least_late_ns = self._period_ns * _WINDOW
        self.due_ns = due
