"""Residuals that are not white: each joint's as an autoregression, and rows turned into its innovations.

What a model leaves of a torque comes back with the motion: slow where friction wanders, fast where a gear ripples.
Divided by what the rows before foretell of it, it is white, and an effect counts by what it makes where the residual is
small. One standard deviation and a number of rows that count as one say that of an effect as slow as the residual only.
Pure.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identification.arrays import BoolArray, FloatArray, IntArray

HIGHEST_ORDER = 8


@dataclass(frozen=True, slots=True, eq=False)
class Colour:
    """taps: (n, p + 1, p + 1), of joint j and a row with m known rows before it, what each of the m + 1 counts in its
    innovation; innovations all have the deviation std: (n,) Nm.
    """

    taps: FloatArray
    std: FloatArray

    @classmethod
    def white(cls, std: FloatArray) -> Colour:
        """Of rows that are independent of each other."""
        return cls(np.ones((len(std), 1, 1)), std)

    def innovations(self, values: FloatArray, before: IntArray) -> FloatArray:
        """Of values (R, n) or (R, n, K) what the rows before do not foretell. before: (R, n), see `preceded`."""
        result = np.zeros_like(values)
        for joint in range(values.shape[1]):
            own, known = values[:, joint], np.minimum(before[:, joint], self.taps.shape[1] - 1)
            shape = (-1,) + (1,) * (own.ndim - 1)
            for lag in range(self.taps.shape[2]):
                result[lag:, joint] += self.taps[joint, known[lag:], lag].reshape(shape) * own[: len(own) - lag]
        return result


def preceded(used: BoolArray, starts: BoolArray) -> IntArray:
    """(R, n) how many rows without a break stand before each. used: (R, n); starts: (R,) where a stretch begins."""
    row = np.arange(len(used))[:, None]
    broken = np.vstack([np.ones((1, used.shape[1]), dtype=np.bool_), ~used[:-1]]) | starts[:, None]
    return np.asarray(row - np.maximum.accumulate(np.where(broken, row, 0), axis=0))


def colour_of(left: FloatArray, used: BoolArray, doubt: FloatArray | None = None) -> Colour:
    """Of residuals (R, n), by Levinson's recursion; its order by Schwarz's criterion, a joint at a time.

    doubt: (R, n, k), what each of k independent unit directions of the estimate's uncertainty makes. Parameters take
    up noise at the motion's own frequencies, where a short residual then has too little of it; what they took is, on
    average, what they are uncertain by (the E-step of Dempster, Laird and Rubin 1977).
    """
    n = left.shape[1]
    series_all = left[..., None] if doubt is None else np.concatenate([left[..., None], doubt], axis=2)
    taps, std = np.zeros((n, HIGHEST_ORDER + 1, HIGHEST_ORDER + 1)), np.zeros(n)
    for joint in range(n):
        series = np.where(used[:, joint, None], series_all[:, joint], 0.0)
        count = max(1, int(used[:, joint].sum()))
        moments = np.array([np.vdot(series[lag:], series[: len(series) - lag]) for lag in range(HIGHEST_ORDER + 1)])
        moments /= count
        variance, predictors = _levinson(moments)
        cost = count * np.log(np.maximum(variance, 1e-300)) + np.log(count) * np.arange(HIGHEST_ORDER + 1)
        order = int(np.argmin(cost))
        std[joint] = np.sqrt(variance[order])
        for known in range(HIGHEST_ORDER + 1):
            kept = min(known, order)
            scale = np.sqrt(variance[order] / max(variance[kept], 1e-300)) if variance[kept] > 0.0 else 1.0
            taps[joint, known, 0] = scale
            taps[joint, known, 1 : kept + 1] = -scale * predictors[kept]
    return Colour(taps, std)


def _levinson(moments: FloatArray) -> tuple[FloatArray, list[FloatArray]]:
    """Variance left (p + 1,) and the coefficients of the best predictor of each order, by autocovariances (p + 1,)."""
    variance, predictors = [float(moments[0])], [np.zeros(0)]
    for order in range(1, len(moments)):
        last = predictors[-1]
        if variance[-1] <= 0.0:
            variance.append(variance[-1])
            predictors.append(np.append(last, 0.0))
            continue
        reflection = (moments[order] - last @ moments[order - 1 : 0 : -1]) / variance[-1]
        predictors.append(np.append(last - reflection * last[::-1], reflection))
        variance.append(variance[-1] * (1.0 - reflection**2))
    return np.array(variance), predictors
