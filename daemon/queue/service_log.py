"""What the service says: the last lines for who asks, and each line to the terminal or the journal.

A terminal that is held or a pipe that nobody reads must not keep the control thread from hearing a stop, so a thread
of its own writes, and lines that find no room are left out.
"""

from __future__ import annotations

import contextlib
import queue
import threading
import time
from collections import deque
from collections.abc import Callable

_RECENT = 20
_QUEUED_LINES = 1000
_LINES_ALLOWANCE_S = 1.0


class ServiceLog:
    """Lines of the service; `tell` never waits."""

    def __init__(self, write: Callable[[str], None]) -> None:
        """write: one line for the log; may wait."""
        self._recent: deque[str] = deque(maxlen=_RECENT)
        self._lines: queue.Queue[str] = queue.Queue(_QUEUED_LINES)
        self._write = write
        threading.Thread(target=self._write_lines, name="log lines", daemon=True).start()

    @property
    def recent(self) -> tuple[str, ...]:
        """The last lines, the newest last."""
        return tuple(self._recent)

    def tell(self, sentence: str) -> None:
        """Take one line."""
        self._recent.append(sentence)
        with contextlib.suppress(queue.Full):
            self._lines.put_nowait(sentence)

    def close(self) -> None:
        """Wait, but not for long, until all lines are written."""
        deadline = time.monotonic() + _LINES_ALLOWANCE_S
        while self._lines.unfinished_tasks and time.monotonic() < deadline:
            time.sleep(0.01)

    def _write_lines(self) -> None:
        while True:
            line = self._lines.get()
            with contextlib.suppress(OSError):
                self._write(line)
            self._lines.task_done()
