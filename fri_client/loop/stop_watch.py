"""Everything from outside the session that may ask a moving arm to stop, looked at once per tick.

Signals, the supervisor's request, the age of its heartbeat, and the recorder's backlog. The loop polls; nothing
here waits.
"""

from __future__ import annotations

import signal
import time

from fri_client.handover.ring import EventCode, HandoverRing
from fri_client.motion.program import StopReason

_PATIENCE_S = 1.5

_SENTENCES = {
    EventCode.OPERATOR_STOP: "The operator asked for a stop.",
    EventCode.SIGNAL_STOP: "The supervising process was told to end.",
    EventCode.TERMINAL_CLOSED: "The terminal of the run was closed, or the connection to it was lost.",
    EventCode.RECORDER_LOST: "The recorder was lost.",
    EventCode.DISK_FULL: "The disk refused further samples.",
    EventCode.SUPERVISOR_LOST: "The supervising process was lost.",
}

ENDED_BY_SOMEBODY = (EventCode.OPERATOR_STOP, EventCode.SIGNAL_STOP, EventCode.TERMINAL_CLOSED)
"""Requests of a person or of the system; all others are troubles."""


class StopWatch:
    """`poll` names the first reason there is to stop; `signal_number` is set by a signal handler."""

    def __init__(self, ring: HandoverRing, supervisor_timeout_s: float) -> None:
        self._ring = ring
        self._supervisor_timeout_ns = int(supervisor_timeout_s * 1e9)
        self.signal_number = 0

    @property
    def is_asked(self) -> bool:
        """Whether somebody asked for a stop, which counts in this very cycle. `poll` finds all other reasons."""
        return bool(self.signal_number or self._ring.stop_request)

    def poll(self, now_ns: int) -> StopReason | None:
        """The reason to stop at now_ns (CLOCK_MONOTONIC), None where there is none."""
        if self.signal_number:
            return StopReason(EventCode.SIGNAL_STOP, f"{_signal_name(self.signal_number)} asked for a stop.")
        ring = self._ring
        request = ring.stop_request
        if request:
            return _requested(request)
        # A supervisor that never gave a sign of life does not watch this run: the loop then stands on its own.
        heartbeat = ring.heartbeat_ns
        if heartbeat and 0 < self._supervisor_timeout_ns < now_ns - heartbeat:
            age, limit = (now_ns - heartbeat) / 1e9, self._supervisor_timeout_ns / 1e9
            sentence = f"The supervising process gave no sign of life for {age:.1f} s ({limit:g} s allowed)."
            return StopReason(EventCode.SUPERVISOR_LOST, sentence, 0, age, limit)
        if ring.consumer_stalled:
            sentence = f"The recorder is {ring.backlog} of {ring.slots} records behind; samples would soon be lost."
            return StopReason(EventCode.RECORDER_LOST, sentence, 0, ring.backlog, 0.8 * ring.slots)
        return None


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"Signal {number}"


def _requested(request: int) -> StopReason:
    """A request with an unknown code is a stop all the same."""
    try:
        code = EventCode(request)
    except ValueError:
        code = EventCode.OPERATOR_STOP
    if not code.is_stop_reason:
        code = EventCode.OPERATOR_STOP
    return StopReason(code, _SENTENCES.get(code, f"A stop was asked for ({code.name})."))


class RecorderPatience:
    """In simulated time only: lets a recorder catch up when the ring is half full, unless it does not move at all.

    The robot's next message waits meanwhile. One wait is so short that the robot does not count the answer as missed.
    """

    def __init__(self, ring: HandoverRing) -> None:
        self._ring = ring
        self._stuck_at = -1

    def wait(self) -> None:
        """Return at once, or when the ring is half empty, or after _PATIENCE_S."""
        ring = self._ring
        half = ring.slots // 2
        if ring.backlog <= half:
            return
        consumed = ring.produced - ring.backlog
        if consumed == self._stuck_at:
            return
        deadline = time.monotonic() + _PATIENCE_S
        while ring.backlog > half and time.monotonic() < deadline:
            time.sleep(0.001)
        if ring.produced - ring.backlog == consumed:
            self._stuck_at = consumed
