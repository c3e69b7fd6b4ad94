"""Which joints' torques were recorded with the wrong sign: the likelihood of every pattern of signs.

The joints share inertial parameters, so that one cannot be turned unnoticed, and friction that feeds energy or inertia
below zero belongs to no arm. Every pattern is fitted, in all recordings with common base parameters, the noise of each
joint as it comes out, beside free functions of each joint's state, so that strong physics is no rival which only a
turned sign could describe. These have a prior as wide as the joint asks for and cost what they could describe: without
it they describe a turned torque as well as any.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from identification.arrays import FloatArray
from identification.base_parameters import BaseRegressor
from identification.fitting.torque_sign import broken_squares, positive_quantities
from identification.mismatch.data_faults.thinned import (
    ROWS_PER_NUMBER,
    Thinned,
    by_joint_of,
    columns_of,
    thinned_stretch,
    torque_beside,
    transposed,
)
from identification.mismatch.settings import ALTERNATIVE, ROUNDING, SPEAK
from identification.recordings.recording import Recording

ROUNDS = 6
MOST_TURNED = 3
"""Joints turned against all others: every pattern of an arm with seven."""
RIDGE = 1e-10
SMALLEST_RESIDUAL = 1e-12
"""Share of a torque's squares below which a residual is rounding."""


@dataclass(frozen=True, slots=True, eq=False)
class SignRows:
    """One recording as products over its samples, per joint; first as it is, then beside free functions of the joint.

    gram: (2, n, p, p), seen: (2, n, p) columns of the base parameters with themselves and the torque. squares: (2, n)
    of the torque. columns: (n,) number of free functions. numbers: independent numbers a joint has; products are
    scaled to them. positive: (2 n, p), what is positive on every arm (`torque_sign.positive_quantities`).
    """

    gram: FloatArray
    seen: FloatArray
    squares: FloatArray
    columns: FloatArray
    numbers: float
    positive: FloatArray


def signs_of(recordings: Sequence[Recording], regressor: BaseRegressor) -> FloatArray:
    """(R, n) −1 where the torque of a joint has the wrong sign. regressor: of the nominal model of these recordings."""
    return signs_of_stretches([thinned_stretch(recording) for recording in recordings], regressor)


def signs_of_stretches(thinned: Sequence[Thinned | None], regressor: BaseRegressor) -> FloatArray:
    """The same of recordings that were thinned; ones for None."""
    known = [place for place, stretch in enumerate(thinned) if stretch is not None]
    rows = [_rows_of(stretch, regressor) for stretch in thinned if stretch is not None]
    signs = np.ones((len(thinned), regressor.robot.n))
    if rows:
        signs[known] = likeliest_signs(rows)
    return signs


def likeliest_signs(recordings: Sequence[SignRows]) -> FloatArray:
    """(R, n) the sign of each joint's torque in each recording, -1 where it is turned.

    First one pattern for all recordings, a set-up's; then each recording's own beside the others. Base parameters are
    common, or each recording's own where that is worth their number: a load that one of them carries is no turned sign.
    """
    joints, size = recordings[0].squares.shape[1], recordings[0].gram.shape[-1]
    patterns = _patterns(joints)
    alone = np.array([_log_likelihood([item], patterns) for item in recordings])
    price = 0.5 * size * sum(float(np.log(joints * item.numbers)) for item in recordings[1:])
    together = _log_likelihood(recordings, np.tile(patterns, (1, len(recordings)))) if len(recordings) > 1 else alone[0]
    common = _simplest(np.maximum(together, alone.sum(axis=0) - price), _turns(patterns))
    chosen = np.full(len(recordings), common)
    for place in range(len(recordings) if len(recordings) > 1 else 0):
        tried = np.tile(patterns[chosen], (len(patterns), 1, 1))
        tried[:, place] = patterns
        others = np.delete(alone[np.arange(len(chosen)), chosen], place).sum()
        together = _log_likelihood(recordings, tried.reshape(len(patterns), -1))
        turns = _turns(patterns * patterns[common])
        chosen[place] = _simplest(np.maximum(together, alone[place] + others - price), turns)
    return np.asarray(patterns[chosen], dtype=np.float64)


def _simplest(likelihood: FloatArray, turns: FloatArray) -> int:
    """Of the patterns that are as good as the likeliest the one with the fewest turns, each of which costs SPEAK."""
    score = likelihood - SPEAK * turns
    near = np.flatnonzero(score >= score.max() - ALTERNATIVE)
    return int(min(near, key=lambda place: (turns[place], -score[place])))


def _patterns(joints: int) -> FloatArray:
    """(P, n) of ±1, MOST_TURNED or fewer joints unlike the others."""
    chosen = (turned for count in range(MOST_TURNED + 1) for turned in combinations(range(joints), count))
    few = np.array([[-1.0 if joint in turned else 1.0 for joint in range(joints)] for turned in chosen])
    return np.unique(np.concatenate([few, -few]), axis=0)


def _turns(patterns: FloatArray) -> FloatArray:
    """How many turns a pattern (P, n) takes: joints one by one, or all at once and the others back."""
    turned = (patterns < 0.0).sum(axis=1)
    return np.asarray(np.minimum(turned, 1 + patterns.shape[1] - turned), dtype=np.float64)


def _log_likelihood(recordings: Sequence[SignRows], signs: FloatArray) -> FloatArray:
    """(P,) of patterns (P, R n), less what physics forbids.

    Free functions may feed energy like no friction does, so what must be positive is asked of the fit without them.
    """
    # With all torques turned the parameters turn round, and nothing else changes: one fit for each pair of patterns.
    first = signs[:, :1]
    pairs, place = np.unique(signs * first, axis=0, return_inverse=True)
    found, normal, values, scale = _profile(recordings, pairs)
    found, normal, values = found[place], normal[place], values[place] * first
    positive = np.mean([item.positive for item in recordings], axis=0) / scale
    covariance = positive @ np.linalg.solve(normal, positive.T)
    broken = [broken_squares(*pair) for pair in zip(values @ positive.T, covariance, strict=True)]
    return np.asarray(found - 0.5 * np.array(broken), dtype=np.float64)


def _profile(
    recordings: Sequence[SignRows], signs: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Profile likelihood (P,) over base parameters, noise and the weight of free functions; and of the fit without
    these the normal equations (P, p, p) of the parameters (P, p) times a scale (p,).

    Beside m free functions of each joint, of which any coefficient has the variance v of a common prior that is
    maximised as well. With the share w = 1 / (1 + v) of what they could describe, a joint's squares are
    w · plain + (1 − w) · beside, and its likelihood has m / 2 · log w besides (the determinant of noise and prior).
    The search begins without them, w = 1: from where they carry the whole torque, gravity too, it may never come back.
    """
    gram, seen, squares = (
        np.concatenate([getattr(item, name) for item in recordings], axis=1) for name in ("gram", "seen", "squares")
    )
    columns = np.concatenate([item.columns for item in recordings])
    numbers = np.repeat([item.numbers for item in recordings], recordings[0].squares.shape[1])
    floor = np.maximum(SMALLEST_RESIDUAL * squares[0], 1e-300)
    scale = np.sqrt(np.einsum("cpp,c->p", gram[0], numbers / np.maximum(squares[0], floor)))
    scale[scale < ROUNDING * scale.max()] = np.inf
    gram, seen = gram / np.outer(scale, scale), seen / scale
    size = scale.size
    left = np.maximum(np.repeat(squares[:, None], len(signs), axis=1), floor)
    kept = np.ones_like(left[0])
    for step in range(2 * ROUNDS):
        weight = numbers / (kept * left[0] + (1.0 - kept) * left[1]) * np.stack([kept, 1.0 - kept])
        normal = np.tensordot(weight, gram, ((0, 2), (0, 1)))
        normal += RIDGE * np.einsum("xpp->x", normal)[:, None, None] / size * np.eye(size)
        seen_by = sum((weight[kind] * signs) @ seen[kind] for kind in range(2))
        values = np.linalg.solve(normal, seen_by[..., None])[..., 0]
        products = (values @ gram.reshape(-1, size).T).reshape(len(signs), 2, -1, size)
        bent = np.einsum("xkcp,xp->kxc", products, values)
        left = np.maximum(squares[:, None] - 2.0 * signs * np.einsum("xp,kcp->kxc", values, seen) + bent, floor)
        if step == ROUNDS - 1:
            without = normal, values
        if step >= ROUNDS - 1:
            kept = _kept(left, columns, numbers)
    residual = kept * left[0] + (1.0 - kept) * left[1]
    found = 0.5 * (columns * np.log(kept) - numbers * np.log(residual)).sum(axis=1)
    return found, *without, scale


def _kept(left: FloatArray, columns: FloatArray, numbers: FloatArray) -> FloatArray:
    """(P, C) the likeliest w of squares (2, P, C) plain and beside: m · beside / ((N − m) · (plain − beside))."""
    taken = np.maximum(numbers - columns, 0.0) * np.maximum(left[0] - left[1], 0.0)
    beside = columns * left[1]
    return np.asarray(np.divide(beside, taken, out=np.ones_like(taken), where=taken > beside))


def _rows_of(stretch: Thinned, regressor: BaseRegressor) -> SignRows:
    signals = stretch.signals
    columns = columns_of(signals, regressor, 1.0, 1.0)
    gram, seen, squares = [], [], []
    for rivals in ((), stretch.rivals):
        by_joint, torque = by_joint_of(columns, rivals), torque_beside(signals.torque, rivals)
        gram.append(transposed(by_joint) @ by_joint)
        seen.append((transposed(by_joint) @ torque.T[..., None])[..., 0])
        squares.append((torque**2).sum(axis=0))
    return SignRows(
        gram=np.stack(gram) / ROWS_PER_NUMBER,
        seen=np.stack(seen) / ROWS_PER_NUMBER,
        squares=np.stack(squares) / ROWS_PER_NUMBER,
        columns=np.array([basis.shape[1] for basis in stretch.rivals], dtype=np.float64),
        numbers=signals.time.size / ROWS_PER_NUMBER,
        positive=positive_quantities(regressor, signals.position, signals.velocity),
    )
