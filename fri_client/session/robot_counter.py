"""The order of the robot's messages by their sequence counter alone (uint32, wraps; PROTOCOL section 6).

Start value and reset rules of the robot's counter are not published, so a counter that begins anew is believed only
when several messages in a row say so: one flipped bit must not look like a restarted controller.
"""

from __future__ import annotations

from enum import IntEnum

COUNTER_WINDOW = 1000
"""A sequence counter further away than this from the last one (1 s at 1 kHz) is not believed from one message alone."""

RESTART_RUN = 10
"""So many messages in a row, each one counter after the other but none of them next, prove a restarted counter."""

_HISTORY = 64
_HISTORY_MASK = (1 << _HISTORY) - 1
WRAP = 0xFFFFFFFF
"""Sequence counters go round after so many: differences are taken modulo 2³²."""


class Order(IntEnum):
    """Where a message stands among those seen."""

    NEXT = 0
    """Newer than all; `gap` messages are missing before it."""
    REPEATED = 1
    """Seen before."""
    BELATED = 2
    """Older than the newest, and counted as missing until now."""
    OLD = 3
    """Older than the counters remembered."""
    DOUBTFUL = 4
    """Too far away to be believed."""
    RESTARTED = 5
    """The robot counts anew from here."""


class RobotCounter:
    """`judge` each counter, or `refuse` it; `last` is the newest, `gap` what is missing before it.

    A refused message does not use up its counter: the good one with the same counter comes next.
    """

    def __init__(self) -> None:
        self.last = 0
        self.gap = 0
        self.expected_before_restart = 0
        self._seen = 0  # bit k: the counter last - k was seen
        self._refused = 0  # bit k: a message with the counter last + k came and was refused
        self._synchronised = False
        self._probe = -1
        self._probe_run = 0

    def resynchronise(self) -> None:
        """Take the next counter as it comes."""
        self._synchronised = False

    def steps(self, counter: int) -> int:
        """How far a counter is ahead of the newest; 0 where that means nothing."""
        step = (counter - self.last) & WRAP
        return step if self._synchronised and step <= COUNTER_WINDOW else 0

    def refuse(self, counter: int) -> None:
        """A message with this counter came, and nothing in it can be used."""
        step = self.steps(counter)
        if 0 < step < _HISTORY:
            self._refused |= 1 << step

    def judge(self, counter: int, *, in_time: bool = True) -> Order:
        """The order of one message; in_time: whether the robot can have counted so far by now (`robot_clock`)."""
        step = (counter - self.last) & WRAP
        if not self._synchronised:
            return self._start(counter, Order.NEXT)
        if 0 < step <= COUNTER_WINDOW and in_time:
            passed = self._refused & ((1 << step) - 2)
            self.gap = step - 1 - passed.bit_count()
            self._refused >>= step
            self.last = counter
            self._seen = (self._seen << step | 1) & _HISTORY_MASK if step < _HISTORY else 1
            self._probe_run = 0
            return Order.NEXT
        self.gap = 0
        self._probe_run = self._probe_run + 1 if counter == (self._probe + 1) & WRAP else 1
        self._probe = counter
        if self._probe_run >= RESTART_RUN:
            self.expected_before_restart = (self.last + 1) & WRAP
            return self._start(counter, Order.RESTARTED)
        if 0 < step <= COUNTER_WINDOW:
            return Order.DOUBTFUL
        back = -step & WRAP
        if back > COUNTER_WINDOW:
            return Order.DOUBTFUL
        if back >= _HISTORY:
            return Order.OLD
        if self._seen >> back & 1:
            return Order.REPEATED
        self._seen |= 1 << back
        return Order.BELATED

    def _start(self, counter: int, order: Order) -> Order:
        self._synchronised = True
        self.last = counter
        self.gap = 0
        self._refused = 0
        self._seen = _HISTORY_MASK  # what came before the first was never missing
        self._probe_run = 0
        return order
