"""The way of a stop from whoever asks to the loop of a running acquisition: one word in the ring, no queue, no peer.

Here: `StopHandle`, which the supervisor of a run attaches to its ring, and the signals that use it. The long-running
service asks through it from its control thread while the run's own thread is busy; the foreground run from its signal
handlers. What the loop does with the word is `fri_client.loop.stop_watch`.
"""

from __future__ import annotations

import contextlib
import signal
import threading
import time
from collections.abc import Iterator
from types import FrameType

from daemon.signals import handled
from fri_client.handover.ring import EventCode, HandoverRing

SIGNALS = {
    int(signal.SIGINT): EventCode.OPERATOR_STOP,
    int(signal.SIGTERM): EventCode.SIGNAL_STOP,
    int(signal.SIGHUP): EventCode.TERMINAL_CLOSED,
}


class StopHandle:
    """Asks the loop of one acquisition to stop; usable from any thread, before, during and after the run.

    A request made before the ring exists is kept and put into the ring as soon as there is one. The first request
    counts; a further one changes nothing. watched_by_s: with a number, `alive` is true only while `tick` was called
    within so many seconds: an acquisition whose operator cannot be heard any more must not go on.
    """

    def __init__(self, *, watched_by_s: float | None = None) -> None:
        # Re-entrant: a signal handler may interrupt the thread that holds it.
        self._lock = threading.RLock()
        self._ring: HandoverRing | None = None
        self._code = 0
        self._watched_by_s = watched_by_s
        self._ticked = time.monotonic()
        self.signal_number: int | None = None
        self.signals = 0
        """How many came."""

    def request(self, code: EventCode = EventCode.OPERATOR_STOP) -> bool:
        """Ask for the stop ramp; False where it had been asked for before. Takes microseconds and never waits."""
        with self._lock:
            first = not self._code
            if first:
                self._code = int(code)
            if self._ring is not None and not self._ring.stop_request:
                self._ring.request_stop(self._code)
            return first

    @property
    def requested(self) -> bool:
        """Whether a stop was asked for through this handle."""
        return bool(self._code)

    def tick(self) -> None:
        """The thread that hears the operator lives."""
        self._ticked = time.monotonic()

    @property
    def alive(self) -> bool:
        """Whether the operator could be heard: always, where nobody promised to tick."""
        return self._watched_by_s is None or time.monotonic() - self._ticked < self._watched_by_s

    @contextlib.contextmanager
    def attached(self, ring: HandoverRing) -> Iterator[None]:
        """Requests reach this ring while the block runs; one made before reaches it now."""
        with self._lock:
            self._ring = ring
            if self._code:
                ring.request_stop(self._code)
        try:
            yield
        finally:
            with self._lock:
                self._ring = None

    @contextlib.contextmanager
    def on_signals(self) -> Iterator[None]:
        """SIGINT, SIGTERM and SIGHUP (a closed terminal) become a request while the block runs, in the main thread;
        elsewhere nothing changes.
        """

        def stop(number: int, frame: FrameType | None) -> None:
            del frame
            self.signal_number = number
            self.signals += 1
            self.request(SIGNALS[number])

        with handled(SIGNALS, stop):
            yield
