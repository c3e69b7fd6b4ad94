"""What the choice of the nominal model costs the intervals: a model that was not chosen may be the true one.

A fit without offsets is biased by offsets that are too small to be taken, and its own covariance knows nothing of it.
Every larger model that was considered has odds against the chosen one, its likelihood less one for each parameter more
(Akaike's), and the covariance is the mean over the models of their own and of the squared distance to them (Buckland,
Burnham & Augustin, Biometrics 1997, eq. 9). The values stay those of the chosen model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.estimators.least_squares import LeastSquaresResult


@dataclass(frozen=True, slots=True, eq=False)
class Rival:
    """A model with more parameters than the chosen one. log_odds: against it, those more counted."""

    estimate: LeastSquaresResult
    log_odds: float


def with_choice(chosen: LeastSquaresResult, rivals: Sequence[Rival]) -> LeastSquaresResult:
    """The chosen estimate with the covariance of having chosen it.

    Rivals that lack one of its parameters, as theirs are grouped otherwise, do not count.
    """
    nested = [rival for rival in rivals if set(chosen.names) <= set(rival.estimate.names)]
    if not nested:
        return chosen
    odds = np.array([0.0, *(rival.log_odds for rival in nested)])
    weights = np.exp(odds - odds.max())
    weights /= weights.sum()
    covariance = weights[0] * chosen.covariance
    for weight, rival in zip(weights[1:], nested, strict=True):
        own = [rival.estimate.names.index(name) for name in chosen.names]
        away = rival.estimate.values[own] - chosen.values
        covariance = covariance + weight * (rival.estimate.covariance[np.ix_(own, own)] + np.outer(away, away))
    return replace(chosen, covariance=covariance, std=np.sqrt(np.diag(covariance)))
