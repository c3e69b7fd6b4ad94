"""One Gaussian model of a joint's rows, and the log evidence of what it holds.

y_j = F_j b + B_j a_j + ε_j: y, F the whitened torque and base columns of joint j, b the same for all joints and free,
B_j the columns of its classes, a of variance v per group, ε of variance κ per band (1 where the noise is the measured
one). Everything enters through Gram matrices of [B F y] per band, so that a hypothesis costs a Cholesky factor of a few
columns. Variances by MacKay's fixed point (Neural Computation 4, 1992; the noise by the same rule). Here: the model of
given groups. Not here: which groups (`selection`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.linalg import cho_solve, cholesky, lapack, solve_triangular

from identification.arrays import FloatArray, IntArray
from identification.mismatch.settings import OPEN_BEYOND_NOISE

FREE = 1e-9
"""Prior precision of b in units of the data's own: nothing, but for directions that no row determines."""
ABSENT = 1e12
"""Precision beforehand of a name that is left out, as a multiple of that by its size.

Not in units of its coefficients: of a compliance of 1e-6 rad/Nm that would leave the name in.
"""
LEAST_NOISE = 1e-6
LEAST_FREEDOM = 0.05
"""Share of a band's rows below which its freedom is not taken, however many columns describe it."""


@dataclass(frozen=True, slots=True, eq=False)
class JointGram:
    """Products of one joint's rows. gram: (bands, M, M) of [B F y], M = m + p + 1. count: (bands,) rows.

    group: (m,) number of the group that each column of B belongs to, 0 … groups − 1, in order.
    """

    gram: FloatArray
    count: FloatArray
    group: IntArray

    @property
    def columns(self) -> int:
        """Number m of columns of B."""
        return int(self.group.size)

    def less(self, other: JointGram) -> JointGram:
        """The rows that are not among the other ones."""
        return JointGram(self.gram - other.gram, self.count - other.count, self.group)

    def one_band(self) -> JointGram:
        """The same rows with a noise that all bands have in common."""
        return JointGram(self.gram.sum(axis=0)[None], self.count.sum()[None], self.group)

    def only(self, groups: Sequence[int]) -> JointGram:
        """The same rows with some groups, numbered anew in that order."""
        chosen = [np.flatnonzero(self.group == number) for number in groups]
        kept = np.concatenate([*chosen, np.arange(self.columns, self.gram.shape[1])]).astype(np.int64)
        if np.array_equal(kept, np.arange(self.gram.shape[1])):
            return self
        numbers = np.repeat(np.arange(len(groups)), [part.size for part in chosen])
        return JointGram(self.gram.take(kept, axis=1).take(kept, axis=2), self.count, numbers)


@dataclass(frozen=True, slots=True, eq=False)
class Hyper:
    """Variances of one joint: of each group, Nm², and of the noise in each band, in units of the measured one."""

    variance: FloatArray
    noise: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Marginal:
    """A joint's rows with a integrated out. rest: (p + 1, p + 1) of [F y]. log_determinant: of the rows' covariance.

    root: (m,) deviation of each weight; factor: L of I + root BᵀK⁻¹B root; solved: L⁻¹ root BᵀK⁻¹[F y].
    """

    rest: FloatArray
    log_determinant: float
    root: FloatArray
    factor: FloatArray
    solved: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Shared:
    """What joints have in common. information: (p, p) on b. target: (p,). square: yᵀΣ⁻¹y. log_determinant: sum.

    prior: (p,) precision of each of b beforehand, FREE for base parameters.
    """

    information: FloatArray
    target: FloatArray
    square: float
    log_determinant: float
    prior: FloatArray

    @classmethod
    def of(cls, parts: Sequence[Marginal], prior: FloatArray) -> Shared:
        """The sum over joints."""
        size = prior.size
        rest = np.sum([part.rest for part in parts], axis=0) if parts else np.zeros((size + 1, size + 1))
        determinant = sum(part.log_determinant for part in parts)
        return cls(rest[:-1, :-1], rest[:-1, -1], float(rest[-1, -1]), determinant, prior)

    def plus(self, part: Marginal) -> Shared:
        """With one more joint."""
        return Shared(
            self.information + part.rest[:-1, :-1],
            self.target + part.rest[:-1, -1],
            self.square + float(part.rest[-1, -1]),
            self.log_determinant + part.log_determinant,
            self.prior,
        )

    @property
    def precision(self) -> FloatArray:
        """(p, p) posterior precision of b."""
        return self.information + np.diag(self.prior)

    @property
    def log_evidence(self) -> float:
        """Log p(y), but for −½ N log 2π, and for ½ log FREE of each of b, which all hypotheses share."""
        factor = cholesky(self.precision, lower=True, check_finite=False)
        half = solve_triangular(factor, self.target, lower=True, check_finite=False)
        determinant = self.log_determinant + 2.0 * float(np.log(np.diag(factor)).sum())
        return -0.5 * (determinant - float(np.log(self.prior / FREE).sum()) + self.square - float(half @ half))


@dataclass(frozen=True, slots=True, eq=False)
class Posterior:
    """What the rows say. weights: (m,) a. covariance: (M − 1, M − 1) of [a b]. base: (p,) b.

    left: (bands,) squares of y − B a − F b. spread: (bands,) what the uncertainty of a and b adds to them.
    """

    weights: FloatArray
    base: FloatArray
    covariance: FloatArray
    left: FloatArray
    spread: FloatArray


def marginal(joint: JointGram, hyper: Hyper) -> Marginal:
    """One joint with its weights integrated out, under given variances."""
    size = joint.columns
    total = np.tensordot(1.0 / hyper.noise, joint.gram, axes=1)
    root = np.sqrt(hyper.variance[joint.group]) if size else np.zeros(0)
    inner = root[:, None] * total[:size, :size] * root
    inner[np.diag_indices(size)] += 1.0
    factor = cholesky(inner, lower=True, check_finite=False) if size else inner
    solved = root[:, None] * total[:size, size:]
    if size:
        solved = solve_triangular(factor, solved, lower=True, check_finite=False)
    determinant = 2.0 * float(np.log(np.diag(factor)).sum()) + float(joint.count @ np.log(hyper.noise))
    return Marginal(total[size:, size:] - solved.T @ solved, determinant, root, factor, solved)


def mean(part: Marginal, shared: Shared) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Weights (m,) of one joint, base parameters (p,), and the factor L of their precision, all joints' rows seen."""
    factor = cholesky(shared.precision, lower=True, check_finite=False)
    base = cho_solve((factor, True), shared.target, check_finite=False)
    if not part.root.size:
        return np.zeros(0), base, factor
    seen = part.solved[:, -1] - part.solved[:, :-1] @ base
    return part.root * solve_triangular(part.factor, seen, lower=True, trans=1, check_finite=False), base, factor


def posterior(joint: JointGram, part: Marginal, shared: Shared) -> Posterior:
    """Weights of one joint and the base parameters, all joints' rows seen."""
    size = joint.columns
    # Their precision is FᵀF; the inverse of the triangle F, with a row and a column of zeros for y.
    inverse = np.zeros(joint.gram.shape[1:], order="F")
    factor = cholesky(shared.precision, lower=True, check_finite=False)
    half = inverse[size:-1, size:-1]
    half[:] = lapack.dtrtri(factor, lower=1)[0]
    base = half.T @ (half @ shared.target)
    weights = np.zeros(0)
    if size:
        inverse[:size, :size] = lapack.dtrtri(part.factor, lower=1)[0]
        inverse[:size, :size] *= part.root
        back = inverse[:size, :size].T @ part.solved
        weights = back[:, -1] - back[:, :-1] @ base
        inverse[size:-1, :size] = -half @ back[:, :-1].T
    # The lower half of its product with itself: a third of the work of all of it.
    covariance = lapack.dlauum(inverse, lower=1, overwrite_c=1)[0]
    np.einsum("ii->i", covariance)[:] *= 0.5
    covariance = covariance + covariance.T
    line = np.concatenate([-weights, -base, [1.0]])
    left = (joint.gram @ line) @ line
    spread = joint.gram.reshape(len(left), -1) @ covariance.ravel(order="K")
    return Posterior(weights, base, covariance[:-1, :-1], left, spread)


def updated(joint: JointGram, hyper: Hyper, now: Posterior, cap: float, noise_rows: float, odds: float) -> Hyper:
    """One step of the fixed point. cap: largest variance. noise_rows: worth of the measured noise, 0 without any.

    odds: that a band's noise is not the measured one, beforehand.
    """
    variance = hyper.variance.copy()
    diagonal = np.diag(now.covariance)
    for number, value in enumerate(variance):
        own = np.flatnonzero(joint.group == number)
        determined = own.size - float(diagonal[own].sum()) / value
        square = float(now.weights[own] @ now.weights[own])
        variance[number] = min(max(square / max(determined, 1e-3), 1e-6 * cap), cap)
    trust = noise_rows * as_measured(hyper.noise, noise_rows, odds)
    freedom = np.maximum(joint.count - now.spread / hyper.noise, LEAST_FREEDOM * joint.count)
    noise = (now.left + trust) / np.maximum(freedom + trust, 1e-9)
    return Hyper(variance, np.where(joint.count > 0.0, np.maximum(noise, LEAST_NOISE), 1.0))


def squares_of(rows: JointGram, part: Marginal, shared: Shared, noise: FloatArray) -> tuple[float, float]:
    """Squares that weights and base parameters of other rows leave of these, and how many of these count.

    part, shared: what the other rows say. Directions of the base parameters that they leave open, by more than
    OPEN_BEYOND_NOISE deviations of the noise on these rows, are settled here.
    """
    size = rows.columns
    weights, base, factor = mean(part, shared)
    line = np.concatenate([-weights, -base, [1.0]])
    gram = rows.gram.sum(axis=0)
    square, count = float(line @ gram @ line), float(rows.count.sum())
    information = np.tensordot(1.0 / noise, rows.gram[:, size:-1, size:-1], axes=1)
    # A factor tells that there is no such direction in a tenth of the time that it takes to find them.
    if lapack.dpotrf(OPEN_BEYOND_NOISE**2 * shared.precision - information, lower=1)[1] == 0:
        return max(square, 0.0), count
    inverse = lapack.dtrtri(factor, lower=1)[0]
    values, vectors = np.linalg.eigh(inverse @ information @ inverse.T)
    free = inverse.T @ vectors[:, values > OPEN_BEYOND_NOISE**2]
    within, target = free.T @ gram[size:-1, size:-1] @ free, free.T @ (gram[size:-1] @ line)
    settled = float(target @ np.linalg.lstsq(within, target, rcond=1e-12)[0]) if target.size else 0.0
    return max(square - settled, 0.0), count - free.shape[1]


def settled_variance(joint: JointGram, hyper: Hyper, beside: Shared, cap: float, rounds: int) -> FloatArray:
    """Variance of each group after some steps of the fixed point in which the noise is held, b integrated out.

    beside: all other joints. The same steps as `updated`, on the products of B alone.
    """
    size = joint.columns
    total = np.tensordot(1.0 / hyper.noise, joint.gram, axes=1)
    within, across, target = total[:size, :size], total[size:-1, :size], total[:size, -1]
    precision = beside.precision + total[size:-1, size:-1]
    factor = cholesky(precision, lower=True, check_finite=False)
    both = np.column_stack([across, beside.target + total[size:-1, -1]])
    half = solve_triangular(factor, both, lower=True, check_finite=False)
    visible, target = within - half[:, :-1].T @ half[:, :-1], target - half[:, :-1].T @ half[:, -1]
    first = np.searchsorted(joint.group, np.arange(hyper.variance.size))
    width = np.bincount(joint.group, minlength=hyper.variance.size)
    variance = hyper.variance
    for _ in range(rounds):
        root = np.sqrt(variance[joint.group])
        inner = root[:, None] * visible * root
        inner[np.diag_indices(size)] += 1.0
        inverse = lapack.dtrtri(cholesky(inner, lower=True, check_finite=False), lower=1)[0]
        weights = inverse.T @ (inverse @ (root * target))
        determined = width - np.add.reduceat((inverse**2).sum(axis=0), first)
        square = variance * np.add.reduceat(weights**2, first)
        variance = np.clip(square / np.maximum(determined, 1e-3), 1e-6 * cap, cap)
    return variance


def as_measured(noise: FloatArray, noise_rows: float, odds: float) -> FloatArray:
    """Probability, by its size alone, that a band's noise is the measured one."""
    if noise_rows == 0.0:
        return np.zeros_like(noise)
    if odds == 0.0:
        return np.ones_like(noise)
    usual = np.exp(-0.5 * noise_rows * (np.log(noise) + 1.0 / noise - 1.0))
    return np.asarray(usual / (usual + odds))


def log_prior(noise: FloatArray, noise_rows: float, odds: float) -> float:
    """Log p(κ): a band's noise is the measured one, known as from so many rows, or else anything at those odds."""
    if noise_rows == 0.0:
        return 0.0
    usual = -0.5 * noise_rows * (np.log(noise) + 1.0 / noise - 1.0)
    other = np.log(odds) if odds > 0.0 else -np.inf
    return float(np.sum(np.logaddexp(usual, other) - np.log1p(odds)))


def loss_without(joint: JointGram, hyper: Hyper, now: Posterior, groups: Sequence[int]) -> float:
    """Nats that the evidence falls without some groups, all other variances as they are (Savage and Dickey's ratio)."""
    own = np.flatnonzero(np.isin(joint.group, groups))
    root = np.sqrt(hyper.variance[joint.group[own]])
    scaled = now.covariance[own[:, None], own] / np.outer(root, root)
    # Rounding of a covariance that the data hardly narrow.
    factor = cholesky(scaled + 1e-12 * np.eye(own.size), lower=True, check_finite=False)
    half = solve_triangular(factor, now.weights[own] / root, lower=True, check_finite=False)
    return float(np.log(np.diag(factor)).sum() + 0.5 * (half @ half))


def beside(
    visible: Sequence[FloatArray], held: FloatArray, rest: FloatArray, part: Marginal, shared: Shared
) -> list[tuple[FloatArray, FloatArray]]:
    """Products (w, w) of each kind of k columns that a joint does not hold, and (w,) with its torque, all else
    integrated out.

    visible: (w, w) products of each kind over the noise; held: (m, k) of all with the columns that the joint holds;
    rest: (k, p + 1) with [F y]. part: the joint with those that it holds; shared: with all joints.
    """
    half: FloatArray = np.zeros((len(rest), 0))
    if held.size:
        half = solve_triangular(part.factor, part.root[:, None] * held, lower=True, check_finite=False).T
        rest = rest - half @ part.solved
    solved = np.linalg.solve(shared.precision, np.column_stack([rest[:, :-1].T, shared.target]))
    target = rest[:, -1] - rest[:, :-1] @ solved[:, -1]
    found, last = [], 0
    for block in visible:
        first, last = last, last + len(block)
        own, base = half[first:last], rest[first:last, :-1]
        found.append((block - own @ own.T - base @ solved[:, first:last], target[first:last]))
    return found


def largest_gain(visible: FloatArray, target: FloatArray, variances: FloatArray) -> float:
    """Nats that columns gain with the best of some variances, all else as it is (`beside`)."""
    values, vectors = np.linalg.eigh(visible)
    along = (vectors.T @ target) ** 2
    grown = variances[:, None] * np.maximum(values, 0.0)
    gain = 0.5 * np.sum(variances[:, None] * along / (1.0 + grown) - np.log1p(grown), axis=1)
    return float(gain.max())


def products(left: FloatArray, right: FloatArray, key: IntArray, shape: tuple[int, ...]) -> FloatArray:
    """(parts, bands, M, M') products of the rows of each part and band. shape: (parts, bands)."""
    parts, bands = shape
    result = np.zeros((parts * bands, left.shape[1], right.shape[1]))
    order = np.argsort(key, kind="stable")
    edges = np.searchsorted(key[order], np.arange(parts * bands + 1))
    for number, (first, last) in enumerate(pairwise(edges.tolist())):
        rows = order[first:last]
        block = left[rows]
        # Of one array with itself only half of the products are computed.
        result[number] = block.T @ (block if right is left else right[rows])
    return result.reshape(parts, bands, left.shape[1], right.shape[1])
