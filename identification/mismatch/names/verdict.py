"""From members of a model to claims: alternatives, the rule of abstention, and the words for what stays.

A name is claimed only if it removes most of the excess misfit on its joints, on the fitted and on the held-out
recordings; what the data cannot tell from it is named beside it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy.stats import chi2

from identification.mismatch.effects.equivalence import relation
from identification.mismatch.evidence import Evidence
from identification.mismatch.findings import Alternative, Baseline, Finding, Verdict
from identification.mismatch.heldout import Residuals, share_removed
from identification.mismatch.problem import Problem, off, orthonormal, spread
from identification.mismatch.search.library import Library
from identification.mismatch.search.refinement import Member, refine, score_of
from identification.mismatch.search.screening import Screen, gains, narrowed
from identification.mismatch.search.trial import Trial, fitted
from identification.mismatch.settings import DiagnosisSettings
from identification.mismatch.unknown.claims import ClassClaim

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

EXPLAINS_MORE = 1.0
"""Score within which a name is an alternative to what it holds as a special case: a further coefficient costs three, so
that it then gains two, which noise does in one of twenty."""
MOST_ALTERNATIVES = 8
"""Rivals of one finding that are refined and compared."""
MUCH = 3.0
"""Noise of another colour lies within; a model that leaves more may lack physics."""


def significance(score: float, coefficients: int, candidates: int) -> float:
    """Probability that noise alone makes any of so many candidates gain so much; Bonferroni."""
    return float(min(1.0, candidates * chi2.sf(2.0 * max(score, 0.0), coefficients)))


def rivals(
    nominal: Problem, trial: Trial, index: int, screen: Screen, library: Library, settings: DiagnosisSettings
) -> list[tuple[float, Member]]:
    """Other effects or joints that come near one member (`margin_of_search`), refined in its place, best first."""
    member = trial.members[index]
    others = [other for position, other in enumerate(trial.members) if position != index]
    rest = fitted(nominal, others, settings)
    beside = narrowed(screen, rest.problem) if others else screen
    own = own_score(nominal, trial, rest, others, member, settings)
    taken = {(item.effect.name, item.place.joint) for item in trial.members}
    chosen: dict[tuple[str, int | None], Member] = {}
    best = score_of(rest.problem, member)
    for score, variant in gains(beside):
        rows = screen.candidates[variant.index]
        key = (rows.effect.name, rows.place.joint)
        if score < 0.5 * (best - settings.margin_of_search) or len(chosen) >= MOST_ALTERNATIVES:
            break
        if key not in taken and key not in chosen:
            chosen[key] = Member(rows, variant.selection)
    found = []
    for rival in chosen.values():
        refined = refine(rest.problem, library, rival)
        score = own_score(nominal, trial, rest, others, refined, settings)
        if score >= own - settings.margin_of_search:
            found.append((score, refined))
    return sorted(found, key=lambda item: -item[0])


def alternatives(
    nominal: Problem, trial: Trial, index: int, screen: Screen, library: Library, settings: DiagnosisSettings
) -> tuple[Alternative, ...]:
    """Other names for one member; what contains the member as a special case is one only where it explains more.

    Of two that explain alike the simpler one is reported.
    """
    others = [other for position, other in enumerate(trial.members) if position != index]
    rest = fitted(nominal, others, settings)
    own = own_score(nominal, trial, rest, others, trial.members[index], settings)
    return tuple(
        Alternative(rival.effect.name, rival.place.joint, score)
        for score, rival in rivals(nominal, trial, index, screen, library, settings)
        if score >= own - settings.margin_of_indistinguishable
        and (score > own - EXPLAINS_MORE or not contains(rest.problem, rival, trial.members[index]))
    )


def own_score(
    nominal: Problem,
    trial: Trial,
    rest: Trial,
    others: Sequence[Member],
    member: Member,
    settings: DiagnosisSettings,
) -> float:
    """What a member gains beside the others, in the regime of the trial, less what its coefficients and shape cost.

    rest: the others alone. With more coefficients a name explains more even where it is none.
    """
    if trial.complete:
        return score_of(rest.problem, member)
    whole = fitted(nominal, [*others, member], settings, trial)
    return (whole.likelihood - whole.cost) - (rest.likelihood - rest.cost)


def contains(problem: Problem, larger: Member, smaller: Member) -> bool:
    """Whether the smaller member is a special case of the larger one with all its columns, off all that is fitted.

    Not where the columns that are used are the same space: then the two are one torque under two names.
    """

    def space(item: Member, rows: FloatArray) -> FloatArray:
        return orthonormal(off(problem.basis, spread(problem, item.rows.joints, rows)), tolerance=1e-6)

    own = space(smaller, smaller.used_rows())
    if relation(own, space(larger, larger.used_rows())).kind == "identical":
        return False
    return relation(own, space(larger, larger.rows.rows)).kind == "first_in_second"


def joints_of(member: Member, extension_rows: FloatArray) -> list[int]:
    """Joints (from 0) on which a member's torque (n, R) matters: those with at least a tenth of its largest energy."""
    energy = (extension_rows**2).sum(axis=1)
    if len(member.rows.joints) == 1:
        return list(member.rows.joints)
    return [joint for joint in member.rows.joints if energy[joint] >= 0.1 * energy.max()]


def explains_enough(
    before: Residuals, after: Residuals, joints: Sequence[int], needed: float, *, complete: bool
) -> bool:
    """Whether the share of excess energy removed on some joints is what a name needs.

    complete: the members leave nothing but noise; then only a share clearly below is too little, as the excess of a
    weak effect is itself uncertain.
    """
    share, most = share_removed(before, after, joints)
    return (most if complete else share) >= needed


def contrast(rest: Residuals, now: Residuals, joints: Sequence[int]) -> float:
    """What a member removes on its joints over the most that stays on any other joint, both in squares of the noise.

    An unknown error that is seen on other joints may have any smooth form on this one too, a spring's or an offset's.
    """
    squares = [((item.rows / item.sensor_noise) ** 2).sum(axis=1) for item in (rest, now)]
    others = np.setdiff1d(np.arange(rest.rows.shape[0]), list(joints))
    expected = ((now.noise / now.sensor_noise) ** 2).sum(axis=1)
    left = np.maximum(squares[1] - expected, 0.0)[others]
    return float((squares[0] - squares[1])[list(joints)].sum() / max(float(left.max(initial=0.0)), 1e-300))


def contrast_by_band(
    rest: Residuals, now: Residuals, joints: Sequence[int], band: IntArray, settings: DiagnosisSettings
) -> float:
    """Log-likelihood that a member gains on its joints where these have as much unknown error as any other joint, times
    `contrast_to_background`, band by band.

    An unknown error is smooth: it leaves the bands of a ripple, and the upper ones of friction at reversals, to the
    noise. There a member stands out that removes less in all than another joint keeps. band: (R,) index of each row.
    """
    others = np.setdiff1d(np.arange(rest.rows.shape[0]), list(joints))
    gained = 0.0
    for index in np.unique(band):
        chosen = band == index
        before, after = (((item.rows / item.sensor_noise)[:, chosen] ** 2).mean(axis=1) for item in (rest, now))
        allowed = settings.contrast_to_background * float(after[others].max(initial=1.0))
        gained += 0.5 * chosen.sum() * float(np.log((before + allowed) / (after + allowed))[list(joints)].sum())
    return gained


def verdict_of(
    findings: Sequence[Finding],
    baseline: Baseline,
    left: Sequence[bool],
    elsewhere: bool,
    *,
    classes: Sequence[ClassClaim] = (),
    much: bool,
) -> Verdict:
    """left: per joint whether misfit remains beside the findings; elsewhere: whether it does on held-out recordings.

    classes: what the torque depends on; one of which the names leave something is a mismatch without a name.
    much: noise was not measured, and more is left than the level above the compared band would give (`much_is_left`);
    beside names that may be misfit too.
    """
    elsewhere = elsewhere or not all(item.named for item in classes)
    if findings:
        return "partly_explained" if any(left) or elsewhere or much else "explained"
    if bool(np.any(baseline.detected)) or elsewhere:
        return "unexplained"
    return "undecided" if much else "no_mismatch"


def much_is_left(rms_nm: FloatArray, evidences: Sequence[Evidence]) -> bool:
    """Whether a model leaves more (n,) Nm on some joint than three times the noise that the quietest octave above the
    compared band would give within it, where noise is not measured: it may be misfit, or noise of another colour.
    """
    floors = [item.noise if item.white_noise is None else item.white_noise for item in evidences]
    square = sum((floor**2).sum(axis=0) for floor in floors) / sum(item.samples for item in evidences)
    return not all(item.noise_is_measured for item in evidences) and bool(np.any(rms_nm > MUCH * np.sqrt(square)))
