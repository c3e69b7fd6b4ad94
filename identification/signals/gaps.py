"""Samples that a recording lacks, on the wrapped period: what stands for them, and statistics that pass them over."""

from __future__ import annotations

import numpy as np

from identification.arrays import BoolArray, FloatArray


def wrapped_fill(values: FloatArray, missing: BoolArray) -> FloatArray:
    """Values (M, n) with the missing samples (M,) interpolated along the period; unchanged where all or none are."""
    if not missing.any() or missing.all():
        return values
    grid = np.arange(missing.size)
    known = grid[~missing]
    result = values.copy()
    for joint in range(values.shape[1]):
        result[missing, joint] = np.interp(grid[missing], known, values[known, joint], period=missing.size)
    return result


def median_over_periods(values: FloatArray) -> FloatArray:
    """Median (M, n) over periods (K, M, n) of what there is; nan for a sample that no period has."""
    known = np.isfinite(values)
    if known.all():  # many times as fast
        return np.asarray(np.median(values, axis=0))
    result = np.full(values.shape[1:], np.nan)
    seen = known.any(axis=0)
    result[seen] = np.nanmedian(values[:, seen], axis=0)
    return result
