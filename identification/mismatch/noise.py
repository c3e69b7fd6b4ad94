"""The noise of a mean period, line by line, from what successive periods differ by.

Here: variances and the degrees of freedom behind them. Not here: misfit, which lives in the mean.
"""

from __future__ import annotations

import numpy as np
from scipy.special import chdtr, chdtri, fdtrc

from identification.arrays import FloatArray, IntArray

# Of the K − 1 differences this share, the largest, is left out: a contact or a step in a few periods is no noise.
TRIMMED_SHARE = 0.25
FEWEST_TO_TRIM = 5
# Lines of line 0's neighbours that say how large noise at rest may be at least.
NEIGHBOURS_OF_LINE_ZERO = 3
# Of a torque (RMS of its rows), what its noise is at least: single precision has 6e-8 of a number.
LEAST_SHARE = 1e-6
# Chance of line 0's own estimate over theirs below which it contradicts them, and stands alone.
CONTRADICTION = 0.05
# Trimming costs this share of the freedom where many numbers are averaged first, and where there is one.
FREEDOM_KEPT, FREEDOM_KEPT_OF_ONE = 0.8, 0.6


def noise_of_mean(period_rows: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Standard deviation of the noise in the mean over periods, and its real degrees of freedom, both (R, n).

    period_rows: (K ≥ 2, R, n) Nm, rows of each period: line 0, then cosine and sine of each line. The variance is half
    the mean square difference of successive periods (von Neumann: blind to slow drift), the largest quarter of the
    differences left out and the bias of that undone, smoothed over ± max(3, 10 %) lines; less where lines are so low
    that a coloured noise is steep. Line 0 has one number per difference. So it is never taken below its neighbours, and
    their freedom stands behind it unless its own estimate contradicts them. Its median difference is taken off, as a
    sensor that drifts steadily shifts all of them alike.
    """
    periods, rows, joints = period_rows.shape
    difference = np.diff(period_rows, axis=0)
    if periods - 1 >= FEWEST_TO_TRIM:
        difference[:, 0] -= np.median(difference[:, 0], axis=0)
    difference = difference**2 / 2.0
    lines = (rows - 1) // 2
    zero, power = difference[:, 0], (difference[:, 1::2] + difference[:, 2::2]) / 2.0
    low, high = _neighbours(lines)
    total = np.concatenate([np.zeros((periods - 1, 1, joints)), np.cumsum(power, axis=1)], axis=1)
    count = (high - low).astype(np.float64)
    smooth = (total[:, high] - total[:, low]) / count[None, :, None]
    # von Neumann's estimate has variance (3K − 4) σ⁴ / (K − 1)².
    trimmed = periods - 1 >= FEWEST_TO_TRIM
    of_one = per_number = 2.0 * (periods - 1) ** 2 / (3.0 * periods - 4.0)
    if trimmed:
        per_number, of_one = FREEDOM_KEPT * per_number, FREEDOM_KEPT_OF_ONE * of_one
    variance = np.empty((rows, joints))
    freedom = np.empty((rows, joints))
    line_variance = _trimmed_mean(smooth, 2.0 * count)
    variance[1::2] = variance[2::2] = line_variance
    freedom[1::2] = freedom[2::2] = 2.0 * count[:, None] * per_number
    near = min(NEIGHBOURS_OF_LINE_ZERO, lines)
    neighbours = _trimmed_mean(power[:, :near].mean(axis=1)[:, None], np.array([2.0 * near]))[0]
    own, behind = _trimmed_mean(zero[:, None], np.ones(1))[0], 2.0 * near * per_number
    variance[0] = np.maximum(own, neighbours)
    chance = fdtrc(of_one, behind, own / np.maximum(neighbours, 1e-300))
    freedom[0] = np.where(chance < CONTRADICTION, of_one, behind)
    # A torque that has no noise, of a simulator, is known to its rounding: what is weighed by less cannot be solved.
    size = np.sqrt((period_rows**2).sum(axis=(0, 1)) / (periods * rows))
    floor = np.maximum(1e-12 * np.maximum(variance.max(axis=0), 1e-24), (LEAST_SHARE * size) ** 2)
    return np.sqrt(np.maximum(variance, floor) / periods), freedom


def _neighbours(lines: int) -> tuple[IntArray, IntArray]:
    """First and one past the last of the lines (from 0 for line 1) that are averaged around each line."""
    number = np.arange(1, lines + 1)
    half = np.minimum(np.maximum(3, number // 10), number // 3)
    return np.maximum(0, number - 1 - half), np.minimum(lines, number + half)


def _trimmed_mean(values: FloatArray, freedom: FloatArray) -> FloatArray:
    """Mean over axis 0 of the smallest values, unbiased for χ² of that freedom. values: (D, L, n), freedom: (L,)."""
    count = values.shape[0]
    if count < FEWEST_TO_TRIM:
        return np.asarray(values.mean(axis=0), dtype=np.float64)
    kept = count - round(TRIMMED_SHARE * count)
    # Mean of χ²_ν below its p-quantile x is ν F_{ν+2}(x) / p; 0.4 is the correction for a finite number of values.
    share = (kept + 0.4) / count
    quantile = chdtri(freedom, 1.0 - share)
    bias = chdtr(freedom + 2.0, quantile) / share
    return np.asarray(np.sort(values, axis=0)[:kept].mean(axis=0) / bias[:, None], dtype=np.float64)
