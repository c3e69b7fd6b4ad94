"""The smoothed torque of a thinned stretch against scipy's Savitzky-Golay filter."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import savgol_filter

from identification.mismatch.data_faults.thinned import smoothed


@pytest.mark.parametrize("width", [5, 21, 101])
def test_value_and_rate_are_those_of_a_savitzky_golay_filter_also_at_the_ends(width: int) -> None:
    values = np.random.default_rng(width).normal(size=(300, 3)).cumsum(axis=0)
    rows = np.unique(np.linspace(0, 299, 60).astype(np.int64))
    for found, order in zip(smoothed(values, width, 0.004, rows), (0, 1), strict=True):
        expected = savgol_filter(values, width, 3, deriv=order, delta=0.004, axis=0)[rows]
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)
