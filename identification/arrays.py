"""The numpy arrays that the whole package speaks of, as types, and where a mask is set."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]
ComplexArray = npt.NDArray[np.complex128]
DEVIATION_FROM_MEDIAN = 1.4826
"""Standard deviation of Gaussian numbers over the median of their distances from the middle."""


def runs_of(marked: BoolArray) -> IntArray:
    """(k, 2) first and behind the last place of each run of marked places (N,)."""
    return np.flatnonzero(np.diff(np.concatenate([[False], marked, [False]]).astype(np.int8))).reshape(-1, 2)


def evenly(count: int, most: int) -> IntArray:
    """Places 0 … count − 1, at most so many of them, spread evenly; the first and the last are among them."""
    return np.linspace(0, count - 1, min(most, count)).astype(np.int64)


def longest_run(marked: BoolArray) -> int:
    """Length of the longest run of marked places (N,); 0 without any."""
    return int(np.ptp(runs_of(marked), axis=1).max(initial=0))
