"""A set of effects fitted together, and what it leaves.

"complete": few effects leave nothing but noise on every joint and in every band; many are a series expansion of an
unknown model error. Where the noise is not measured that cannot be known, and sets are ranked by their likelihood
beside an unknown background.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from identification.mismatch.problem import Problem, extended, off
from identification.mismatch.search.detection import BandPower, band_power, is_inflated, located, whittle
from identification.mismatch.search.refinement import Member, columns_of, score_of
from identification.mismatch.settings import ALTERNATIVE, DiagnosisSettings

FULL_ROUNDS = 3
QUICK_ROUNDS = 1
"""Rounds in which misfit is located, from the start and from a trial that is near."""


@dataclass(frozen=True, eq=False)
class Trial:
    """Members with the problem in which they are fitted. complete: nothing but noise is left.

    nominal: the problem without members. plain: power of the residual. start, rounds: where misfit is located from. Not
    slotted, as what few trials are asked for is computed when asked.
    """

    members: tuple[Member, ...]
    nominal: Problem
    problem: Problem
    plain: BandPower
    complete: bool
    start: BandPower
    rounds: int

    @cached_property
    def power(self) -> BandPower:
        """Of the residual, in units of the noise, misfit where it sits (`located`)."""
        return self.plain if self.complete else located(self.nominal, self.problem, self.start, self.rounds)

    @cached_property
    def likelihood(self) -> float:
        """Profile likelihood beside an unknown background."""
        return whittle(self.power)

    @property
    def squares(self) -> float:
        """Whitened squares that are left."""
        return float(self.problem.residual @ self.problem.residual)

    @property
    def cost(self) -> float:
        """Log-likelihood that further coefficients and the choice of shapes cost."""
        return sum(ALTERNATIVE * (item.rows.coefficients - 1) + item.rows.cost for item in self.members)

    @property
    def penalised(self) -> float:
        """Whitened squares that are left, with twice the cost: what trials are compared by beside a measured noise."""
        return self.squares + 2.0 * self.cost


def fitted(
    nominal: Problem, members: Sequence[Member], settings: DiagnosisSettings, near: Trial | None = None
) -> Trial:
    """The nominal problem with the members fitted beside the base parameters.

    near: a trial with almost the same members, whose misfit is where to start from when this one's is located.
    """
    problem = nominal
    if members:
        problem = extended(nominal, off(nominal.basis, columns_of(nominal, members)))
    power = band_power(problem)
    few = problem.noise_is_measured and len(members) <= settings.largest_explanation
    complete = few and power.least_probability > settings.consistency_probability
    # The power itself, not the trial, or each would keep the one before alive.
    # One that leaves no misfit does not tell where this one's is.
    afresh = complete or near is None or near.complete or not is_inflated(near.power)
    start, rounds = (power, FULL_ROUNDS) if afresh or near is None else (near.power, QUICK_ROUNDS)
    return Trial(tuple(members), nominal, problem, power, complete, start, rounds)


def pruned(nominal: Problem, trial: Trial, settings: DiagnosisSettings) -> Trial:
    """Members whose loss costs less than it must, left out one by one, the weakest first."""
    while trial.members:
        scores = removal_scores(nominal, trial, settings)
        weakest = int(np.argmin(scores))
        if scores[weakest] >= (settings.provisional_score if nominal.noise_is_measured else settings.background_score):
            return trial
        trial = fitted(nominal, without(trial.members, weakest), settings)
    return trial


def removal_scores(nominal: Problem, trial: Trial, settings: DiagnosisSettings) -> tuple[float, ...]:
    """Of every member what is lost when it is left out and the others are fitted again."""
    rests = [fitted(nominal, without(trial.members, index), settings, trial) for index in range(len(trial.members))]
    if nominal.noise_is_measured:
        return tuple(score_of(rest.problem, member) for rest, member in zip(rests, trial.members, strict=True))
    return tuple(trial.likelihood - rest.likelihood for rest in rests)


def without(members: Sequence[Member], index: int) -> tuple[Member, ...]:
    """All members but one."""
    return tuple(item for position, item in enumerate(members) if position != index)
