"""What is free beside what is tried: the parameters as the model knows them, and the differences so far. Pure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import block_diag

from identification.audit.columns import INERTIAL, PARAMETERS
from identification.audit.comparison import Comparison
from identification.audit.evidence import Estimate, posterior
from identification.audit.given import GivenModel, Sizes
from identification.audit.hypotheses import Hypothesis, Layout

__all__ = ["Basis", "basis_of", "fitted_on", "left_on", "root_of"]

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


def root_of(covariance: FloatArray, scale: FloatArray) -> FloatArray:
    """F with F Fᵀ the covariance (k, k) of parameters of some sizes (k,)."""
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    return np.asarray(scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))


@dataclass(frozen=True, slots=True, eq=False)
class Basis:
    """The columns that are free beside what is tried, with the factor of their prior."""

    columns: IntArray
    factor: FloatArray

    def plus(self, hypothesis: Hypothesis) -> Basis:
        """With a hypothesis, which has its own copy of its columns."""
        return Basis(
            np.concatenate([self.columns, hypothesis.columns]),
            block_diag(self.factor, np.diag(hypothesis.width)),
        )


def basis_of(layout: Layout, model: GivenModel, sizes: Sizes, steps: list[Hypothesis]) -> Basis:
    """The parameters as the model knows them, and the differences so far."""
    factor = root_of(model.covariance, sizes.each)
    basis = Basis(layout.base, factor)
    for hypothesis in steps:
        basis = basis.plus(hypothesis)
    return basis


def left_on(comparison: Comparison, basis: Basis, weight: FloatArray, fitted: tuple[int, ...], parts: tuple[int, ...],
            model: GivenModel) -> FloatArray:  # fmt: skip
    """(n,) sum of squares that differences leave on some parts, fitted on others beside all that the model leaves open.

    What the parameters would take is not counted as explained: they stay at the model's values, but for the friction
    and offsets of a drawn model, which says nothing of them.
    """
    values = fitted_on(comparison, basis, weight, fitted).values.copy()
    size = PARAMETERS * comparison.geometry.robot.n
    drives = np.arange(size) % PARAMETERS >= INERTIAL
    values[:size][slice(None) if model.own else ~drives] = 0.0
    return comparison.products.left(parts, values, basis.columns)


def fitted_on(comparison: Comparison, basis: Basis, weight: FloatArray, fitted: tuple[int, ...]) -> Estimate:
    """Values of a basis' columns by the rows of some parts."""
    gram, right = comparison.products.summed(fitted, weight)
    chosen = np.ix_(basis.columns, basis.columns)
    return posterior(gram[chosen], right[basis.columns], basis.factor)
