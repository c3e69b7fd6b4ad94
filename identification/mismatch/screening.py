"""What every candidate would gain beside what is fitted already, for all candidates at once.

One product of matrices per look: each candidate's columns off the basis are never formed, only their Gram matrices.
Called by the search.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from identification.mismatch.library import EffectRows
from identification.mismatch.problem import SWALLOWED, Problem, spread

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

# Log-likelihood that one more coefficient must bring, beyond the first: about log of the rows that carry the motion.
COEFFICIENT_COST = 3.0
# Of a group's directions those whose length off the basis is below this share of its longest are not determined.
UNDETERMINED = 1e-3


@dataclass(frozen=True, slots=True)
class Variant:
    """A candidate as it is scored: its place in the table and which of its columns are used."""

    index: int
    selection: tuple[int, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Screen:
    """All candidates whitened for one problem. columns: (n R, M). start: (C + 1,) first column of each candidate.

    gram: candidate index → (m, m) of its columns off the problem's basis. raw: (M,) square lengths before that.
    """

    problem: Problem
    candidates: Sequence[EffectRows]
    columns: FloatArray
    start: IntArray
    gram: tuple[FloatArray, ...]
    raw: FloatArray
    target: FloatArray


def build_screen(problem: Problem, candidates: Sequence[EffectRows]) -> Screen:
    """Whiten every candidate, take it off the basis, keep its Gram matrix and its product with the residual."""
    columns = np.concatenate([spread(problem, item.joints, item.rows) for item in candidates], axis=1)
    start = np.concatenate([[0], np.cumsum([item.coefficients for item in candidates])]).astype(np.int64)
    raw = np.einsum("ij,ij->j", columns, columns)
    plain = tuple(columns[:, a:b].T @ columns[:, a:b] for a, b in pairwise(start.tolist()))
    screen = Screen(problem, candidates, columns, start, plain, raw, np.zeros(columns.shape[1]))
    return narrowed(screen, problem.basis, problem)


def narrowed(screen: Screen, added: FloatArray, problem: Problem) -> Screen:
    """The screen after further orthonormal directions (n R, k) were fitted; problem: the one with them."""
    shadow = added.T @ screen.columns
    gram = tuple(
        gram - shadow[:, a:b].T @ shadow[:, a:b]
        for gram, a, b in zip(screen.gram, screen.start[:-1], screen.start[1:], strict=True)
    )
    target = screen.columns.T @ problem.residual
    return Screen(problem, screen.candidates, screen.columns, screen.start, gram, screen.raw, target)


def gains(screen: Screen, without: Sequence[int] = ()) -> list[tuple[float, Variant]]:
    """(score, variant) of every candidate, as a whole and column by column, best first.

    score: half the drop of the whitened squares, less the cost of further coefficients. without: candidates left out.
    """
    result: list[tuple[float, Variant]] = []
    for index, gram in enumerate(screen.gram):
        if index in without:
            continue
        first, last = int(screen.start[index]), int(screen.start[index + 1])
        diagonal, raw, target = np.diag(gram), screen.raw[first:last], screen.target[first:last]
        for column in range(last - first):
            if diagonal[column] > SWALLOWED * raw[column]:
                gain = target[column] ** 2 / diagonal[column]
                result.append((0.5 * float(gain), Variant(index, (column,))))
        if last - first > 1:
            gain, used = group_gain(gram, target, raw)
            if used > 1:
                score = 0.5 * gain - COEFFICIENT_COST * (used - 1)
                result.append((score, Variant(index, tuple(range(last - first)))))
    return sorted(result, key=lambda item: -item[0])


def group_gain(gram: FloatArray, target: FloatArray, raw: FloatArray) -> tuple[float, int]:
    """Drop of the whitened squares by a group of columns, and how many of its directions the motion determines."""
    values, vectors = _directions(gram, raw)
    projected = vectors.T @ (target / np.sqrt(np.maximum(raw, 1e-300)))
    return float(np.sum(projected**2 / values)), int(values.size)


def coefficients_of(gram: FloatArray, target: FloatArray, raw: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Coefficients (m,) and inverse Gram matrix (m, m), undetermined directions at zero."""
    values, vectors = _directions(gram, raw)
    scale = np.sqrt(np.maximum(raw, 1e-300))
    inverse = (vectors / values) @ vectors.T / np.outer(scale, scale)
    return np.asarray(inverse @ target, dtype=np.float64), np.asarray(inverse, dtype=np.float64)


def _directions(gram: FloatArray, raw: FloatArray) -> tuple[FloatArray, FloatArray]:
    scale = np.sqrt(np.maximum(raw, 1e-300))
    values, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
    kept = (values > SWALLOWED) & (values > UNDETERMINED**2 * values[-1])
    return values[kept], vectors[:, kept]
