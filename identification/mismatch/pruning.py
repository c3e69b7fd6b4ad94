"""Members of a model that are worth less than they must be are left out, by the regime that holds.

Called by the search at its end; `removal_scores` also by the claims.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from identification.mismatch.form_directions import score_off_forms
from identification.mismatch.library import Library
from identification.mismatch.problem import Problem
from identification.mismatch.refinement import score_of
from identification.mismatch.settings import DiagnosisSettings
from identification.mismatch.trial import Trial, fitted


def pruned(
    nominal: Problem, trial: Trial, library: Library, settings: DiagnosisSettings
) -> tuple[Trial, tuple[float, ...]]:
    """Members whose loss costs less than the regime asks for, left out one by one, the weakest first."""
    while trial.members:
        scores = removal_scores(nominal, trial, settings)
        margin = [
            score - required_score(nominal, trial, index, scores, library, settings)
            for index, score in enumerate(scores)
        ]
        weakest = int(np.argmin(margin))
        if margin[weakest] >= 0.0:
            return trial, scores
        kept = [member for index, member in enumerate(trial.members) if index != weakest]
        trial = fitted(nominal, kept, settings)
    return trial, ()


def required_score(
    nominal: Problem, trial: Trial, index: int, scores: Sequence[float], library: Library, settings: DiagnosisSettings
) -> float:
    """The score a member must reach in the regime that its trial is in. scores: of all members, `removal_scores`.

    Beside others on its joints it must also be more than what their form may lack: a share of all that is explained.
    Not where nothing but noise is left and it shows enough off all forms that the stronger ones may have.
    """
    member = trial.members[index]
    least = settings.provisional_score if trial.complete else settings.background_score
    if len(trial.members) == 1 or not nominal.noise_is_measured:
        return least
    rows = [nominal.rows * joint + np.arange(nominal.rows) for joint in member.rows.joints]
    chosen = np.concatenate(rows)
    explained = float((nominal.residual[chosen] ** 2).sum() - (trial.problem.residual[chosen] ** 2).sum())
    needed = max(least, 0.5 * settings.share_of_form * explained)
    if trial.complete and least <= scores[index] < needed:
        stronger = [
            place
            for place, other in enumerate(trial.members)
            if scores[place] > scores[index] and set(other.rows.joints) & set(member.rows.joints)
        ]
        rest = fitted(nominal, [*trial.members[:index], *trial.members[index + 1 :]], settings, trial).problem
        if score_off_forms(nominal, rest, library, trial.members, index, stronger) >= settings.off_form_score:
            return least
    return needed


def removal_scores(nominal: Problem, trial: Trial, settings: DiagnosisSettings) -> tuple[float, ...]:
    """`removal_score` of every member."""
    return tuple(removal_score(nominal, trial, index, settings) for index in range(len(trial.members)))


def removal_score(nominal: Problem, trial: Trial, index: int, settings: DiagnosisSettings) -> float:
    """What is lost when a member is left out and the others are fitted again, in the regime that holds."""
    others = [other for position, other in enumerate(trial.members) if position != index]
    rest = fitted(nominal, others, settings, trial)
    if trial.complete:
        return score_of(rest.problem, trial.members[index])
    return trial.likelihood - rest.likelihood
