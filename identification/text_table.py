"""A table as plain text, a row a line, as wide as it needs to be: for a file, a pipe or a Python prompt.

Here: the layout, without rich, which takes longer to load and to draw than a table of numbers should cost. Not here:
a table at a terminal (`daemon.cli.terminal`), and where a table goes (`daemon.cli.output`).
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

BETWEEN = 2
"""Blanks between two columns of a table."""
_NUMBER = re.compile(r"[-+−]?\d[\d.]*(e[-+]\d+)?|[-–]?|nan")


def is_numeric(cells: Sequence[str]) -> bool:
    """Whether a column holds numbers and blanks only: it then stands flush right."""
    return all(_NUMBER.fullmatch(cell) for cell in cells)


def aligned_lines(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """The heads, a rule, and a line for each row, in columns."""
    columns = list(zip(heads, *rows, strict=True))
    widths = [max(map(len, column)) for column in columns]
    adjust = [str.rjust if is_numeric(column[1:]) else str.ljust for column in columns]

    def line(cells: Sequence[str]) -> str:
        placed = (put(cell, width) for put, cell, width in zip(adjust, cells, widths, strict=True))
        return (" " * BETWEEN).join(placed).rstrip()

    yield line(heads)
    yield "─" * (sum(widths) + BETWEEN * (len(widths) - 1))
    yield from map(line, rows)
