"""What every candidate would gain beside what is fitted already, for all candidates at once.

One product of matrices per look: each candidate's columns off the basis are never formed, only their Gram matrices.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.arrays import FloatArray, IntArray
from identification.mismatch.problem import Problem, off
from identification.mismatch.search.library import EffectRows
from identification.mismatch.settings import ALTERNATIVE, ROUNDING

# Of a group's directions those whose length off the basis is below this share of its longest are not determined.
UNDETERMINED = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Batch:
    """Candidates with the same number m of columns. members: (G,) their places in the table. columns: (G, m).

    gram: (G, m, m) of their columns off the problem's basis.
    """

    members: IntArray
    columns: IntArray
    gram: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """Columns that touch the same joints. index: (C,) their places among all. columns: (C, len(joints) R) whitened."""

    joints: tuple[int, ...]
    index: IntArray
    columns: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Screen:
    """All candidates whitened for one problem. raw: (M,) square lengths of all columns before projection.

    target: (M,) products with the problem's residual.
    """

    problem: Problem
    candidates: Sequence[EffectRows]
    parts: tuple[Part, ...]
    batches: tuple[Batch, ...]
    raw: FloatArray
    target: FloatArray


def build_screen(problem: Problem, candidates: Sequence[EffectRows]) -> Screen:
    """Whiten every candidate, take it off the basis, keep its Gram matrix and its product with the residual."""
    sizes = np.array([item.coefficients for item in candidates], dtype=np.int64)
    start = np.cumsum(sizes) - sizes
    batches = []
    grams = {size: np.zeros((int((sizes == size).sum()), size, size)) for size in np.unique(sizes).tolist()}
    members = {size: np.flatnonzero(sizes == size).astype(np.int64) for size in grams}
    on_joints: dict[tuple[int, ...], list[int]] = {}
    for number, item in enumerate(candidates):
        on_joints.setdefault(item.joints, []).append(number)
    parts = []
    for joints, chosen in on_joints.items():
        rows = np.concatenate([candidates[number].rows.transpose(2, 0, 1) for number in chosen])
        columns = problem.whitened(rows.transpose(1, 2, 0), joints).transpose(2, 0, 1).reshape(rows.shape[0], -1)
        index = np.concatenate([start[number] + np.arange(sizes[number]) for number in chosen])
        parts.append(Part(joints, index, columns))
        first = 0
        for number in chosen:
            own = columns[first : first + sizes[number]]
            first += sizes[number]
            grams[int(sizes[number])][np.searchsorted(members[int(sizes[number])], number)] = own @ own.T
    raw = np.zeros(int(sizes.sum()))
    for size, gram in grams.items():
        batches.append(Batch(members[size], start[members[size]][:, None] + np.arange(size), gram))
        raw[batches[-1].columns] = np.einsum("gii->gi", gram)
    screen = Screen(problem, candidates, tuple(parts), tuple(batches), raw, np.zeros(raw.size))
    shadow = _products(screen, np.column_stack([problem.basis, problem.residual]))
    return _without(screen, shadow[:, :-1], problem, shadow[:, -1])


def narrowed(screen: Screen, problem: Problem) -> Screen:
    """The screen beside further directions: problem extends the one that the screen was made for."""
    added = problem.basis[:, screen.problem.basis.shape[1] :]
    shadow = _products(screen, added)
    return _without(screen, shadow, problem, screen.target - shadow @ (added.T @ screen.problem.residual))


def without_noise(screen: Screen, columns: FloatArray) -> Screen:
    """The screen where the noise lacks a part, columns (n R, k) whitened whose product with their own transpose is it.

    By the identity of Woodbury: no row is whitened anew.
    """
    basis, residual = screen.problem.basis, screen.problem.residual
    visible = off(basis, columns)
    parts = []
    for along in (columns, visible):
        share, directions = np.linalg.eigh(along.T @ along)
        parts.append(along @ directions / np.sqrt(np.maximum(1.0 - share, np.finfo(np.float64).eps)))
    plain, back = np.split(_products(screen, np.concatenate(parts, axis=1)), 2, axis=1)
    raw, target = screen.raw + (plain**2).sum(axis=1), screen.target + back @ (parts[1].T @ residual)
    return replace(_without(screen, back, screen.problem, target, sign=1.0), raw=raw)


def _products(screen: Screen, values: FloatArray) -> FloatArray:
    """Products (M, k) of all columns with whitened values (n R, k)."""
    result = np.empty((screen.raw.size, values.shape[1]))
    by_joint = values.reshape(screen.problem.n, screen.problem.rows, -1)
    for part in screen.parts:
        result[part.index] = part.columns @ by_joint[list(part.joints)].reshape(-1, values.shape[1])
    return result


def _without(screen: Screen, shadow: FloatArray, problem: Problem, target: FloatArray, sign: float = -1.0) -> Screen:
    """The screen off directions that columns have the products (M, k) with; sign: 1 where these are put in."""
    batches = []
    for batch in screen.batches:
        own = shadow[batch.columns]
        batches.append(Batch(batch.members, batch.columns, batch.gram + sign * own @ own.transpose(0, 2, 1)))
    return Screen(problem, screen.candidates, screen.parts, tuple(batches), screen.raw, target)


def gains(screen: Screen) -> list[tuple[float, EffectRows]]:
    """(score, candidate) of every candidate that gains anything, best first.

    score: half the drop of the whitened squares, less the cost of further coefficients and of the shape's grid.
    """
    result: list[tuple[float, EffectRows]] = []
    for batch in screen.batches:
        candidates = [screen.candidates[member] for member in batch.members.tolist()]
        scale, target = np.sqrt(np.maximum(screen.raw[batch.columns], 1e-300)), screen.target[batch.columns]
        values, vectors = np.linalg.eigh(batch.gram / (scale[:, :, None] * scale[:, None, :]))
        kept = (values > ROUNDING) & (values > UNDETERMINED**2 * values[:, -1:])
        projected = np.einsum("gij,gi->gj", vectors, target / scale)
        gain = np.sum(np.where(kept, projected**2 / np.where(kept, values, 1.0), 0.0), axis=1)
        if batch.columns.shape[1] == 1:
            one_sided = np.array([item.effect.one_sided for item in candidates])
            gain = np.where((target[:, 0] > 0.0) | ~one_sided, gain, 0.0)
        cost = np.array([item.cost for item in candidates])
        score = 0.5 * gain - ALTERNATIVE * np.maximum(kept.sum(axis=1) - 1, 0) - cost
        result.extend(pair for pair in zip(score.tolist(), candidates, strict=True) if pair[0] > 0.0)
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
    kept = (values > ROUNDING) & (values > UNDETERMINED**2 * values[-1])
    return values[kept], vectors[:, kept]
