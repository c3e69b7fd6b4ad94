"""What a report is made of: sections of paragraphs, facts, tables and figures, as value objects without any markup.

Here: the shapes and nothing else; every text is plain and is escaped where it is rendered (`page`). Built by the
section modules, rendered by `page`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

from identification.arrays import FloatArray

Tone = Literal["good", "attention", "neutral"]
"""Whether a reader may be content, has to look closer, or is not told."""

Style = Literal["measured", "before", "after", "noise", "fitted"]
"""What a line stands for; it fixes colour, width and dashes all over the report (`panels`)."""


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """One line of a panel. x, y: (S,) in the units of the axes; gaps are nan. band: (S,) half width around y, or None.

    marks: "line", "dots" (with the band as error bars) or "star" (with nothing between).
    """

    style: Style
    x: FloatArray
    y: FloatArray
    band: FloatArray | None = None
    marks: Literal["line", "dots", "star"] = "line"


@dataclass(frozen=True, slots=True, eq=False)
class Panel:
    """One small plot. description: what a reader who does not see it should know.

    floor: standard deviation of the noise, drawn on both sides of zero, in the units of y, or None. logarithmic: both
    axes. equal: one scale for both axes. chances: y is a probability, drawn from 0 to 1, and x counts.
    """

    title: str
    x_label: str
    y_label: str
    lines: tuple[Line, ...]
    description: str
    floor: float | None = None
    logarithmic: bool = False
    equal: bool = False
    chances: bool = False


@dataclass(frozen=True, slots=True)
class Paragraph:
    """Text; kind "lead" is read first, "warning" must not be missed, "note" may be skipped."""

    block: ClassVar[str] = "paragraph"
    text: str
    kind: Literal["plain", "lead", "warning", "note"] = "plain"


@dataclass(frozen=True, slots=True)
class Heading:
    """The title of a part of a section."""

    block: ClassVar[str] = "heading"
    text: str


@dataclass(frozen=True, slots=True)
class Facts:
    """Terms with their texts."""

    block: ClassVar[str] = "facts"
    entries: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class Table:
    """A table whose first column names the rows. Cells are texts, numbers already rounded; kind: what most hold.

    links: for each row the address that its name leads to, or None; tones: for each row its colour. Empty: none at all.
    """

    block: ClassVar[str] = "table"
    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    kind: Literal["numbers", "words"] = "numbers"
    links: tuple[str | None, ...] = ()
    tones: tuple[Tone, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Figure:
    """Panels side by side, as many in a row as the screen has room for, with one legend."""

    block: ClassVar[str] = "figure"
    caption: str
    panels: tuple[Panel, ...]
    legend: tuple[tuple[Style, str], ...] = ()


Block = Paragraph | Heading | Facts | Table | Figure


@dataclass(frozen=True, slots=True, eq=False)
class Section:
    """A chapter. name: its anchor."""

    name: str
    title: str
    blocks: tuple[Block, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Document:
    """The whole report. verdict: the first sentence on the page; tone: how it is coloured.

    links: other pages that belong to this one, as address relative to it and text.
    """

    title: str
    verdict: str
    sections: tuple[Section, ...]
    tone: Tone = "neutral"
    links: tuple[tuple[str, str], ...] = ()
