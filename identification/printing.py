"""How a value object shows itself: at a Python prompt as a table in plain text, in a notebook as one in HTML.

Here: the table, and the base class of what prints as one. Not here: what each object shows of itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from html import escape

from identification.text_table import aligned_lines


@dataclass(frozen=True, slots=True)
class Table:
    """Rows of text under a header, with sentences above; prints for a terminal and for a notebook."""

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    sentences: tuple[str, ...] = ()

    def __str__(self) -> str:
        """The sentences, then the table as plain text."""
        return "\n".join([*self.sentences, *(aligned_lines(self.header, self.rows) if self.header else ())])

    def to_html(self) -> str:
        """The same as HTML."""
        head = "".join(f"<th>{escape(cell)}</th>" for cell in self.header)
        body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in self.rows)
        text = "".join(f"<p>{escape(sentence)}</p>" for sentence in self.sentences)
        return text + (f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>" if self.header else "")


class Printed:
    """Prints as its `table`."""

    __slots__ = ()

    @property
    def table(self) -> Table:
        """What is shown of it."""
        raise NotImplementedError

    def __str__(self) -> str:
        return str(self.table)

    def __repr__(self) -> str:
        return str(self.table)

    def _repr_html_(self) -> str:
        return self.table.to_html()
