"""Other names of one member that the fitted recordings leave open, and what its score is worth by chance."""

from __future__ import annotations

from collections.abc import Sequence

from scipy.special import chdtrc

from identification.mismatch.effects.equivalence import relation
from identification.mismatch.findings import Alternative
from identification.mismatch.problem import Problem, off, orthonormal, spread
from identification.mismatch.search.library import Library
from identification.mismatch.search.refinement import Member, refine, score_of
from identification.mismatch.search.screening import Screen, gains, narrowed
from identification.mismatch.search.search import GROWS
from identification.mismatch.search.trial import Trial, fitted, without
from identification.mismatch.settings import DiagnosisSettings

EXPLAINS_MORE = 1.0
"""Score within which a name is an alternative to what it holds as a special case: a further coefficient costs three, so
that it then gains two, which noise does in one of twenty."""
MOST_ALTERNATIVES = 8
"""Rivals of one finding that are refined and compared."""


def significance(score: float, coefficients: int, candidates: int) -> float:
    """Probability that noise alone makes any of so many candidates gain so much; Bonferroni."""
    return float(min(1.0, candidates * chdtrc(coefficients, 2.0 * max(score, 0.0))))


def alternatives(
    nominal: Problem, trial: Trial, index: int, screen: Screen, library: Library, settings: DiagnosisSettings
) -> tuple[Alternative, ...]:
    """Other names of one member (`rivals`), best first."""
    return tuple(
        Alternative(rival.effect.name, rival.place.joint)
        for _, rival in rivals(nominal, trial, index, screen, library, settings)
    )


def rivals(
    nominal: Problem, trial: Trial, index: int, screen: Screen, library: Library, settings: DiagnosisSettings
) -> list[tuple[float, Member]]:
    """Other effects or joints that come near one member, refined in its place, with their scores, best first.

    What contains the member as a special case is one only where it explains more. Of two that explain alike the simpler
    one is reported.
    """
    member, margin = trial.members[index], settings.margin_of_indistinguishable
    others = without(trial.members, index)
    rest = fitted(nominal, others, settings)
    own = own_score(nominal, trial, rest, others, member, settings)
    found = []
    for rival in _near(trial, rest, score_of(rest.problem, member), screen, settings):
        refined = refine(rest.problem, library, rival)
        score = own_score(nominal, trial, rest, others, refined, settings)
        if score >= own - margin and (score > own - EXPLAINS_MORE or not contains(rest.problem, refined, member)):
            found.append((score, refined))
    return sorted(found, key=lambda item: -item[0])


def _near(trial: Trial, rest: Trial, best: float, screen: Screen, settings: DiagnosisSettings) -> list[Member]:
    """Candidates on the grid that may come near a score of `best` once refined, one of each effect and joint."""
    taken = {(item.effect.name, item.place.joint) for item in trial.members}
    chosen: dict[tuple[str, int | None], Member] = {}
    for score, rows in gains(narrowed(screen, rest.problem) if rest.members else screen):
        key = (rows.effect.name, rows.place.joint)
        if score < GROWS * (best - settings.margin_of_indistinguishable) or len(chosen) >= MOST_ALTERNATIVES:
            break
        if key not in taken and key not in chosen:
            chosen[key] = Member(rows)
    return list(chosen.values())


def own_score(
    nominal: Problem, trial: Trial, rest: Trial, others: Sequence[Member], member: Member, settings: DiagnosisSettings
) -> float:
    """What a member gains beside the others, less what its coefficients and shape cost.

    rest: the others alone. With more coefficients a name explains more even where it is none.
    """
    if nominal.noise_is_measured:
        return score_of(rest.problem, member)
    whole = fitted(nominal, [*others, member], settings, trial)
    return (whole.likelihood - whole.cost) - (rest.likelihood - rest.cost)


def contains(problem: Problem, larger: Member, smaller: Member) -> bool:
    """Whether the smaller member is a special case of the larger one, off all that is fitted."""
    spaces = [
        orthonormal(off(problem.basis, spread(problem, item.rows.joints, item.rows.rows)), tolerance=1e-6)
        for item in (smaller, larger)
    ]
    return relation(*spaces).kind == "first_in_second"
