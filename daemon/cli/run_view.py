"""Watching an acquisition: what happens as lines, how far the motion is as a bar, and how it ended."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from daemon.cli.output import data, message
from daemon.cli.progress import Show, progress_shown

if TYPE_CHECKING:
    from daemon.api import RunEvent

__all__ = ["RunView", "run_shown"]


class RunView:
    """One run before an operator: `observe` takes its events, `show_outcome` says how it ended."""

    def __init__(self, show: Show) -> None:
        self._show = show
        self._warned: set[str] = set()

    def observe(self, event: RunEvent) -> None:
        """One line on stderr, or the bar moves. How the run ended is left to `show_outcome`, which knows all of it."""
        if event.kind == "finished":
            return
        if event.kind == "progress" and event.period >= 0:
            self._show(f"Period {event.period + 1} of {event.periods}", event.period / max(event.periods, 1))
            if sys.stderr.isatty():
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
    """The view of one run, its bar shown while the block lasts."""
    with progress_shown(lines=False) as show:
        yield RunView(show)
