"""Signals that end a process, taken over while a block runs; the handlers before are put back. Loads nothing else."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from types import FrameType


@contextlib.contextmanager
def handled(
    numbers: Iterable[int], handler: Callable[[int, FrameType | None], None] | signal.Handlers
) -> Iterator[None]:
    """These signals go to the handler while the block runs, in the main thread; elsewhere nothing changes.

    A SIGHUP that was ignored before stays ignored: who says `nohup` wants the run to outlive the terminal. SIGINT and
    SIGTERM always count, though a shell's script has its background jobs ignore SIGINT: they have to stop the arm.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    taken = (each for each in numbers if each != signal.SIGHUP or signal.getsignal(each) is not signal.SIG_IGN)
    before = {number: signal.signal(number, handler) for number in taken}
    try:
        yield
    finally:
        for number, earlier in before.items():
            signal.signal(number, earlier)


def ends_as_interrupts() -> contextlib.AbstractContextManager[None]:
    """SIGTERM and a closed terminal are a Ctrl-C while the block runs: what it opened is closed, and left nowhere."""

    def interrupt(number: int, frame: FrameType | None) -> None:
        del number, frame
        raise KeyboardInterrupt

    return handled((signal.SIGTERM, signal.SIGHUP), interrupt)
