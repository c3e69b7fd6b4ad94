"""The covariance of a model with effects. Truth: correlations that are written down here."""

from __future__ import annotations

import numpy as np

from identification.mismatch.extended_model import _with_deviations


def test_deviations_are_those_stated_and_correlations_stay() -> None:
    lower = _with_deviations([[4.0], [3.0, 9.0]], [1.0, 6.0])
    assert np.allclose([*lower[0], *lower[1]], [1.0, 0.5 * 1.0 * 6.0, 36.0])


def test_a_parameter_without_a_deviation_keeps_what_the_fit_says() -> None:
    """A variance of zero, as of exact data, ended in a division by it."""
    assert _with_deviations([[4.0], [1.0, 0.0]], [1.0, 0.5]) == [[1.0], [0.5, 0.0]]
    assert _with_deviations([[4.0], [1.0, 9.0]], [1.0, None]) == [[1.0], [0.5, 9.0]]
