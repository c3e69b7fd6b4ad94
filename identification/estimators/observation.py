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

RANK_TOLERANCE = 1e-10
_SMALLEST_RELATIVE_COST = 1e-8


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

    @property
    def scale(self) -> float:
        """What programs count as 1: the smallest cost, or a small share of the squared torque where data are exact."""
        return max(self.residual_square, _SMALLEST_RELATIVE_COST * float(self.projected @ self.projected))

    def cost(self, base_values: FloatArray) -> float:
        """Weighted sum of squared residuals of the base parameters (p,)."""
        difference = self.triangular @ base_values - self.projected
        return float(difference @ difference) + self.residual_square

    def minimiser(self) -> FloatArray:
        """The base parameters (p,) of smallest cost, eq. (9)."""
        return np.asarray(scipy.linalg.solve_triangular(self.triangular, self.projected), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class CompressedObservation:
    """[Y_b τ] of each joint as a factor B_j of size (p + 1)²: B_jᵀB_j = [Y_b τ]ᵀ[Y_b τ].

    blocks: (n, p + 1, p + 1). counts: (n,) rows per joint.
    """

    blocks: FloatArray
    counts: IntArray
    names: tuple[str, ...]

    @property
    def rows(self) -> int:
        """Number of rows over all joints."""
        return int(self.counts.sum())

    def residual_squares(self, base_values: FloatArray) -> FloatArray:
        """(n,) sum of squared residuals of each joint, Nm², for base parameters (p,)."""
        images = self.blocks @ np.append(base_values, -1.0)
        return np.asarray(np.einsum("ni,ni->n", images, images), dtype=np.float64)

    def degrees_of_freedom(self, reduced: ReducedProblem, weights: FloatArray) -> FloatArray:
        """(n,) parameters that each joint's rows take up in a fit with these weights; they add up to p."""
        size = len(self.names)
        inverse = scipy.linalg.solve_triangular(reduced.triangular, np.eye(size))
        images = self.blocks[:, :, :size] @ inverse
        return np.asarray(weights * np.einsum("nij,nij->n", images, images), dtype=np.float64)

    def torque_squares(self) -> FloatArray:
        """(n,) sum of squared torques of each joint, Nm²."""
        last = self.blocks[:, :, -1]
        return np.asarray(np.einsum("ni,ni->n", last, last))

    def reduced(self, weights: FloatArray | None = None) -> ReducedProblem:
        """All joints as one problem, each joint's squares multiplied by its weight (n,), 1/Nm²; default all 1.

        Raises UndeterminedParametersError when the columns are not independent.
        """
        size = len(self.names)
        scale = np.ones(len(self.blocks)) if weights is None else weights
        stacked = (np.sqrt(scale)[:, None, None] * self.blocks).reshape(-1, size + 1)
        triangle = np.linalg.qr(stacked, mode="r")
        padded = np.zeros((size + 1, size + 1))
        padded[: len(triangle)] = triangle
        check_rank(padded[:size, :size], self.names)
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
        rows = observation.joint == joint
        matrix = observation.matrix[rows].T
        used = np.flatnonzero(matrix.any(axis=1))
        joints.append((matrix[used], used, observation.torque[rows]))
    return compress_joints(joints, observation.names)


def compress_joints(
    joints: Sequence[tuple[FloatArray, IntArray, FloatArray]], names: tuple[str, ...]
) -> CompressedObservation:
    """One block per joint, of its columns (m, rows), their positions (m,) among the parameters, and torque (rows,).

    Any number of rows will do; a joint without rows has zeros.
    """
    size = len(names)
    blocks = np.zeros((len(joints), size + 1, size + 1))
    for block, (columns, used, torque) in zip(blocks, joints, strict=True):
        triangle = np.linalg.qr(np.vstack([columns, torque]).T, mode="r")
        block[: len(triangle), np.append(used, size)] = triangle
    counts = np.array([len(torque) for _, _, torque in joints], dtype=np.int64)
    return CompressedObservation(blocks, counts, names)


def merge(parts: list[CompressedObservation]) -> CompressedObservation:
    """Several recordings of one robot as one observation. Raises EstimationError if their parameters differ."""
    first = parts[0]
    for part in parts:
        if part.names != first.names or part.blocks.shape != first.blocks.shape:
            raise EstimationError("The recordings to be fitted together have different parameters or joints.")
    if len(parts) == 1:
        return first
    counts = np.sum([part.counts for part in parts], axis=0)
    blocks = np.asarray(np.linalg.qr(np.concatenate([part.blocks for part in parts], axis=1), mode="r"))
    return CompressedObservation(blocks, counts, first.names)


def check_rank(triangular: FloatArray, names: tuple[str, ...]) -> None:
    """Raise UndeterminedParametersError, naming the parameters, if columns of the (p, p) factor are dependent."""
    norms = np.linalg.norm(triangular, axis=0)
    largest = norms.max(initial=0.0)
    zero = norms <= RANK_TOLERANCE * largest if largest > 0.0 else np.ones(len(names), dtype=np.bool_)
    normalised = np.where(zero, 0.0, triangular / np.where(zero, 1.0, norms))
    if not zero.any():
        # The smallest singular value is no less than 1/‖R⁻¹‖, the largest no more than ‖R‖, Frobenius' norms: mostly
        # that proves what the decomposition would show.
        inverse, fault = scipy.linalg.lapack.dtrtri(normalised)
        if fault == 0 and float(np.linalg.norm(inverse)) * RANK_TOLERANCE * max(np.sqrt(len(names)), 1.0) < 1.0:
            return
    _, singular, right = np.linalg.svd(normalised)
    null = right[singular <= RANK_TOLERANCE * max(singular[0], 1.0)]
    if len(null) == 0:
        return
    involved = zero | (np.abs(null).max(axis=0) > 1e-3)
    undetermined = tuple(name for name, is_involved in zip(names, involved, strict=True) if is_involved)
    raise UndeterminedParametersError(undetermined, rank=len(names) - len(null), size=len(names))
