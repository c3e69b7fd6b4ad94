"""Runs the code of the next answer once, without effect, while the loop waits for the message.

That fills the processor's caches: after a millisecond of sleep they are cold, and that was a third of the turn-around.
"""

from __future__ import annotations

from collections.abc import Callable

from fri_client.loop.answer_ahead import AnswerAhead
from fri_client.loop.channel import Channel
from fri_client.loop.gate import CommandGate
from fri_client.loop.stop_watch import StopWatch
from fri_client.session.session import Session

_BEFORE_NS = 200_000
"""So long before the next message is due: ten times what an answer takes, and more than the kernel is late with a
time-out."""


class Rehearsal:
    """`wait` before each receive whose answer is ready."""

    def __init__(
        self,
        channel: Channel,
        session: Session,
        gate: CommandGate,
        ahead: AnswerAhead,
        stop_watch: StopWatch,
        clock_ns: Callable[[], int],
    ) -> None:
        self._channel = channel
        self._session = session
        self._gate = gate
        self._ahead = ahead
        self._stop_watch = stop_watch
        self._clock_ns = clock_ns

    def wait(self, last: memoryview, received_ns: int) -> None:
        """Wait for a message as the receive does, and shortly before it is due go through its answer.

        last: the datagram before it, received at that time, ns. Nothing is taken out of the channel or sent.
        """
        due_ns = received_ns + (self._session.send_period_ms or 0) * 1_000_000
        spare_ns = due_ns - _BEFORE_NS - self._clock_ns()
        if self._session.clock.simulated or spare_ns <= 0 or self._channel.wait(spare_ns * 1e-9):
            return
        self._ahead.rehearse(bytes(last))
        self._gate.is_expected(due_ns)
        if not self._stop_watch.is_asked:
            self._channel.is_waiting()
