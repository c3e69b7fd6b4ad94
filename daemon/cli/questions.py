"""Questions to whoever sits at the terminal, before an arm moves."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import sys
import termios
import threading
from collections.abc import Iterator
from typing import TextIO

import typer


def agreed(question: str, *, abort: bool = False) -> bool:
    """The answer at the terminal. What was typed before the question stood there is no answer to it: forgotten.

    abort: raise typer.Abort for a no. Raises KeyboardInterrupt for a Ctrl-C, which is no answer.
    """
    with contextlib.suppress(termios.error, OSError):  # no terminal
        termios.tcflush(sys.stdin, termios.TCIFLUSH)
    try:
        with _heard():
            return typer.confirm(question, abort=abort, err=True)
    except typer.Abort as end:
        if isinstance(end.__context__, KeyboardInterrupt):
            raise KeyboardInterrupt from None
        raise


@contextlib.contextmanager
def _heard() -> Iterator[None]:
    """A signal ends a question at the terminal at whatever moment it comes.

    Python looks for signals and then reads: one that comes between the two was told after the next key, and whoever
    pressed Ctrl-C believed that the question was gone.
    """
    stdin = sys.stdin
    if not _is_terminal(stdin) or threading.current_thread() is not threading.main_thread():
        yield
        return
    reads, writes = os.pipe()
    os.set_blocking(writes, False)
    before = signal.set_wakeup_fd(writes, warn_on_full_buffer=False)
    sys.stdin = _Keys(stdin, reads)
    try:
        yield
    finally:
        sys.stdin = stdin
        signal.set_wakeup_fd(before)
        os.close(reads)
        os.close(writes)


def _is_terminal(stream: TextIO) -> bool:
    with contextlib.suppress(OSError, ValueError):
        return os.isatty(stream.fileno())
    return False


class _Keys:
    """The terminal's lines; waited for together with the byte that every signal writes."""

    def __init__(self, stdin: TextIO, signals: int) -> None:
        self._stdin = stdin
        self._signals = signals

    def readline(self, *size: int) -> str:
        keys = self._stdin.fileno()
        while keys not in select.select([keys, self._signals], [], [])[0]:
            os.read(self._signals, 1)  # of one that ends nothing
        return self._stdin.readline(*size)
