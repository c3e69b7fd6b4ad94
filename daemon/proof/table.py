"""Sums up the scores of concealed cases: rates with bounds, λ at which names come right, confusion, targets met or not.

Pure: scores in, tables out. What a score means is in `score`.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from daemon.proof.score import CaseScore, EffectScore

ORACLE_VISIBLE = 24.0
STRONG = 100.0
VERY_STRONG = 1000.0
WORTH_A_LOOK = 60.0
NOTHING_HIDDEN = ("negative", "decoy", "background")
UNNAMED = ("outside", "structural", "alien", "hybrid")
"""Groups whose effects need not have a name."""
LIBRARY_FORMS = ("library", "first_order_lag")
NO_NAME = "no name"
SINGLES_FOR_A_CURVE = 40
"""Fewer give no λ at which 90 % are named that could be held against a target."""
CASES_WITHOUT_LAPSE = 10.0
"""Strong cases, all named, that the estimate of a lapse rate starts from."""
NARROW_MOTIONS = ("single",)
"""Motions of one joint, on which many effects are the same torque: counted apart."""


@dataclass(frozen=True, slots=True)
class Rate:
    """hits of count. upper_bound_95: one-sided bound of the true share (Clopper and Pearson 1934)."""

    hits: int
    count: int
    upper_bound_95: float = field(init=False)

    def __post_init__(self) -> None:
        from scipy.special import betaincinv

        bound = 1.0 if self.hits >= self.count else betaincinv(self.hits + 1, self.count - self.hits, 0.95)
        object.__setattr__(self, "upper_bound_95", float(bound))

    @property
    def share(self) -> float:
        """Share of hits, nan of nothing."""
        return self.hits / self.count if self.count else math.nan

    @property
    def short(self) -> str:
        """'11/12', or '-' of nothing."""
        return f"{self.hits}/{self.count}" if self.count else "-"

    def __str__(self) -> str:
        return f"{self.short} ({100 * self.share:.1f} %)" if self.count else "-"


@dataclass(frozen=True, slots=True)
class Target:
    """One line of what was to be reached. met: None where the run has no case to judge it by."""

    text: str
    wanted: str
    reached: str
    met: bool | None


def rate(values: Iterable[bool]) -> Rate:
    """How many are true."""
    listed = list(values)
    return Rate(sum(listed), len(listed))


def _singles(scores: Sequence[CaseScore], group: str = "single") -> list[tuple[CaseScore, EffectScore]]:
    chosen = [score for score in scores if score.group == group and score.excitation not in NARROW_MOTIONS]
    return [(score, score.effects[0]) for score in chosen]


def visibility_for(pairs: Sequence[tuple[float, bool]], share: float) -> float | None:
    """λ at which `share` of the effects are named, from (λ, named) by logistic regression on log λ with lapses.

    A curve that ends at one would take a miss at λ 10⁴ for a flat slope and put the λ of 90 % far too high; so it ends
    at 1 - lapse, estimated along. None where all or none are named, where names do not become more frequent with λ, or
    where `share` of them is not reached within the λ there are.
    """
    seen = [(math.log(visibility), named) for visibility, named in pairs if visibility > 0.0]
    if len({named for _, named in seen}) < 2:
        return None
    x, y = (np.array(column, dtype=float) for column in zip(*seen, strict=True))

    def cost(curve: Any) -> float:
        z = curve[0] + curve[1] * (x - 4.0)
        log_end = -float(np.logaddexp(0.0, -curve[2]))
        log_named = log_end - np.logaddexp(0.0, -z)
        likelihood = np.sum(np.where(y > 0.0, log_named, np.log1p(-np.exp(np.minimum(log_named, -1e-12)))))
        # Weak priors: the slope of perfectly separated cases stays finite, and few cases show no lapse.
        return float(-likelihood + 0.005 * curve[1] ** 2 - CASES_WITHOUT_LAPSE * log_end + 1e-3 * curve[2] ** 2)

    from scipy.optimize import minimize

    fits = [minimize(cost, np.array([start, 2.0, 3.0]), method="Nelder-Mead") for start in (-2.0, 0.0, 2.0)]
    offset, slope, end = min(fits, key=lambda fit: float(fit.fun)).x
    reached = share * (1.0 + math.exp(-end))
    if slope <= 0.0 or reached >= 1.0:
        return None
    found = 4.0 + (math.log(reached / (1.0 - reached)) - offset) / slope
    return math.exp(found) if found <= x.max() else None


def family_rows(scores: Sequence[CaseScore]) -> list[dict[str, Any]]:
    """Per family of the singles: rates at λ ≥ 100, by form, and the λ of 50 and 90 %, all without background.

    named_background: at λ ≥ 100 beside an unknown model error, however small the effect's share of the misfit.
    """
    rows = []
    pairs = _singles(scores)
    beside = [effect for _, effect in _singles(scores, "single_background") if effect.visibility >= STRONG]
    families = {effect.family for _, effect in pairs} | {effect.family for effect in beside}
    for family in (*sorted(families), "all"):
        own = [(score, effect) for score, effect in pairs if family in (effect.family, "all")]
        strong = [(score, effect) for score, effect in own if effect.visibility >= STRONG]
        background = rate(effect.named for effect in beside if family in (effect.family, "all"))
        rows.append(
            {"family": family, "cases": len(own), **_rates(strong), "named_background": background, **_curve(own)}
        )
    return rows


def _rates(strong: Sequence[tuple[CaseScore, EffectScore]]) -> dict[str, Rate]:
    perturbed = [(score, effect) for score, effect in strong if effect.form not in LIBRARY_FORMS]
    return {
        "detected": rate(score.detected for score, _ in strong),
        "joint": rate(effect.placed or effect.in_set for score, effect in strong if score.claimed or score.failed),
        "named": rate(effect.named for _, effect in strong),
        "in_set": rate(effect.in_set for _, effect in strong),
        "named_textbook": rate(effect.named for _, effect in strong if effect.form in LIBRARY_FORMS),
        "named_perturbed": rate(effect.named for _, effect in perturbed),
    }


def _curve(pairs: Sequence[tuple[CaseScore, EffectScore]]) -> dict[str, float | None]:
    points = [(effect.visibility, effect.named) for _, effect in pairs]
    return {"lambda50": visibility_for(points, 0.5), "lambda90": visibility_for(points, 0.9)}


def negatives(scores: Sequence[CaseScore]) -> dict[str, Rate]:
    """False names where nothing is hidden, by group or kind of decoy, without the common lag, which has a name."""
    rows: dict[str, list[bool]] = {}
    for score in scores:
        if score.group in NOTHING_HIDDEN and score.kind != "common_lag":
            key = f"decoy: {score.kind}" if score.group == "decoy" else score.group
            rows.setdefault(key, []).append(_is_wrongly_named(score))
    return {key: rate(rows[key]) for key in sorted(rows)}


def _is_wrongly_named(score: CaseScore) -> bool:
    """Also a case that could not be diagnosed: an error is no proof of silence."""
    return score.extras > 0 or score.failed is not None


def confusion(scores: Sequence[CaseScore]) -> dict[str, Counter[str]]:
    """Per family of the oracle-visible singles: what its first finding was called; 'right' with structural equals."""
    table: dict[str, Counter[str]] = {}
    for score, effect in _singles(scores):
        if effect.visibility >= ORACLE_VISIBLE:
            called = "right" if effect.named else (score.claimed[0] if score.claimed else NO_NAME)
            table.setdefault(effect.family, Counter())[called] += 1
    return dict(sorted(table.items()))


def _both(scores: Sequence[CaseScore], group: str) -> Rate:
    """Cases of several effects, all of them oracle-visible beside the others: all named."""
    chosen = [score for score in scores if score.group == group]
    visible = [s for s in chosen if all(effect.partial_visibility >= ORACLE_VISIBLE for effect in s.effects)]
    return rate(all(effect.named for effect in score.effects) for score in visible)


def _percentile(values: Sequence[float], percent: float) -> float:
    return float(np.percentile(values, percent)) if len(values) else math.nan


def summary(scores: Sequence[CaseScore]) -> dict[str, Any]:
    """Every figure of the proof that is not per family."""
    seconds = [score.seconds for score in scores if score.failed is None]
    sizes = [size for score in scores for size in score.set_sizes]
    return {
        "cases": len(scores),
        "failed": sum(score.failed is not None for score in scores),
        **_single_effects(scores),
        **_sizes_and_gains(scores),
        **_nothing_or_several(scores),
        **_beside_background(scores),
        "names_left_open_a_finding": float(np.mean(sizes)) if sizes else math.nan,
        "extras": rate(score.extras > score.misnamed or score.failed is not None for score in scores),
        "seconds_median": _percentile(seconds, 50),
        "seconds_largest": max(seconds, default=math.nan),
    }


def _single_effects(scores: Sequence[CaseScore]) -> dict[str, Any]:
    singles = _singles(scores)
    strong = [(score, effect) for score, effect in singles if effect.visibility >= STRONG]
    rates = _rates(strong)
    narrow = [score.effects[0] for score in scores if score.group == "single" and score.excitation in NARROW_MOTIONS]
    return {
        "singles_named_at_any_visibility": rate(effect.named for _, effect in singles),
        "singles_named": rates["named"],
        "singles_in_set": rates["in_set"],
        "singles_joint": rates["joint"],
        "singles_name_or_class": rate(effect.named or bool(score.class_right) for score, effect in strong),
        "perturbed_named": rates["named_perturbed"],
        "one_joint_motion_in_set": rate(effect.in_set for effect in narrow if effect.visibility >= STRONG),
        **_curve(singles),
    }


def _sizes_and_gains(scores: Sequence[CaseScore]) -> dict[str, Any]:
    singles = _singles(scores)
    plain = [effect for _, effect in singles if effect.visibility >= VERY_STRONG]
    errors = [effect.amplitude_error for effect in plain if effect.amplitude_error is not None]
    removed = [s.removed for s, effect in singles if s.removed is not None and effect.visibility >= STRONG]
    return {
        "amplitude_cases": len(errors),
        "amplitude_median": _percentile(errors, 50),
        "amplitude_p90": _percentile(errors, 90),
        "amplitude_within_4_percent": rate(error <= 0.04 for error in errors),
        "covered": rate(effect.covered for effect in plain if effect.covered is not None),
        "removed_cases": len(removed),
        "removed_median": _percentile(removed, 50),
        "removed_p10": _percentile(removed, 10),
    }


def _nothing_or_several(scores: Sequence[CaseScore]) -> dict[str, Any]:
    plain = [score for score in scores if score.group in ("negative", "decoy") and score.kind != "common_lag"]
    outside = [score for score in scores if score.group == "outside"]
    seen = [score for score in outside if score.effects[0].visibility >= ORACLE_VISIBLE]
    return {
        "false_names": rate(_is_wrongly_named(score) for score in plain),
        "false_classes": rate(bool(score.classes) for score in plain if score.class_right is not None),
        "misfit_seen_where_nothing_is_hidden": rate(score.detected for score in plain),
        "common_lag_right": rate(bool(score.right) for score in scores if score.kind == "common_lag"),
        "outside_wrongly_named": rate(_is_wrongly_named(score) for score in outside),
        "outside_detected": rate(score.detected for score in seen),
        "pairs_both": _both(scores, "pair"),
        "triples_all": _both(scores, "triple"),
        "structural": rate(bool(score.right) for score in scores if score.group == "structural"),
    }


def _beside_background(scores: Sequence[CaseScore]) -> dict[str, Any]:
    alone = [score for score in scores if score.group == "background"]
    shares = [(effect.share or 0.0, effect) for _, effect in _singles(scores, "single_background")]
    every = [score for score in scores if score.group == "single_background"]
    return {
        "false_names_background": rate(_is_wrongly_named(score) for score in alone),
        "false_classes_background": rate(bool(score.classes) for score in alone if score.class_right is not None),
        "background_named_share_above_60": rate(effect.named for share, effect in shares if share > 0.6),
        "background_named_share_30_60": rate(effect.named for share, effect in shares if 0.3 <= share <= 0.6),
        "background_named_share_below_30": rate(effect.named for share, effect in shares if share < 0.3),
        "background_name_or_class_share_above_50": rate(
            score.effects[0].named or bool(score.class_right)
            for score in every
            if (score.effects[0].share or 0.0) >= 0.5
        ),
    }


def wrong_answers(cases: Sequence[tuple[int, CaseScore]]) -> list[str]:
    """One line for each case, by its number, that names wrongly, too much, or not although λ ≥ 60."""
    lines = []
    for index, score in cases:
        missed = [
            effect
            for effect in score.effects
            if score.group not in UNNAMED and not effect.named and effect.partial_visibility >= WORTH_A_LOOK
        ]
        if not (missed or score.extras or score.right is False or score.failed):
            continue
        hidden = ", ".join(
            f"{effect.family}{'' if effect.form == 'library' else ' ' + effect.form} λ {effect.visibility:.3g}"
            for effect in score.effects
        )
        claimed = ", ".join(
            name if joint is None else f"{name} J{joint}"
            for name, joint in zip(score.claimed, score.claimed_joints, strict=True)
        )
        answer = score.failed or claimed or NO_NAME
        if score.classes:
            answer += f" ({', '.join(score.classes)})"
        lines.append(f"case {index} {score.group} {score.kind} [{score.excitation}]: {hidden or 'nothing'} → {answer}")
    return lines


def targets(figures: Mapping[str, Any]) -> list[Target]:
    """What was to be reached, and whether this run did."""
    error, removed = (100.0 * float(figures[name]) for name in ("amplitude_median", "removed_median"))
    seconds = figures["seconds_largest"]
    covered: Rate = figures["covered"]
    inside = 0.90 <= covered.share <= 0.98 if covered.count else None
    return [
        at_least(figures, "singles, λ ≥ 100: family and joint right", "singles_named", 0.98),
        at_least(figures, "singles, λ ≥ 100: joint right where anything is named", "singles_joint", 1.0),
        at_least(figures, "singles of perturbed form, λ ≥ 100: named", "perturbed_named", 0.95),
        _named_from(figures, 55.0),
        _at_most(figures, "false names, clean and decoys", "false_names", 0.01),
        _at_most(figures, "false names, with background", "false_names_background", 0.03),
        _at_most(figures, "effects outside the library wrongly named", "outside_wrongly_named", 0.05),
        at_least(figures, "pairs, both visible: both named", "pairs_both", 0.90),
        _at_most(figures, "cases with a spurious extra", "extras", 0.05),
        at_least(figures, "structural cases answered as a set", "structural", 1.0),
        _number("amplitude at λ ≥ 1000, median error", "≤ 1 %", error, error <= 1.0, " %"),
        at_least(figures, "amplitude at λ ≥ 1000 within 4 %", "amplitude_within_4_percent", 0.90),
        Target("95 % intervals cover", "90 to 98 %", str(covered), inside),
        _number("held-out excess energy removed, median", "≥ 95 %", removed, removed >= 95.0, " %"),
        _number("CPU time a case, largest", "≤ 10 s", seconds, seconds <= 10.0, " s"),
    ]


def at_least(figures: Mapping[str, Any], text: str, name: str, least: float) -> Target:
    """A rate among the figures that has to reach a share."""
    value: Rate = figures[name]
    return Target(text, f"≥ {100 * least:g} %", str(value), value.share >= least if value.count else None)


def _at_most(figures: Mapping[str, Any], text: str, name: str, most: float) -> Target:
    value: Rate = figures[name]
    reached = f"{value}, bound {100 * value.upper_bound_95:.1f} %" if value.count else "-"
    return Target(text, f"≤ {100 * most:g} %", reached, value.share <= most if value.count else None)


def _number(text: str, wanted: str, value: float | None, met: bool, unit: str = "") -> Target:
    known = value is not None and math.isfinite(value)
    return Target(text, wanted, f"{value:.3g}{unit}" if known else "-", met if known else None)


def _named_from(figures: Mapping[str, Any], most: float) -> Target:
    text, wanted = "λ at which 90 % are named", f"≤ {most:g}"
    every: Rate = figures["singles_named_at_any_visibility"]
    if every.count < SINGLES_FOR_A_CURVE:
        return _number(text, wanted, None, met=False)
    found = figures["lambda90"]
    if found is None and every.share < 0.9:
        # Enough cases and no such λ: 90 % are never named, which is not the same as having nothing to judge by.
        return Target(text, wanted, "never", False)
    return _number(text, wanted, found, found is not None and found <= most)
