"""Is there misfit at all, on which joint and in which band: the residual's power against the noise's. Names nothing."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from scipy.special import fdtrc

from identification.arrays import FloatArray
from identification.mismatch.problem import Problem

# Bands with less freedom than this are filled by the base parameters and test nothing.
LEAST_FREEDOM = 0.3
# Weights whose deviation would change by less than this factor stay as they are.
BARELY_INFLATED = 1.3


@dataclass(frozen=True, slots=True, eq=False)
class BandPower:
    """Residual against noise per joint and band, (n, bands): V = power / noise power, its degrees of freedom, p value.

    V is 1 where a band is empty.
    """

    ratio: FloatArray
    freedom: FloatArray
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
    taken = np.einsum("ij,ij->i", problem.basis, problem.basis).reshape(problem.n, problem.rows)
    return _power(problem, values, _sum_bands(problem, taken))


def _power(problem: Problem, residual: FloatArray, taken: FloatArray) -> BandPower:
    """taken: (n, bands) degrees of freedom that the fit takes from each band."""
    power = _sum_bands(problem, (residual**2).reshape(problem.n, problem.rows))
    counted = _sum_bands(problem, (problem.weight > 0.0).astype(np.float64))
    freedom = np.maximum(counted - taken, 0.0)
    # Neighbouring lines share one estimate of the noise: the freedom of a band is that of its rows' mean, not sum.
    size = np.bincount(problem.band, minlength=problem.bands)
    mean_freedom = np.where(size > 0, _sum_bands(problem, problem.freedom) / np.maximum(size, 1), 1.0)
    tested = freedom > LEAST_FREEDOM
    ratio = np.where(tested, power / np.where(tested, freedom, 1.0), 1.0)
    probability = np.where(tested, fdtrc(np.maximum(freedom, LEAST_FREEDOM), mean_freedom, ratio), 1.0)
    return BandPower(ratio, freedom, probability)


def located(nominal: Problem, problem: Problem, power: BandPower, rounds: int = 3) -> BandPower:
    """The residual's power in units of the noise, misfit where it sits.

    In a fit weighted by the noise alone, a large misfit on one joint bends base parameters and shows on clean joints
    too. Here every joint and band counts as much as it fits; a few rounds of that leave misfit on its own joint.
    nominal: the problem that `problem` extends. Weights are the same throughout a joint's band, so that a round needs
    only the products of the basis within each.
    """
    products: tuple[FloatArray, FloatArray] | None = None
    for _ in range(rounds):
        if not is_inflated(power):
            break
        products = _products(nominal, problem) if products is None else products
        weight = 1.0 / _per_band(power)
        inverse = np.linalg.inv(np.tensordot(weight, products[0], 2))
        moved = inverse @ np.tensordot(weight, products[1], 2)
        taken = weight * np.tensordot(products[0], inverse, 2)
        power = _power(problem, problem.residual - problem.basis @ moved, taken)
    return power


def _products(nominal: Problem, problem: Problem) -> tuple[FloatArray, FloatArray]:
    """Within each joint and band: products of the basis with itself (n, bands, p', p') and the residual (…, p')."""
    known = _nominal_products(nominal)
    first, size = known.shape[2], problem.basis.shape[1]
    basis = problem.basis.reshape(problem.n, problem.rows, size)
    residual = problem.residual.reshape(problem.n, problem.rows, 1)
    found = _within_bands(problem, basis, np.concatenate([basis[..., first:], residual], axis=2))
    gram = np.empty((problem.n, problem.bands, size, size))
    gram[..., :first, :first] = known
    gram[..., first:] = found[..., :-1]
    gram[..., first:, :first] = found[..., :first, :-1].swapaxes(2, 3)
    return gram, found[..., -1]


@lru_cache(maxsize=2)
def _nominal_products(problem: Problem) -> FloatArray:
    basis = problem.basis.reshape(problem.n, problem.rows, -1)
    return _within_bands(problem, basis, basis)


def _within_bands(problem: Problem, left: FloatArray, right: FloatArray) -> FloatArray:
    """(n, R, a), (n, R, b) → (n, bands, a, b) products over the rows of each joint and band."""
    result = np.zeros((problem.n, problem.bands, left.shape[2], right.shape[2]))
    edges = np.concatenate([[0], np.flatnonzero(np.diff(problem.band)) + 1, [problem.rows]])
    for start, stop in pairwise(edges.tolist()):
        result[:, problem.band[start]] += left[:, start:stop].swapaxes(1, 2) @ right[:, start:stop]
    return result


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


def is_inflated(power: BandPower) -> bool:
    """Whether a power holds misfit anywhere, so that it tells where another residual's may sit."""
    return bool(np.any(np.sqrt(_per_band(power)) >= BARELY_INFLATED))


def _per_band(power: BandPower) -> FloatArray:
    """(n, bands) factor on the noise's variance."""
    ratio, _ = pooled_low_bands(power)
    variance = np.concatenate([np.repeat(ratio[:, :1], 3, axis=1), ratio[:, 1:]], axis=1)
    return np.asarray(np.maximum(variance, 1.0), dtype=np.float64)


def _sum_bands(problem: Problem, values: FloatArray) -> FloatArray:
    """(n, R) → (n, bands)."""
    indicator = np.zeros((problem.rows, problem.bands))
    indicator[np.arange(problem.rows), problem.band] = 1.0
    return np.asarray(values @ indicator, dtype=np.float64)
