"""The observation (8), τ = Y_b π_b over all samples, and its compression to one small triangle per joint.

Here: reading the tall matrix once. Every estimator afterwards works on the compressed form: per-joint blocks of size
(p + 1)² from which weighted least squares, RMS per joint and the programs with physical constraints all follow.
Not here: solving anything.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from identification.arrays import FloatArray, IntArray
from identification.errors import EstimationError, UndeterminedParametersError

_NORMAL_EQUATIONS_CONDITION = 1e5
_NORMAL_EQUATIONS_RESIDUAL = 1e-5
_RANK_TOLERANCE = 1e-10


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """One linear system for the base parameters.

    matrix: (rows, p) Nm per unit of the parameter. torque: (rows,) Nm, sign of eq. (1). joint: (rows,) joint of each
    row, counted from 0. names: p names. Raises EstimationError for shapes that do not fit or numbers not finite.
    """

    matrix: FloatArray
    torque: FloatArray
    joint: IntArray
    names: tuple[str, ...]

    def __post_init__(self) -> None:
        rows, size = self.matrix.shape
        if self.torque.shape != (rows,) or self.joint.shape != (rows,) or len(self.names) != size:
            raise EstimationError(
                f"An observation of {rows} rows and {size} columns has {self.torque.shape} torques, "
                f"{self.joint.shape} joints and {len(self.names)} names."
            )
        if rows <= size:
            raise EstimationError(f"{rows} rows of data cannot determine {size} parameters; record a longer motion.")
        if not (np.isfinite(self.matrix.sum()) and np.isfinite(self.torque.sum())):
            bad = np.flatnonzero(~np.isfinite(self.matrix).all(axis=1) | ~np.isfinite(self.torque))
            if len(bad):
                raise EstimationError(
                    f"{len(bad)} of {rows} rows of the observation hold numbers that are not finite, the first is row "
                    f"{bad[0] + 1} (joint {self.joint[bad[0]] + 1})."
                )

    @property
    def joints(self) -> int:
        """Number of joints."""
        return int(self.joint.max()) + 1


@dataclass(frozen=True, slots=True, eq=False)
class ReducedProblem:
    """Weighted least squares of any size as ‖triangular · π_b − projected‖² + residual_square.

    triangular: (p, p) upper triangular. projected: (p,). residual_square: the smallest weighted sum of squared
    residuals that any π_b reaches. rows: number of rows it stands for.
    """

    triangular: FloatArray
    projected: FloatArray
    residual_square: float
    rows: int

    def cost(self, base_values: FloatArray) -> float:
        """Weighted sum of squared residuals of the base parameters (p,)."""
        difference = self.triangular @ base_values - self.projected
        return float(difference @ difference) + self.residual_square

    def minimiser(self) -> FloatArray:
        """The base parameters (p,) of smallest cost, eq. (9)."""
        return np.asarray(scipy.linalg.solve_triangular(self.triangular, self.projected), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class CompressedObservation:
    """[Y_b τ] of each joint as a block B_j of size (p + 1)²: a factor, B_jᵀB_j = [Y_b τ]ᵀ[Y_b τ], or that product.

    blocks: (n, p + 1, p + 1). factored: whether they are factors. counts: (n,) rows per joint.
    """

    blocks: FloatArray
    factored: bool
    counts: IntArray
    names: tuple[str, ...]

    @property
    def rows(self) -> int:
        """Number of rows over all joints."""
        return int(self.counts.sum())

    def residual_squares(self, base_values: FloatArray) -> FloatArray:
        """(n,) sum of squared residuals of each joint, Nm², for base parameters (p,)."""
        direction = np.append(base_values, -1.0)
        images = self.blocks @ direction
        squares = np.einsum("ni,ni->n", images, images) if self.factored else images @ direction
        return np.asarray(np.maximum(squares, 0.0), dtype=np.float64)

    def degrees_of_freedom(self, reduced: ReducedProblem, weights: FloatArray) -> FloatArray:
        """(n,) parameters that each joint's rows take up in a fit with these weights; they add up to p."""
        size = len(self.names)
        inverse = scipy.linalg.solve_triangular(reduced.triangular, np.eye(size))
        if self.factored:
            images = self.blocks[:, :, :size] @ inverse
            return np.asarray(weights * np.einsum("nij,nij->n", images, images), dtype=np.float64)
        covariance = inverse @ inverse.T
        return np.asarray(weights * np.einsum("nij,ij->n", self.blocks[:, :size, :size], covariance), dtype=np.float64)

    def torque_squares(self) -> FloatArray:
        """(n,) sum of squared torques of each joint, Nm²."""
        last = self.blocks[:, :, -1]
        return np.asarray(np.einsum("ni,ni->n", last, last) if self.factored else last[:, -1])

    def reduced(self, weights: FloatArray | None = None) -> ReducedProblem:
        """All joints as one problem, each joint's squares multiplied by its weight (n,), 1/Nm²; default all 1.

        Raises UndeterminedParametersError when the columns are not independent.
        """
        size = len(self.names)
        scale = np.ones(len(self.blocks)) if weights is None else weights
        if self.factored:
            stacked = (np.sqrt(scale)[:, None, None] * self.blocks).reshape(-1, size + 1)
            triangle = np.linalg.qr(stacked, mode="r")
            padded = np.zeros((size + 1, size + 1))
            padded[: len(triangle)] = triangle
            check_rank(padded[:size, :size], self.names)
        else:
            padded = scipy.linalg.cholesky(np.einsum("n,nij->ij", scale, self.blocks))
        return ReducedProblem(
            triangular=np.triu(padded[:size, :size]),
            projected=padded[:size, size].copy(),
            residual_square=float(padded[size, size] ** 2),
            rows=self.rows,
        )


def compress(observation: Observation) -> CompressedObservation:
    """Read the tall matrix once and keep one block per joint, as `compress_joints` does."""
    joints = []
    for joint in range(observation.joints):
        rows = _rows_of(observation.joint, joint)
        matrix = observation.matrix[rows]
        used = np.flatnonzero((matrix != 0.0).any(axis=0)).astype(np.int64)
        joints.append((matrix[:, used].T, used, observation.torque[rows]))
    return compress_joints(joints, observation.names)


def compress_joints(
    joints: Sequence[tuple[FloatArray, IntArray, FloatArray]], names: tuple[str, ...]
) -> CompressedObservation:
    """One block per joint, of its columns (m, rows), their positions (m,) among the parameters, and torque (rows,).

    The products [Y_b τ]ᵀ[Y_b τ] are formed first; they are kept where the columns (normalised) have a condition
    number below 1e5 and the residual is no rounding error. Otherwise every joint's block is factored by QR.
    """
    size = len(names)
    blocks = np.zeros((len(joints), size + 1, size + 1))
    for block, (columns, used, torque) in zip(blocks, joints, strict=True):
        block[np.ix_(used, used)] = columns @ columns.T
        block[used, size] = block[size, used] = columns @ torque
        block[size, size] = torque @ torque
    counts = np.array([len(torque) for _, _, torque in joints], dtype=np.int64)
    if _normal_equations_are_safe(blocks.sum(axis=0)):
        return CompressedObservation(blocks, False, counts, names)
    blocks = np.zeros_like(blocks)
    for block, (columns, used, torque) in zip(blocks, joints, strict=True):
        triangle = np.linalg.qr(np.vstack([columns, torque]).T, mode="r")
        block[: len(triangle), np.append(used, size)] = triangle
    return CompressedObservation(blocks, True, counts, names)


def merge(parts: list[CompressedObservation]) -> CompressedObservation:
    """Several recordings of one robot as one observation. Raises EstimationError if their parameters differ."""
    first = parts[0]
    for part in parts:
        if part.names != first.names or part.blocks.shape != first.blocks.shape:
            raise EstimationError("The recordings to be fitted together have different parameters or joints.")
    if len(parts) == 1:
        return first
    counts = np.sum([part.counts for part in parts], axis=0)
    if not any(part.factored for part in parts):
        return CompressedObservation(np.sum([part.blocks for part in parts], axis=0), False, counts, first.names)
    size = first.blocks.shape[1]
    blocks = np.zeros_like(first.blocks)
    for joint in range(len(blocks)):
        stacked = np.vstack([_factor(part.blocks[joint], part.factored) for part in parts])
        triangle = np.linalg.qr(stacked, mode="r")
        blocks[joint, : min(size, len(triangle))] = triangle
    return CompressedObservation(blocks, True, counts, first.names)


def check_rank(triangular: FloatArray, names: tuple[str, ...]) -> None:
    """Raise UndeterminedParametersError, naming the parameters, if columns of the (p, p) factor are dependent."""
    norms = np.linalg.norm(triangular, axis=0)
    largest = norms.max(initial=0.0)
    zero = norms <= _RANK_TOLERANCE * largest if largest > 0.0 else np.ones(len(names), dtype=np.bool_)
    normalised = np.where(zero, 0.0, triangular / np.where(zero, 1.0, norms))
    if not zero.any():
        # The smallest singular value is no less than 1/‖R⁻¹‖, the largest no more than ‖R‖, Frobenius' norms: mostly
        # that proves what the decomposition would show.
        inverse, fault = scipy.linalg.lapack.dtrtri(normalised)
        if fault == 0 and float(np.linalg.norm(inverse)) * _RANK_TOLERANCE * max(np.sqrt(len(names)), 1.0) < 1.0:
            return
    _, singular, right = np.linalg.svd(normalised)
    null = right[singular <= _RANK_TOLERANCE * max(singular[0], 1.0)]
    if len(null) == 0:
        return
    involved = zero | (np.abs(null).max(axis=0) > 1e-3)
    undetermined = tuple(name for name, is_involved in zip(names, involved, strict=True) if is_involved)
    raise UndeterminedParametersError(undetermined, rank=len(names) - len(null), size=len(names))


def _rows_of(joint_of_row: IntArray, joint: int) -> slice | IntArray:
    """The rows of one joint, as a slice where they lie evenly (then no copy is made)."""
    rows = np.flatnonzero(joint_of_row == joint).astype(np.int64)
    if len(rows) > 1:
        step = int(rows[1] - rows[0])
        if rows[-1] - rows[0] == step * (len(rows) - 1) and np.all(np.diff(rows) == step):
            return slice(int(rows[0]), int(rows[-1]) + 1, step)
    return rows


def _normal_equations_are_safe(product: FloatArray) -> bool:
    norms = np.sqrt(np.diag(product))
    if not np.all(norms > 0.0):
        return False
    try:
        triangle = scipy.linalg.cholesky(product / np.outer(norms, norms))
    except np.linalg.LinAlgError:
        return False
    singular = np.linalg.svd(triangle[:-1, :-1], compute_uv=False)
    return bool(
        singular[0] < _NORMAL_EQUATIONS_CONDITION * singular[-1] and triangle[-1, -1] > _NORMAL_EQUATIONS_RESIDUAL
    )


def _factor(block: FloatArray, factored: bool) -> FloatArray:
    if factored:
        return block
    values, vectors = np.linalg.eigh(block)
    return np.asarray(np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T, dtype=np.float64)
