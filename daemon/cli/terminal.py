"""How lines and tables look to a reader at a terminal: colour on the words that decide, and no word cut at the edge.

Here: the drawing, with rich, which is loaded only where something is drawn. Not here: where it goes (`output`), and
tables in a file or a pipe (`identification.text_table`).
"""

from __future__ import annotations

import os
import textwrap
from collections.abc import Sequence
from typing import ClassVar, TextIO

from rich import box
from rich.cells import cell_len
from rich.console import Console
from rich.highlighter import RegexHighlighter
from rich.table import Table
from rich.text import Text
from rich.theme import Theme

from identification.text_table import BETWEEN, is_numeric

_THEME = Theme({"verdict.good": "green", "verdict.bad": "bold red", "verdict.doubt": "yellow"})
_ENDLESS = 10_000
"""Columns where there is no edge: in a file or a pipe."""


class _Verdicts(RegexHighlighter):
    """Colours the words that decide: good, bad, and what is not sure."""

    base_style = "verdict."
    highlights: ClassVar[list[str]] = [
        r"(?P<good>\bok\b|\bmet\b|\bsafe to run\b|\bNamed rightly\b|^No mismatch|^Explained)",
        r"(?P<doubt>\b(NOT|not) confirmed\b|\bunconfirmed\b|\bwarning\b|^Partly explained|\bNot named\b)",
        r"(?P<bad>\bNOT (safe|SAFE|MET)\b|\bFAILED\b|\bfailed\b|\bTOO CLOSE\b|\bVIOLATED\b|\bRISES\b|\bINVERTED\b"
        r"|\bWRONG\b|\bWILL MOVE\b|^Unexplained)",
    ]


def console_of(stream: TextIO) -> Console:
    """A console on a stream that colours verdicts; a stream that is no terminal gets neither colour nor a width."""
    return Console(
        file=stream, theme=_THEME, highlighter=_Verdicts(), markup=False, emoji=False,
        width=None if stream.isatty() else _ENDLESS, color_system=None if os.environ.get("NO_COLOR") else "auto",
    )  # fmt: skip


def drawn_lines(text: str, stream: TextIO) -> str:
    """Text as a terminal shows it: lines broken between words, verdicts coloured."""
    console = console_of(stream)
    lines = (piece for line in text.split("\n") for piece in wrapped(line, console.width))
    with console.capture() as captured:
        for line in lines:
            console.print(_Verdicts()(Text(line)), soft_wrap=True)
    return captured.get()


def wrapped(line: str, width: int) -> list[str]:
    """A line in pieces no longer than `width`, broken between words only; a longer word stands whole on its own."""
    if len(line) <= width:
        return [line]
    indent = " " * (len(line) - len(line.lstrip(" ")))
    pieces = textwrap.wrap(line, width, subsequent_indent=indent + "  ", break_long_words=False, break_on_hyphens=False)
    return pieces or [line]


def drawn_table(heads: Sequence[str], rows: Sequence[Sequence[str]], stream: TextIO) -> str | None:
    """A table no wider than a terminal, with no word cut; None where the longest words do not fit side by side."""
    console = console_of(stream)
    columns = list(zip(heads, *rows, strict=True))
    least = [max(cell_len(word) for cell in column for word in cell.split() or [""]) for column in columns]
    wanted = [max(map(cell_len, column)) for column in columns]
    room = console.width - BETWEEN * (len(columns) - 1)
    if sum(least) > room:
        return None
    shown = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False, highlight=True, show_edge=False)
    for head, column, width in zip(heads, columns, _widths(least, wanted, room), strict=True):
        shown.add_column(head, justify="right" if is_numeric(column[1:]) else "left", width=width)
    for row in rows:
        shown.add_row(*row)
    with console.capture() as captured:
        console.print(shown)
    return "\n".join(line.rstrip() for line in captured.get().split("\n"))


def _widths(least: list[int], wanted: list[int], room: int) -> list[int]:
    """Column widths between the longest word and the longest cell, what is left over shared among the long ones."""
    widths, spare = list(least), room - sum(least)
    by_need = sorted(range(len(least)), key=lambda place: wanted[place] - least[place])
    for done, place in enumerate(by_need):
        more = min(wanted[place] - least[place], spare // (len(by_need) - done))
        widths[place] += more
        spare -= more
    return widths
