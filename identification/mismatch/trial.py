"""A set of effects fitted together, and in which of the two regimes it stands.

"complete": nothing but noise is left on every joint and in every band. "background": unknown model error remains.
Called by the search, the pruning and the rule of abstention.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from identification.mismatch.detection import BandPower, band_power, located, whittle
from identification.mismatch.library import COEFFICIENT_COST
from identification.mismatch.problem import Problem, extended, off, spread
from identification.mismatch.refinement import Member
from identification.mismatch.settings import DiagnosisSettings

FULL_ROUNDS = 3
QUICK_ROUNDS = 1
"""Rounds in which misfit is located, from the start and from a trial that is near."""


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """Members with the problem in which they are fitted. complete: nothing but noise is left.

    weighted: the same problem weighted by noise and misfit; power: of its residual, in units of the noise (`located`);
    likelihood: its profile likelihood beside an unknown background.
    """

    members: tuple[Member, ...]
    problem: Problem
    power: BandPower
    complete: bool
    likelihood: float
    weighted: Problem

    @property
    def squares(self) -> float:
        """Whitened squares that are left."""
        return float(self.problem.residual @ self.problem.residual)

    @property
    def cost(self) -> float:
        """Log-likelihood that further coefficients and the choice of shapes cost."""
        return sum(COEFFICIENT_COST * (len(item.selection) - 1) + item.rows.cost for item in self.members)

    @property
    def penalised(self) -> float:
        """Whitened squares that are left, with twice the cost: what complete trials are compared by."""
        return self.squares + 2.0 * self.cost


def fitted(
    nominal: Problem, members: Sequence[Member], settings: DiagnosisSettings, near: Trial | None = None
) -> Trial:
    """The nominal problem with the members fitted beside the base parameters.

    near: a trial with almost the same members, whose misfit is where to start from when this one's is located.
    """
    problem = nominal
    if members:
        columns = np.concatenate([spread(nominal, item.rows.joints, item.used_rows()) for item in members], axis=1)
        problem = extended(nominal, off(nominal.basis, columns))
    power = band_power(problem)
    complete = problem.noise_is_measured and power.least_probability > settings.consistency_probability
    weighted, spread_out = problem, power
    if not complete:
        start, rounds = (power, FULL_ROUNDS) if near is None or near.complete else (near.power, QUICK_ROUNDS)
        weighted, spread_out = located(problem, start, rounds)
    return Trial(tuple(members), problem, spread_out, complete, whittle(spread_out), weighted)
