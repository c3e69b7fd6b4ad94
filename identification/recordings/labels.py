"""Period labels for recordings that only state their period: which period and which sample of it a row belongs to."""

from __future__ import annotations

import numpy as np

from identification.arrays import FloatArray, IntArray

SMALLEST_COVERAGE = 0.5


def label_by_time(time: FloatArray, period_s: float, sampling_period_s: float) -> tuple[IntArray, IntArray, int]:
    """Period and sample number of each row, by rounding time onto the grid of M = round(period / sampling period).

    time: (N,) s; the first row is sample 0 of period 0. Returns (period_index, sample_in_period, M). Where two rows of
    one period fall on the same sample, the nearer one is kept and the other gets the label -1. Rows of a last period
    that is less than half covered get the label -1 too.
    """
    per_period = max(1, round(period_s / sampling_period_s))
    place = (time - time[0]) / period_s * per_period
    grid = np.rint(place).astype(np.int64)
    order = np.lexsort((np.abs(place - grid), grid))
    first_of_each = np.ones(time.size, dtype=np.bool_)
    first_of_each[order[1:]] = grid[order[1:]] != grid[order[:-1]]
    period_index = grid // per_period
    sample = grid % per_period
    period_index[~first_of_each] = -1
    last = int(period_index.max())
    if last > 0 and int((period_index == last).sum()) < SMALLEST_COVERAGE * per_period:
        period_index[period_index == last] = -1
    sample[period_index < 0] = -1
    return period_index, sample, per_period
