"""Does this robot's torque need a rotor inertia and an offset per joint? Decided by rows that were not fitted.

Where torque is measured at the motor side it holds the rotor's inertia, and often an offset. The rule for "auto":
five folds; a parameter set is taken over the next smaller one when it lowers the held-out squares (geometric mean of
the joints) by more than 1 %, and those of at least half of the joints. Candidates: neither, offset, rotor inertia,
both; none with a parameter that the motion cannot tell apart from others (an offset from Coulomb friction where no
velocity reverses). Rotor inertias of which most come out negative are none (behind a gear's torque sensor they only
absorb what else the model lacks): such a candidate is not taken. With periods an offset is a matter of the
mean torque alone, one line of each joint, which says nothing on the others: there at least half of the joints must show
one that is clear of its own uncertainty. Fewer are effects of those joints, which the diagnosis names.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from identification.arrays import FloatArray, IntArray
from identification.base_parameters import BaseRegressor
from identification.fitting.blocks import Block, shortest_solution

CLEAR = 3.0
"""Deviations by which an offset, or a load's mass, stands clear of zero; four of seven offsets do by chance in 1 of 10⁹
fits."""
FOLDS = 5
REQUIRED_GAIN = 0.01
_RELATIVE_CUTOFF = 1e-9
_ROUNDING = 1e-12
"""Of the largest eigenvalue: one below it is zero."""


@dataclass(frozen=True, slots=True)
class DriveChoice:
    """rotor_inertia, offset: the decision. scores: held-out weighted squares of each candidate, neither = 1."""

    rotor_inertia: bool
    offset: bool
    scores: dict[str, float]


def choose_drive_parameters(
    blocks: list[Block], regressor: BaseRegressor, *, rotor_inertia: bool | None, offset: bool | None
) -> DriveChoice:
    """Decide by cross-validation; blocks must hold the columns of the largest model (regressor's).

    rotor_inertia, offset: True or False fixes that one, None leaves it open.
    """
    folds = fold_products(blocks)
    every = [
        (rotor, constant)
        for rotor, constant in ((False, False), (False, True), (True, False), (True, True))
        if rotor_inertia in (None, rotor) and offset in (None, constant)
    ]
    left_open = [_directions_left_open(folds, _columns(regressor, *candidate)) for candidate in every]
    candidates = [candidate for candidate, count in zip(every, left_open, strict=True) if count <= left_open[0]]
    squares = {candidate: held_out_squares(folds, _columns(regressor, *candidate)) for candidate in candidates}
    squares = {candidate: values[~np.isnan(values)] for candidate, values in squares.items()}
    scores = {candidate: float(np.exp(np.mean(np.log(values)))) for candidate, values in squares.items()}
    best = candidates[0]
    for candidate in candidates[1:]:
        if rotor_inertia is None and candidate[0] and not _rotors_are_positive(folds, regressor, candidate):
            continue
        most = 2 * int(np.count_nonzero(squares[candidate] < squares[best])) >= squares[best].size
        if most and scores[candidate] < (1.0 - REQUIRED_GAIN) * scores[best]:
            best = candidate
    names = {
        (False, False): "neither", (False, True): "offset", (True, False): "rotor_inertia", (True, True): "both",
    }  # fmt: skip
    reference = max(scores[candidates[0]], 1e-300)
    return DriveChoice(*best, {names[candidate]: scores[candidate] / reference for candidate in candidates})


def offsets_are_clear(values: FloatArray, std: FloatArray, regressor: BaseRegressor) -> bool:
    """Whether at least half of the joints have an offset clear of zero. values, std: (p,) of a fit with offsets."""
    own = [index for index, name in enumerate(regressor.names) if name.startswith("OFF_")]
    clear = np.abs(values[own]) > CLEAR * std[own]
    return 2 * int(np.count_nonzero(clear)) >= regressor.robot.n


def _rotors_are_positive(folds: list[FloatArray], regressor: BaseRegressor, candidate: tuple[bool, bool]) -> bool:
    """Whether at least half of the rotor inertias that have a column of their own come out positive."""
    columns = _columns(regressor, *candidate)
    total = np.sum(folds, axis=0)
    values = _solve(total, _joint_weights(total, columns), columns)
    names = [regressor.full_names[regressor.kept[column]] for column in columns]
    rotors = np.array([value for name, value in zip(names, values, strict=True) if name.startswith("IA_")])
    return rotors.size == 0 or float(np.mean(rotors > 0.0)) >= 0.5


def _columns(regressor: BaseRegressor, rotor_inertia: bool, offset: bool) -> IntArray:
    dropped = tuple(prefix for prefix, wanted in (("IA_", rotor_inertia), ("OFF_", offset)) if not wanted)
    full = [regressor.full_names[position] for position in regressor.kept]
    return np.array([index for index, name in enumerate(full) if not name.startswith(dropped)], dtype=np.int64)


def folds_of(blocks: Sequence[Block]) -> list[IntArray]:
    """Number of the fold of each row (R,) of each block; FOLDS for a row that is never held out.

    Folds are of recordings where there are several, as what drifts within one is alike in all of its parts; of one
    recording they are contiguous in time, interleaved in lines. The mean of a period is in none: no other line tells an
    offset.
    """
    total = sum(len(block.torque) for block in blocks)
    several = len({block.recording for block in blocks}) > 1
    passed, folds = 0, []
    for block in blocks:
        rows = np.arange(len(block.torque))
        if several:
            fold = np.full(len(rows), block.recording % FOLDS)
        elif block.signals.row_time is None:  # line 0, then cosine and sine of each line
            fold = np.where(rows == 0, FOLDS, (rows - 1) // 2 % FOLDS)
        else:
            fold = np.minimum((passed + rows) * 2 * FOLDS // total, 2 * FOLDS - 1) % FOLDS
        passed += len(block.torque)
        folds.append(fold)
    return folds


def fold_products(blocks: Sequence[Block]) -> list[FloatArray]:
    """[Y τ]ᵀ[Y τ] per fold (`folds_of`) and joint, (n, p + 1, p + 1) each; the last is of rows never held out."""
    size, joints = blocks[0].columns.shape[2], blocks[0].columns.shape[1]
    folds = [np.zeros((joints, size + 1, size + 1)) for _ in range(FOLDS + 1)]
    for block, fold in zip(blocks, folds_of(blocks), strict=True):
        for joint in range(joints):
            for number in range(FOLDS + 1):
                chosen = block.fitted[:, joint] & (fold == number)
                augmented = np.column_stack([block.columns[chosen, joint], block.torque[chosen, joint]])
                folds[number][joint] += augmented.T @ augmented
    return folds


def _solve(products: FloatArray, weights: FloatArray, columns: IntArray) -> FloatArray:
    gram = np.einsum("n,nij->ij", weights, products)
    return shortest_solution(gram[np.ix_(columns, columns)], gram[columns, -1], _RELATIVE_CUTOFF)


def _directions_left_open(folds: list[FloatArray], columns: IntArray) -> int:
    """Number of combinations of parameters that no row tells."""
    gram = np.sum(folds, axis=(0, 1))[np.ix_(columns, columns)]
    norms = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    values = np.linalg.eigvalsh(gram / np.outer(norms, norms))
    return int(np.count_nonzero(values <= _ROUNDING * values[-1]))


def _squares(products: FloatArray, columns: IntArray, values: FloatArray) -> FloatArray:
    direction = np.zeros(products.shape[1])
    direction[columns] = values
    direction[-1] = -1.0
    return np.asarray(np.maximum(np.einsum("i,nij,j->n", direction, products, direction), 0.0), dtype=np.float64)


def _joint_weights(products: FloatArray, columns: IntArray) -> FloatArray:
    """(n,) one over each joint's residual squares, after three rounds."""
    weights = np.ones(products.shape[0])
    for _ in range(3):
        squares = _squares(products, columns, _solve(products, weights, columns))
        weights = 1.0 / np.maximum(squares, 1e-12 * products[:, -1, -1] + 1e-300)
    return np.asarray(weights, dtype=np.float64)


def held_out_squares(folds: list[FloatArray], columns: IntArray) -> FloatArray:
    """(n,) sum of squares of the rows of each fold (`fold_products`) under the fit of the others; nan: no torque."""
    total = np.sum(folds, axis=0)
    weights = _joint_weights(total, columns)
    held_out = np.zeros(total.shape[0])
    for fold in folds[:FOLDS]:
        held_out += _squares(fold, columns, _solve(total - fold, weights, columns))
    present = total[:, -1, -1] > 0.0
    return np.where(present, np.maximum(held_out, 1e-300), np.nan)
