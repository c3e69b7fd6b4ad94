"""Questions to whoever sits at the terminal, before an arm moves."""

from __future__ import annotations

import contextlib
import sys
import termios

import typer


def agreed(question: str, *, abort: bool = False) -> bool:
    """The answer at the terminal. What was typed before the question stood there is no answer to it: forgotten.

    abort: raise typer.Abort for a no. Raises KeyboardInterrupt for a Ctrl-C, which is no answer.
    """
    with contextlib.suppress(termios.error, OSError):  # no terminal
        termios.tcflush(sys.stdin, termios.TCIFLUSH)
    try:
        return typer.confirm(question, abort=abort, err=True)
    except typer.Abort as end:
        if isinstance(end.__context__, KeyboardInterrupt):
            raise KeyboardInterrupt from None
        raise
