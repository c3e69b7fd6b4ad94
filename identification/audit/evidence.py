"""One evidence for every hypothesis: products of rows, and the log odds of columns that are added to a model.

τ − Y β₀ = Y δ + B θ + e with δ ~ N(0, C₀), θ ~ N(0, P), e_j ~ N(0, σ_j² κ_j): Gaussian throughout, so odds, values,
and what is left on rows that were not used all come from the products of columns. κ_j is how many neighbouring rows
count as one. Pure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve, lapack

from identification.arrays import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Products:
    """Of columns X and target d per part and joint. gram: (parts, n, K, K), right: (parts, n, K), square, count:
    (parts, n).
    """

    gram: FloatArray
    right: FloatArray
    square: FloatArray
    count: FloatArray

    def summed(self, parts: Sequence[int], weight: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Gram (K, K) and right side (K,) of some parts with weights (n,) of the joints."""
        each = [weight @ self.gram[part].reshape(len(weight), -1) for part in parts]
        gram = np.add.reduce(each).reshape(self.gram.shape[2:])
        return gram, np.add.reduce([weight @ self.right[part] for part in parts])

    def together(self, parts: Sequence[int]) -> Products:
        """Of some parts as one."""
        own = (self.gram, self.right, self.square, self.count)
        if len(parts) == 1:
            return Products(*(each[parts[0] : parts[0] + 1] for each in own))
        chosen = np.zeros(len(self.count))
        chosen[list(parts)] = 1.0
        return Products(*((chosen @ each.reshape(len(chosen), -1)).reshape(1, *each.shape[1:]) for each in own))

    def left(self, parts: Sequence[int], values: FloatArray, columns: IntArray) -> FloatArray:
        """(n,) sum of squares that (k,) values of some columns, which may come twice, leave on some parts."""
        whole = self.together(parts)
        every = np.bincount(columns, values, whole.right.shape[2])
        squares = whole.square[0] + (whole.gram[0] @ every - 2.0 * whole.right[0]) @ every
        return np.asarray(np.maximum(squares, 0.0), dtype=np.float64)

    def beside(self, values: FloatArray) -> Products:
        """Of the same columns with what (K,) values of them leave of the target."""
        right = self.right - self.gram @ values
        return replace(self, right=right, square=np.maximum(self.square - (self.right + right) @ values, 0.0))

    def of(self, columns: IntArray) -> Products:
        """Of some columns."""
        if np.array_equal(columns, np.arange(self.right.shape[2])):
            return self
        # What numpy makes of an index has its axes in another order, and each product would copy it once more.
        gram = np.ascontiguousarray(self.gram[..., columns[:, None], columns])
        return replace(self, gram=gram, right=self.right[..., columns])

    def counts(self, parts: Sequence[int]) -> FloatArray:
        """(n,) rows of each joint in some parts."""
        return np.asarray(self.count[list(parts)].sum(axis=0), dtype=np.float64)


def products_of(columns: FloatArray, target: FloatArray, used: BoolArray, part: IntArray, parts: int) -> Products:
    """Products of columns (R, n, K) and target (R, n) over the rows of each part, rows of a joint at rest out.

    part: (R,) which of so many parts a row is in.
    """
    n, width = target.shape[1], columns.shape[2]
    gram, right = np.zeros((parts, n, width, width)), np.zeros((parts, n, width))
    square, count = np.zeros((parts, n)), np.zeros((parts, n))
    for joint in range(n):
        live = np.flatnonzero(columns[:, joint].any(axis=0))
        alive = columns[:, joint, live]
        for place in range(parts):
            rows = (part == place) & used[:, joint]
            own, seen = alive[rows], target[rows, joint]
            gram[place, joint][np.ix_(live, live)] = own.T @ own
            right[place, joint, live] = own.T @ seen
            square[place, joint], count[place, joint] = seen @ seen, rows.sum()
    return Products(gram, right, square, count)


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """values: (k,) of some columns. factor: F (k, m) of their prior, or its diagonal. root: of the precision of z."""

    values: FloatArray
    factor: FloatArray
    root: tuple[FloatArray, bool]

    @property
    def covariance(self) -> FloatArray:
        """(k, k) of the values; most are asked for without."""
        factor = np.diag(self.factor) if self.factor.ndim == 1 else self.factor
        return np.asarray(factor @ cho_solve(self.root, factor.T))


def posterior(gram: FloatArray, right: FloatArray, factor: FloatArray) -> Estimate:
    """Of Gaussian parameters F z, z ~ N(0, 1); a vector stands for the diagonal of F."""
    root, seen = _of_standard(gram, right, factor)
    solved = lapack.dpotrs(root[0], seen)[0]
    return Estimate(factor * solved if factor.ndim == 1 else factor @ solved, factor, root)


def _of_standard(gram: FloatArray, right: FloatArray, factor: FloatArray) -> tuple[tuple[FloatArray, bool], FloatArray]:
    """Root of the precision (m, m) of z in F z, z ~ N(0, 1), and its right side (m,)."""
    if factor.ndim == 1:
        precision, seen = factor[:, None] * gram * factor, factor * right
    else:
        precision, seen = factor.T @ gram @ factor, factor.T @ right
    np.einsum("ii->i", precision)[:] += 1.0
    # By thousands, and of few columns: what SciPy asks about its arguments takes as long as the root.
    root, failed = lapack.dpotrf(precision.T, clean=0, overwrite_a=1)
    if failed:
        raise np.linalg.LinAlgError("the precision of a hypothesis is not positive definite")
    return (root, False), seen


def marginal(gram: FloatArray, right: FloatArray, base: IntArray, factor: FloatArray) -> tuple[
    FloatArray, FloatArray
]:  # fmt: skip
    """Gram and right side of all columns where those of the base with prior F Fᵀ are integrated out."""
    inner = np.eye(factor.shape[1]) + factor.T @ gram[np.ix_(base, base)] @ factor
    root = cho_factor(inner)
    seen = factor.T @ gram[base]
    solved = cho_solve(root, seen)
    return gram - seen.T @ solved, right - solved.T @ (factor.T @ right[base])


def log_evidence(gram: FloatArray, right: FloatArray, factor: FloatArray) -> float:
    """Log odds of Gaussian parameters F z, z ~ N(0, 1), against none; a vector stands for the diagonal of F."""
    root, seen = _of_standard(gram, right, factor)
    return float(0.5 * seen @ lapack.dpotrs(root[0], seen)[0] - np.log(np.diag(root[0])).sum())


def between_parts(without: FloatArray) -> FloatArray:
    """(k, k) covariance of values by their scatter (parts, k) where one part of the rows is left out at a time.

    The jackknife's, as wide as Student's distribution of so many parts is beside the normal one.
    """
    from scipy.special import stdtrit  # slow to load, and a recording that agrees with its robot does without

    wider = float(stdtrit(len(without) - 1, 0.975)) / 1.96
    return _scatter(without, wider)


def as_they_scatter(covariance: FloatArray, without: FloatArray) -> FloatArray:
    """A covariance (k, k) times how much more the values scatter (parts, k) where one part is left out at a time.

    One factor for all: the jackknife's own variance along k directions together, in units of the covariance, is known
    far better than along one. Parts that scatter less are chance.
    """
    ratio = float(np.trace(np.linalg.solve(covariance, _scatter(without)))) / len(covariance)
    return covariance * max(1.0, ratio)


def _scatter(without: FloatArray, wider: float = 1.0) -> FloatArray:
    """(k, k) the jackknife's covariance of values (parts, k), each with one part left out; deviations times `wider`."""
    count = len(without)
    moved = without - without.mean(axis=0)
    return np.asarray(wider**2 * (count - 1) / count * moved.T @ moved)


def repeated_rows(left: FloatArray, used: BoolArray, smallest: float = 0.05, longest: int = 60) -> FloatArray:
    """(n,) κ = 1 + 2 Σ ρ of residuals (R, n), up to the first correlation below `smallest`."""
    result = np.ones(left.shape[1])
    for joint in range(left.shape[1]):
        series = np.where(used[:, joint], left[:, joint], 0.0)
        power = float(series @ series)
        for lag in range(1, min(longest, len(series) - 1)):
            correlation = float(series[lag:] @ series[:-lag]) / power if power > 0.0 else 0.0
            if correlation < smallest:
                break
            result[joint] += 2.0 * correlation
    return result
