"""The result of a proof as tables, for the terminal and for one page that leads to the page of every case.

Here: which rows there are, in which words. Not here: how a case is scored (`prove_score`) or counted (`prove_table`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from daemon.proof.prove import ProvenCase, Source
from daemon.proof.score import CaseScore
from daemon.proof.table import NO_NAME, Target, confusion, family_rows, negatives, summary, targets, wrong_answers
from daemon.proof.worlds import STRONG_IN, world_family_rows, world_summary, world_targets
from identification.report.document import Document, Paragraph, Section, Table, Tone

_RATES = {
    "detected": "detected", "joint": "joint right", "named": "named", "in_set": "or in set",
    "named_textbook": "textbook", "named_perturbed": "perturbed", "named_background": "in background",
}  # fmt: skip


def figures_of(world: str, scores: Sequence[CaseScore]) -> dict[str, Any]:
    """Every figure of one world's cases."""
    return summary(scores) if world == "library" else world_summary(world, scores)


def aims_of(world: str, figures: Mapping[str, Any]) -> list[Target]:
    """What was to be reached in one world."""
    return targets(figures) if world == "library" else world_targets(world, figures)


def proof_tables(world: str, scores: Sequence[CaseScore], figures: Mapping[str, Any]) -> list[Table]:
    """Families and what they were called, the other figures, and last what was to be reached."""
    if world == "library":
        tables = _library_tables(scores)
    else:
        caption = f"Families of the {world} world; names and classes at λ ≥ {STRONG_IN[world]:g}"
        head = ("family", "cases", "wrong names", "named right", "class right", "said first, case by case")
        tables = [Table(caption, head, tuple(world_family_rows(world, scores)), "words")]
    aims = aims_of(world, figures)
    return [
        *tables,
        Table(
            "Everything else",
            ("figure", "value"),
            tuple(
                (name.replace("_", " "), f"{value:.4g}" if isinstance(value, float) else str(value))
                for name, value in figures.items()
            ),
        ),
        Table(
            "What was to be reached",
            ("to be reached", "wanted", "reached", "verdict"),
            tuple(
                (aim.text, aim.wanted, aim.reached, {None: "no case", True: "met", False: "NOT MET"}[aim.met])
                for aim in aims
            ),
            "words",
            tones=tuple(_tone(aim.met) for aim in aims),
        ),
    ]


def _library_tables(scores: Sequence[CaseScore]) -> list[Table]:
    """Families, confusion, negatives."""
    return [
        Table(
            "Singles without background; rates at λ ≥ 100, what an oracle needs is λ = 24",
            ("family", "cases", *_RATES.values(), "λ50", "λ90"),
            tuple(
                (
                    row["family"], str(row["cases"]), *(row[name].short for name in _RATES),
                    *("-" if row[name] is None else f"{row[name]:.0f}" for name in ("lambda50", "lambda90")),
                )
                for row in family_rows(scores)
            ),
        ),
        Table(
            "First name given, singles with λ ≥ 24 (structural equals count as right)",
            ("hidden", "right", NO_NAME, "other names"),
            tuple(
                (
                    family, str(called["right"]), str(called[NO_NAME]),
                    ", ".join(f"{name} {n}" for name, n in called.most_common() if name not in ("right", NO_NAME)),
                )
                for family, called in confusion(scores).items()
            ),
            "words",
        ),
        Table(
            "False names where nothing is hidden, with the 95 % upper bound",
            ("group", "false names", "bound"),
            tuple(
                (group, str(value), f"{100 * value.upper_bound_95:.1f} %") for group, value in negatives(scores).items()
            ),
        ),
    ]  # fmt: skip


def proof_page(source: Source, proven: Sequence[ProvenCase], pages: Mapping[int, str]) -> Document:
    """The proof on one page. pages: for each case that has a page of its own, its address."""
    scores = [case.score for case in proven]
    figures = figures_of(source.world, scores)
    aims = [aim.met for aim in aims_of(source.world, figures) if aim.met is not None]
    *tables, reached = proof_tables(source.world, scores, figures)
    wrong = wrong_answers([(case.index, case.score) for case in proven])
    lines = tuple(Paragraph(line) for line in wrong or ["None."])
    return Document(
        title=f"Proof of the diagnosis: {len(proven)} concealed cases of seed {source.seed}, {source.world} world",
        verdict=f"{sum(aims)} of {len(aims)} aims that these cases can judge are met; {len(wrong)} of {len(proven)} "
        "cases have a wrong, a superfluous or a missing name (λ ≥ 60).",
        tone=_tone(all(aims) if aims else None),
        sections=(
            Section("reached", "What was to be reached", (reached,)),
            Section("cases", "The cases", (_cases(proven, pages),)),
            Section("wrong", "Wrong, superfluous or missing names", lines),
            Section("counts", "Counts", tuple(tables)),
        ),
    )  # fmt: skip


def _cases(proven: Sequence[ProvenCase], pages: Mapping[int, str]) -> Table:
    rows, tones = [], []
    for case in proven:
        score = case.score
        missed = any(not effect.in_set for effect in score.effects)
        hidden = ", ".join(f"{effect.family} (λ {effect.visibility:.0f})" for effect in score.effects) or "nothing"
        claimed = score.failed or ", ".join(
            name if joint is None else f"{name}, joint {joint}"
            for name, joint in zip(score.claimed, score.claimed_joints, strict=True)
        )
        rows.append((f"case {case.index}", score.group, hidden, claimed or "no name", f"{score.seconds:.1f} s"))
        # A weak effect that stays unnamed is no mistake, and no success.
        tones.append(_tone(False if wrong_answers([(case.index, score)]) else None if missed else True))
    return Table(
        "Every case: what was hidden, what was named without knowing it",
        ("case", "group", "hidden", "named", "time"),
        tuple(rows),
        "words",
        links=tuple(pages.get(case.index) for case in proven),
        tones=tuple(tones),
    )


def _tone(met: bool | None) -> Tone:
    return "neutral" if met is None else "good" if met else "attention"
