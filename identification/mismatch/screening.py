"""What every candidate would gain beside what is fitted already, for all candidates at once.

One product of matrices per look: each candidate's columns off the basis are never formed, only their Gram matrices.
Called by the search.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from identification.mismatch.library import COEFFICIENT_COST, EffectRows
from identification.mismatch.problem import SWALLOWED, Problem

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

# Of a group's directions those whose length off the basis is below this share of its longest are not determined.
UNDETERMINED = 1e-3


@dataclass(frozen=True, slots=True)
class Variant:
    """A candidate as it is scored: its place in the table and which of its columns are used."""

    index: int
    selection: tuple[int, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Batch:
    """Candidates with the same number m of columns. members: (G,) their places in the table. columns: (G, m).

    gram: (G, m, m) of their columns off the problem's basis.
    """

    members: IntArray
    columns: IntArray
    gram: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Screen:
    """All candidates whitened for one problem. columns: (M, n R). raw: (M,) square lengths before projection.

    target: (M,) products with the problem's residual.
    """

    problem: Problem
    candidates: Sequence[EffectRows]
    columns: FloatArray
    batches: tuple[Batch, ...]
    raw: FloatArray
    target: FloatArray


def build_screen(problem: Problem, candidates: Sequence[EffectRows]) -> Screen:
    """Whiten every candidate, take it off the basis, keep its Gram matrix and its product with the residual."""
    sizes = np.array([item.coefficients for item in candidates])
    start = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    columns = np.zeros((int(start[-1]), problem.n, problem.rows))
    for item, first in zip(candidates, start.tolist(), strict=False):
        for position, joint in enumerate(item.joints):
            rows = item.rows[position].T * problem.weight[joint]
            columns[first : first + item.coefficients, joint] = rows
    flat = columns.reshape(columns.shape[0], -1)
    batches = []
    for size in np.unique(sizes).tolist():
        members = np.flatnonzero(sizes == size).astype(np.int64)
        index = start[members][:, None] + np.arange(size)
        gram = np.empty((members.size, size, size))
        for place, member in enumerate(members.tolist()):
            joints = list(candidates[member].joints)
            own = columns[index[place]][:, joints].reshape(size, -1)
            gram[place] = own @ own.T
        batches.append(Batch(members, index, gram))
    raw = np.zeros(flat.shape[0])
    for batch in batches:
        raw[batch.columns] = np.einsum("gii->gi", batch.gram)
    screen = Screen(problem, candidates, flat, tuple(batches), raw, np.zeros(flat.shape[0]))
    return narrowed(screen, problem.basis, problem)


def narrowed(screen: Screen, added: FloatArray, problem: Problem) -> Screen:
    """The screen after further orthonormal directions (n R, k) were fitted; problem: the one with them."""
    shadow = screen.columns @ added
    batches = []
    for batch in screen.batches:
        own = shadow[batch.columns]
        batches.append(Batch(batch.members, batch.columns, batch.gram - own @ own.transpose(0, 2, 1)))
    target = screen.columns @ problem.residual
    return Screen(problem, screen.candidates, screen.columns, tuple(batches), screen.raw, target)


def gains(screen: Screen) -> list[tuple[float, Variant]]:
    """(score, variant) of every candidate, as a whole and, where its columns are alike, column by column; best first.

    score: half the drop of the whitened squares, less the cost of further coefficients and of the shape's grid.
    """
    result: list[tuple[float, Variant]] = []
    for batch in screen.batches:
        size = batch.columns.shape[1]
        cost = np.array([screen.candidates[member].cost for member in batch.members.tolist()])
        raw, target = np.maximum(screen.raw[batch.columns], 1e-300), screen.target[batch.columns]
        diagonal = np.einsum("gii->gi", batch.gram)
        seen = diagonal > SWALLOWED * raw
        single = np.where(seen, 0.5 * target**2 / np.where(seen, diagonal, 1.0), -np.inf)
        alike = np.array([_alike(screen.candidates[member]) for member in batch.members.tolist()])
        for column in range(size):
            score = np.where(alike, single[:, column] - cost, -np.inf)
            result.extend(_listed(score, batch.members, (column,)))
        if size > 1:
            scale = np.sqrt(raw)
            values, vectors = np.linalg.eigh(batch.gram / (scale[:, :, None] * scale[:, None, :]))
            kept = (values > SWALLOWED) & (values > UNDETERMINED**2 * values[:, -1:])
            projected = np.einsum("gij,gi->gj", vectors, target / scale)
            gain = np.sum(np.where(kept, projected**2 / np.where(kept, values, 1.0), 0.0), axis=1)
            used = kept.sum(axis=1)
            whole = np.where(used > 1, 0.5 * gain - COEFFICIENT_COST * (used - 1), -np.inf)
            result.extend(_listed(whole - cost, batch.members, tuple(range(size))))
    return sorted(result, key=lambda item: -item[0])


def _alike(candidate: EffectRows) -> bool:
    """Whether the columns are of one unit, so that one alone is the effect in one direction (one bending moment)."""
    units = candidate.effect.units
    return candidate.coefficients == 1 or (len(units) == candidate.coefficients and len(set(units)) == 1)


def _listed(scores: FloatArray, members: IntArray, selection: tuple[int, ...]) -> list[tuple[float, Variant]]:
    return [
        (score, Variant(member, selection))
        for score, member in zip(scores.tolist(), members.tolist(), strict=True)
        if score > 0.0
    ]


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
