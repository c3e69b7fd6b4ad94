"""The likeliest direction: found where there is one, and the search ends whatever the evidence looks like."""

from __future__ import annotations

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st

from identification.audit.directions import FIRST_REACH_RAD, Directions


class Asked:
    """An evidence that counts how often it is asked; far more often than any search needs is an error."""

    def __init__(self, slope: np.ndarray, bend: np.ndarray, ripple: float) -> None:
        self.slope, self.bend, self.ripple, self.times = slope, bend, ripple, 0

    def __call__(self, direction: np.ndarray) -> float:
        self.times += 1
        assert self.times < 3000, "the search does not end"
        smooth = self.slope @ direction + direction @ self.bend @ direction
        return float(smooth + self.ripple * np.sin(1e5 * direction.sum()))


numbers = st.floats(-1e6, 1e6)


@settings(max_examples=200, deadline=None)
@example(
    [-101702.0, 547532.0, 0.0], [0.0, -623591.0, 990286.0, -600935.0, -586766.0, 0.0, -511171.0, 992800.0, 0.0], 0.0
)
@given(st.lists(numbers, min_size=3, max_size=3), st.lists(numbers, min_size=9, max_size=9), st.floats(0.0, 10.0))
def test_the_search_ends_whatever_the_evidence_looks_like(slope: list[float], bend: list[float], ripple: float) -> None:
    asked = Asked(np.array(slope), np.array(bend).reshape(3, 3), ripple)
    best, found = Directions._refined(asked, np.array([0.0, 0.0, 1.0]))
    assert found >= asked(np.array([0.0, 0.0, 1.0]))
    assert abs(np.linalg.norm(best) - 1.0) < 1e-12


@settings(max_examples=50, deadline=None)
@given(st.floats(0.0, 2.0 * np.pi), st.floats(0.0, 2.0 * FIRST_REACH_RAD), st.floats(1e2, 1e7))
def test_the_top_of_a_hill_is_found(around: float, leant: float, steep: float) -> None:
    """Closed form: a · d is largest along a."""
    top = np.array([np.sin(leant) * np.cos(around), np.sin(leant) * np.sin(around), np.cos(leant)])
    best, _ = Directions._refined(Asked(steep * top, np.zeros((3, 3)), 0.0), np.array([0.0, 0.0, 1.0]))
    assert np.linalg.norm(best - top) < 1e-2 / np.sqrt(steep / 1e2)
