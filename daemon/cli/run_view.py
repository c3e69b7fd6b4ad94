"""Watching an acquisition: what happens as lines, the live view below them on a terminal, and how it ended."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

from daemon.cli.live_view import live_thread
from daemon.cli.output import data, is_quiet, message

if TYPE_CHECKING:
    from daemon.api import RunEvent


class RunView:
    """One run before an operator: `observe` takes its events, `show_outcome` says how it ended."""

    def __init__(self, begin_live: Callable[[int], None] | None) -> None:
        self._begin_live = begin_live
        self._is_live = False
        self._warned: set[str] = set()

    def observe(self, event: RunEvent) -> None:
        """One line on stderr, but not of what the live view shows anyhow. How the run ended is left to `show_outcome`,
        which knows all of it.
        """
        if event.kind == "finished":
            return
        if event.port and self._begin_live is not None and not self._is_live:
            self._is_live = True
            self._begin_live(event.port)
        if event.kind == "progress" and event.period >= 0 and self._is_live:
            return
        if event.kind == "warning":
            self._warned.add(event.sentence)
        message(f"[{event.kind}] {event.sentence}")

    def show_outcome(self, sentences: Sequence[str], indent: str = "") -> None:
        """The run's sentences on stdout, without the warnings that stand above on the same terminal."""
        above = self._warned if sys.stdout.isatty() and sys.stderr.isatty() else set()
        for sentence in sentences:
            if sentence not in above:
                data(indent + sentence)


@contextmanager
def run_shown() -> Iterator[RunView]:
    """The view of one run; at a terminal, and without -q, with the live view while the block lasts."""
    with ExitStack() as stack:
        at_terminal = sys.stderr.isatty() and not is_quiet()
        yield RunView((lambda port: stack.enter_context(live_thread(port, sys.stderr))) if at_terminal else None)
