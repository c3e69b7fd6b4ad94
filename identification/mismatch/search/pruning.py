"""Members of a model that are worth less than they must be are left out.

`removal_scores` also by the claims.
"""

from __future__ import annotations

import numpy as np

from identification.mismatch.problem import Problem
from identification.mismatch.search.refinement import score_of
from identification.mismatch.search.trial import Trial, fitted
from identification.mismatch.settings import DiagnosisSettings


def pruned(nominal: Problem, trial: Trial, settings: DiagnosisSettings) -> Trial:
    """Members whose loss costs less than it must, left out one by one, the weakest first."""
    while trial.members:
        scores = removal_scores(nominal, trial, settings)
        weakest = int(np.argmin(scores))
        if scores[weakest] >= (settings.provisional_score if nominal.noise_is_measured else settings.background_score):
            return trial
        kept = [member for index, member in enumerate(trial.members) if index != weakest]
        trial = fitted(nominal, kept, settings)
    return trial


def removal_scores(nominal: Problem, trial: Trial, settings: DiagnosisSettings) -> tuple[float, ...]:
    """`removal_score` of every member."""
    return tuple(removal_score(nominal, trial, index, settings) for index in range(len(trial.members)))


def removal_score(nominal: Problem, trial: Trial, index: int, settings: DiagnosisSettings) -> float:
    """What is lost when a member is left out and the others are fitted again."""
    others = [other for position, other in enumerate(trial.members) if position != index]
    rest = fitted(nominal, others, settings, trial)
    if nominal.noise_is_measured:
        return score_of(rest.problem, trial.members[index])
    return trial.likelihood - rest.likelihood
