"""Is there misfit at all, on which joint and in which band: the residual's power against the noise's.

Called by the search (is this explained?) and by the verdict (what is left?). Names nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.stats import f as fisher

from identification.mismatch.problem import Problem, reweighted

FloatArray = npt.NDArray[np.float64]

# Bands with less freedom than this are filled by the base parameters and test nothing.
LEAST_FREEDOM = 0.3
# Weights whose deviation would change by less than this factor stay as they are.
BARELY_INFLATED = 1.3


@dataclass(frozen=True, slots=True, eq=False)
class BandPower:
    """Residual against noise per joint and band, (n, bands): V = power / noise power, its degrees of freedom, p value.

    noise_freedom: (n, bands) degrees of freedom behind the noise. V is 1 where a band is empty.
    """

    ratio: FloatArray
    freedom: FloatArray
    noise_freedom: FloatArray
    probability: FloatArray

    @property
    def least_probability(self) -> float:
        """The smallest p value of all joints and bands."""
        return float(self.probability.min())


def band_power(problem: Problem, residual: FloatArray | None = None) -> BandPower:
    """Power of a residual (n R,), by default the problem's own, in units of the noise it was whitened with.

    Each band's freedom is its number of rows less what the basis takes from it.
    """
    values = problem.residual if residual is None else residual
    joints, rows = problem.n, problem.rows
    power = _sum_bands(problem, (values**2).reshape(joints, rows))
    taken = _sum_bands(problem, np.einsum("ij,ij->i", problem.basis, problem.basis).reshape(joints, rows))
    counted = _sum_bands(problem, (problem.weight > 0.0).astype(np.float64))
    freedom = np.maximum(counted - taken, 0.0)
    # Neighbouring lines share one estimate of the noise: the freedom of a band is that of its rows' mean, not sum.
    size = np.bincount(problem.band, minlength=problem.bands)
    mean_freedom = np.where(size > 0, _sum_bands(problem, problem.freedom) / np.maximum(size, 1), 1.0)
    noise_freedom = np.maximum(mean_freedom, freedom * 0.5)
    tested = freedom > LEAST_FREEDOM
    ratio = np.where(tested, power / np.where(tested, freedom, 1.0), 1.0)
    probability = np.where(tested, fisher.sf(ratio, np.maximum(freedom, LEAST_FREEDOM), noise_freedom), 1.0)
    return BandPower(ratio, freedom, noise_freedom, probability)


def located(problem: Problem, power: BandPower, rounds: int = 3) -> tuple[Problem, BandPower]:
    """Misfit where it sits: the problem weighted by noise and misfit, and its residual's power in units of the noise.

    In a fit weighted by the noise alone, a large misfit on one joint bends base parameters and shows on clean joints
    too. Here every joint and band counts as much as it fits; a few rounds of that leave misfit on its own joint.
    """
    weighted = problem
    for _ in range(rounds):
        inflation = inflation_of(problem, power)
        if np.all(inflation < BARELY_INFLATED):
            break
        weighted = reweighted(problem, inflation)
        power = band_power(weighted, weighted.residual * inflation.ravel())
    return weighted, power


def whittle(power: BandPower) -> float:
    """Profile log-likelihood of a smooth background of unknown size above the noise: −Σ ν/2 · log max(V, 1)."""
    ratio, freedom = pooled_low_bands(power)
    return float(-0.5 * np.sum(freedom * np.log(np.maximum(ratio, 1.0))))


def pooled_low_bands(power: BandPower) -> tuple[FloatArray, FloatArray]:
    """Ratios and freedoms with line 0 and the two lowest bands as one.

    A background that is smooth over frequency does not stand on line 0 alone: one strong line is an effect.
    """
    low = power.freedom[:, :3]
    total = low.sum(axis=1)
    mean = (power.ratio[:, :3] * low).sum(axis=1) / np.maximum(total, 1e-12)
    ratio = np.concatenate([np.where(total > 0.0, mean, 1.0)[:, None], power.ratio[:, 3:]], axis=1)
    return ratio, np.concatenate([total[:, None], power.freedom[:, 3:]], axis=1)


def inflation_of(problem: Problem, power: BandPower) -> FloatArray:
    """(n, R) factor on the noise's deviation that makes the residual's power what it is, never below one."""
    ratio, _ = pooled_low_bands(power)
    per_band = np.concatenate([np.repeat(ratio[:, :1], 3, axis=1), ratio[:, 1:]], axis=1)
    return np.asarray(np.sqrt(np.maximum(per_band, 1.0))[:, problem.band], dtype=np.float64)


def _sum_bands(problem: Problem, values: FloatArray) -> FloatArray:
    """(n, R) → (n, bands)."""
    indicator = np.zeros((problem.rows, problem.bands))
    indicator[np.arange(problem.rows), problem.band] = 1.0
    return np.asarray(values @ indicator, dtype=np.float64)
