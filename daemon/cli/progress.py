"""How far a computation is: a bar with the time that remains for a reader at a terminal, plain lines for a log.

Here: the drawing, nothing of what is computed.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from daemon.cli.output import is_quiet, message

if TYPE_CHECKING:
    from rich.progress import Progress

Show = Callable[[str, float], None]

_shown: list[Progress] = []
"""The bars on the terminal, the innermost last."""


@contextmanager
def bar_put_away() -> Iterator[None]:
    """No bar while somebody is asked: it is drawn anew twice a second, over the question."""
    for bar in _shown:
        bar.stop()
    try:
        yield
    finally:
        for bar in _shown:
            bar.start()


@contextmanager
def progress_shown(*, lines: bool = True) -> Iterator[Show]:
    """A function to call with what is done now and the share that is done, 0 to 1, as often as one likes.

    On a terminal a bar; it goes when the block ends. Elsewhere one line each time another thing is done, or none with
    lines=False, for a caller whose other messages say it.
    """
    if is_quiet() or not sys.stderr.isatty():
        last = ""

        def show_line(text: str, share: float) -> None:
            nonlocal last
            if lines and text != last:
                message(f"[{100 * share:3.0f} %] {text}")
            last = text

        yield show_line
        return
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn
    from rich.table import Column

    from daemon.cli.terminal import console_of

    with Progress(
        TextColumn("{task.description}", markup=False, table_column=Column(no_wrap=True, overflow="ellipsis", ratio=1)),
        BarColumn(bar_width=20),
        TaskProgressColumn(),
        TimeRemainingColumn(),
        console=console_of(sys.stderr),
        refresh_per_second=2,
        transient=True,
        expand=True,
    ) as bar:
        task = bar.add_task("", total=1.0)
        _shown.append(bar)
        try:
            yield lambda text, share: bar.update(task, description=text, completed=share)
        finally:
            _shown.remove(bar)
