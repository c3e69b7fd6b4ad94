"""Which joints' torques were recorded with the wrong sign: the likelihood of every pattern of signs.

The joints share inertial parameters, so that one cannot be turned unnoticed, and friction that feeds energy or inertia
below zero belongs to no arm. Every pattern is fitted, in all recordings with common base parameters, the noise of each
joint as it comes out; with and without free functions of each joint's state, so that strong physics is no rival which
only a turned sign could describe. Called by the search for data faults.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt

from identification.fitting.torque_sign import broken_squares

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

TURN = 8.0
"""Log-odds against a turned torque: 3000 to 1. All of a recording turned (the vendor's sign) is one turn."""
CLEAR = 3.0
"""Log-odds within which a pattern with fewer turns is as good: 20 to 1."""
PER_COLUMN = 0.5
"""Log-likelihood that a free function gains on noise."""
ROUNDS = 4
MOST_TURNED = 3
"""Joints turned against all others: every pattern of an arm with seven."""
RIDGE = 1e-10
ABSENT = 1e-9
"""Share of the longest column below which the motion does not ask for a base parameter."""
SMALLEST_RESIDUAL = 1e-12
"""Share of a torque's squares below which a residual is rounding."""


@dataclass(frozen=True, slots=True, eq=False)
class SignRows:
    """One recording as products over its samples, per joint; first as it is, then beside free functions of the joint.

    gram: (2, n, p, p), seen: (2, n, p) columns of the base parameters with themselves and the torque. squares: (2, n)
    of the torque. columns: (2, n) number of free functions. numbers: independent numbers a joint has; products are
    scaled to them. positive: (2 n, p), what is positive on every arm (`torque_sign.positive_quantities`).
    """

    gram: FloatArray
    seen: FloatArray
    squares: FloatArray
    columns: FloatArray
    numbers: float
    positive: FloatArray


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
    """Of the patterns that come within CLEAR of the likeliest the one with the fewest turns."""
    score = likelihood - TURN * turns
    near = np.flatnonzero(score >= score.max() - CLEAR)
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
    """(P,) of patterns (P, R n), the better of that with and of that without free functions, less what physics forbids.

    Free functions may feed energy like no friction does, so what must be positive is asked of the fit without them.
    """
    plain, normal, values, scale = _of_kind(recordings, signs, 0)
    found = np.maximum(plain, _of_kind(recordings, signs, 1)[0])
    positive = np.mean([item.positive for item in recordings], axis=0) / scale
    covariance = positive @ np.linalg.solve(normal, positive.T)
    broken = [broken_squares(*pair) for pair in zip(values @ positive.T, covariance, strict=True)]
    return np.asarray(found - 0.5 * np.array(broken), dtype=np.float64)


def _of_kind(
    recordings: Sequence[SignRows], signs: FloatArray, kind: int
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Profile likelihood (P,) over base parameters and noise; normal equations (P, p, p) of the parameters (P, p) times
    a scale (p,).
    """
    gram, seen, squares = (
        np.concatenate([getattr(item, name)[kind] for item in recordings]) for name in ("gram", "seen", "squares")
    )
    numbers = np.repeat([item.numbers for item in recordings], recordings[0].squares.shape[1])
    floor = np.maximum(SMALLEST_RESIDUAL * np.concatenate([item.squares[0] for item in recordings]), 1e-300)
    residual = np.tile(np.maximum(squares, floor), (len(signs), 1))
    scale = np.sqrt(np.einsum("cpp,c->p", gram, numbers / residual[0]))
    scale[scale < ABSENT * scale.max()] = np.inf
    gram, seen = gram / np.outer(scale, scale), seen / scale
    size = scale.size
    for _ in range(ROUNDS):
        weight = numbers / residual
        normal = (weight @ gram.reshape(len(gram), -1)).reshape(-1, size, size)
        normal += RIDGE * np.einsum("xpp->x", normal)[:, None, None] / size * np.eye(size)
        values = np.linalg.solve(normal, ((weight * signs) @ seen)[..., None])[..., 0]
        bent = (values[:, None, :] * (values @ gram.reshape(-1, size).T).reshape(len(signs), len(gram), size)).sum(-1)
        residual = np.maximum(squares - 2.0 * signs * (values @ seen.T) + bent, floor)
    columns = sum(float(item.columns[kind].sum()) for item in recordings)
    found = -0.5 * (numbers * np.log(residual)).sum(axis=1) - PER_COLUMN * columns
    return found, normal, values, scale
