"""Claims about how far quantities are from being positive. Truth: closed forms of two, and a bounded minimiser."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from identification.fitting.torque_sign import broken_squares


def test_two_that_are_negative_together_are_one_deviation_off_where_they_can_only_move_together() -> None:
    """Both at zero would be 100 σ² off and more: where the one is at zero, the other is above it."""
    covariance = np.array([[1.0, 0.9998], [0.9998, 1.0]])
    assert broken_squares(np.array([-1.1, -0.9]), covariance) == pytest.approx(1.1**2)


def test_two_whose_sum_is_known_to_be_negative_are_as_far_off_as_their_sum() -> None:
    covariance = np.array([[1.0, -0.9998], [-0.9998, 1.0]])
    assert broken_squares(np.array([-0.2, -0.2]), covariance) == pytest.approx(0.4**2 / (2.0 - 2.0 * 0.9998))


def test_what_is_positive_or_not_known_breaks_nothing() -> None:
    assert broken_squares(np.array([0.3, -5.0]), np.diag([1.0, 0.0])) == 0.0


@given(st.integers(0, 10_000), st.integers(1, 6))
@example(287, 4)
def test_the_distance_is_the_least_to_any_point_of_the_positive_ones(seed: int, size: int) -> None:
    generator = np.random.default_rng(seed)
    root = generator.normal(size=(size, size)) + 0.5 * np.eye(size)
    covariance, values = root @ root.T + 0.05 * np.eye(size), generator.normal(scale=2.0, size=size)
    whitened = np.linalg.inv(np.linalg.cholesky(covariance))
    least = lsq_linear(whitened, whitened @ values, bounds=(0.0, np.inf), method="bvls", tol=1e-14)
    assert broken_squares(values, covariance) == pytest.approx(2.0 * least.cost, rel=1e-4, abs=1e-6)
