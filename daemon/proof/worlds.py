"""Sums up cases of the alien and the hybrid world: wrong names, right classes, what was taken of the held-out error.

Pure: scores in, figures and aims out. The library's world, where names can be right, has ``prove_table``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from daemon.proof.score import CaseScore
from daemon.proof.table import NO_NAME, Target, at_least, rate

STRONG_IN = {"alien": 100.0, "hybrid": 200.0}
"""λ from which on a class is asked for: against the sensor's noise, or against the real background's own power."""


def _with_effect(scores: Sequence[CaseScore]) -> list[CaseScore]:
    return [score for score in scores if score.effects]


def world_summary(world: str, scores: Sequence[CaseScore]) -> dict[str, Any]:
    """Every figure of one world. Bare recordings count for the time only."""
    cases = _with_effect(scores)
    strong = [score for score in cases if score.effects[0].visibility >= STRONG_IN[world]]
    judged = [score for score in strong if score.class_right is not None]
    seconds = [score.seconds for score in scores if score.failed is None]

    def middle(values: Sequence[float | None]) -> float:
        known = [value for value in values if value is not None]
        return float(np.median(known)) if known else float("nan")

    return {
        "cases": len(cases),
        "failed": sum(score.failed is not None for score in scores),
        "wrong_names": rate(score.extras > 0 or score.failed is not None for score in cases),
        "wrong_names_called_explained": rate(score.extras > 0 and score.verdict == "explained" for score in cases),
        "strong": len(strong),
        "strong_named_right": rate(score.effects[0].in_set for score in strong),
        "strong_class_right": rate(bool(score.class_right) for score in judged),
        "strong_class_right_by_share": rate(bool(score.class_right_by_share) for score in judged),
        "strong_name_or_class_right": rate(score.effects[0].in_set or bool(score.class_right) for score in strong),
        "strong_nothing_said": rate(not score.claimed and not score.classes for score in strong),
        "strong_passed_as_no_mismatch": rate(score.verdict == "no_mismatch" for score in strong),
        "classes_on_other_joints": rate(
            score.classes_elsewhere > 0 for score in cases if score.class_right is not None
        ),
        "removed_by_names_median": middle([score.removed for score in strong]),
        "removed_by_classes_median": middle([score.removed_by_classes for score in strong]),
        "seconds_median": middle(seconds),
        "seconds_largest": max(seconds, default=float("nan")),
    }


def world_family_rows(world: str, scores: Sequence[CaseScore]) -> list[tuple[str, ...]]:
    """Per family: cases, wrong names, right names, right classes where strong, and what was said first."""
    cases = _with_effect(scores)
    rows: list[tuple[str, ...]] = []
    for family in sorted({score.effects[0].family for score in cases}):
        own = [score for score in cases if score.effects[0].family == family]
        strong = [score for score in own if score.effects[0].visibility >= STRONG_IN[world]]
        judged = [score for score in strong if score.class_right is not None]
        said = [(*score.claimed, *score.classes, NO_NAME)[0] for score in own]
        rows.append(
            (
                family,
                str(len(own)),
                str(sum(score.extras > 0 for score in own)),
                rate(score.effects[0].in_set for score in strong).short,
                rate(bool(score.class_right) for score in judged).short,
                ", ".join(said),
            )
        )
    return rows


def world_targets(world: str, figures: Mapping[str, Any]) -> list[Target]:
    """What was to be reached in a world, and whether this run did."""
    wrong = figures["wrong_names"]
    least, taken = {"alien": (0.90, 0.85), "hybrid": (0.85, None)}[world]
    aims = [
        Target("wrong names", "≤ 3 %", str(wrong), wrong.share <= 0.03 if wrong.count else None),
        at_least(figures, f"right joint and class, λ ≥ {STRONG_IN[world]:g}", "strong_class_right", least),
    ]
    if taken is not None:
        value = figures["removed_by_classes_median"]
        met = value >= taken if np.isfinite(value) else None
        reached = "-" if met is None else f"{100 * value:.0f} %"
        aims.append(Target("held-out excess energy taken by classes, median", f"≥ {100 * taken:g} %", reached, met))
    for text, name, most in (("median", "seconds_median", 5.0), ("largest", "seconds_largest", 15.0)):
        value = figures[name]
        met = value <= most if np.isfinite(value) else None
        aims.append(Target(f"CPU time a case, {text}", f"≤ {most:g} s", f"{value:.1f} s", met))
    return aims
