"""How the recordings were made and what of the set-up differs from the given model: a section of the report."""

from __future__ import annotations

from collections.abc import Sequence

from identification.audit.difference import Audit, Difference
from identification.mismatch.set_up import SetUpCheck
from identification.report.document import Block, Paragraph, Section, Table
from identification.report.numbers import UNKNOWN, unit_of, with_sigma

_VERDICTS = {"ok": "as stated", "warning": "look at it", "failed": "not as stated"}


def set_up_section(audit: Audit | None, checks: Sequence[SetUpCheck], *, between: bool = False) -> Section | None:
    """The audit's answer with its differences, then the verdict of every check; None where neither was asked.

    between: the audit is of the held-out recordings against the fitted ones, not of the fitted ones against a model.
    """
    blocks: list[Block] = []
    if audit is not None:
        blocks.append(Paragraph(audit.sentence, "lead"))
        if audit.differences:
            head = ("what", "where", "number", "half of its 95 % interval", "unit", "explains", "against")
            rows = tuple(map(_row, audit.differences))
            others = "the held-out recordings" if between else "these recordings"
            blocks.append(Table(f"What differs between {audit.source} and {others}", head, rows))
    if checks:
        rows = tuple((item.name, _VERDICTS[item.status], item.sentence) for item in checks)
        caption = "How the fitted recordings were made, asked without any model"
        blocks.append(Table(caption, ("check", "verdict", "found"), rows, "words"))
    return Section("set-up", "The set-up", tuple(blocks)) if blocks else None


def _row(item: Difference) -> tuple[str, ...]:
    place = "every joint" if item.joint is None and item.link is None else f"joint {item.joint}"
    if item.link is not None:
        place = f"link {item.link}"
    elif item.joints:
        place = "joints " + ", ".join(map(str, item.joints))
    value, half, unit = "", "", ""
    if item.numbers:
        first = item.numbers[0]
        value, half = with_sigma(first.value, 1.96 * first.std)
        half, unit = ("" if half == UNKNOWN else half), unit_of(first.unit)
    share = f"{100.0 * item.explained:.0f} %"
    return item.effect.replace("_", " "), place, value, half, unit, share, item.against
