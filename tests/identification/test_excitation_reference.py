"""Claims about the paper's reference trajectories; truth from section 4.6 (with D^k - D^(k-1)) and dense sampling."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from identification.errors import DesignError, TrajectoryError
from identification.excitation import (
    PolynomialTrajectory,
    SineSeriesTrajectory,
    default_trajectory,
    iiwa_limits,
    trajectory_from_json,
)
from identification.excitation.reference import REFERENCE_KINDS, reference_trajectory

LIMITS = iiwa_limits("iiwa14")
RANDOM_KINDS = [kind for kind in REFERENCE_KINDS if kind != "excitation"]


def test_the_first_reference_is_the_excitation() -> None:
    np.testing.assert_array_equal(
        reference_trajectory("excitation", LIMITS).table(100.0), default_trajectory().table(100.0)
    )


@settings(max_examples=12, deadline=None)
@given(st.sampled_from(RANDOM_KINDS), st.integers(0, 10_000))
def test_every_reference_stays_inside_every_limit_and_joins_itself_at_rest(kind: str, seed: int) -> None:
    trajectory = reference_trajectory(kind, LIMITS, seed)  # type: ignore[arg-type]
    table = trajectory.table(1000.0)
    velocity = np.diff(table, axis=0, append=table[:1]) * 1000.0
    # Differences over the seam too: a jump there would show as a velocity or acceleration beyond any limit.
    acceleration = np.diff(velocity, axis=0, append=velocity[:1]) * 1000.0
    assert np.all(table >= LIMITS.position_lower)
    assert np.all(table <= LIMITS.position_upper)
    assert np.all(np.abs(velocity) <= LIMITS.velocity)
    assert np.all(np.abs(acceleration) <= LIMITS.acceleration)
    q, dq, ddq = trajectory.evaluate([0.0])
    assert np.max(np.abs(q)) < 1e-12
    assert np.max(np.abs(dq)) < 1e-12
    assert np.max(np.abs(ddq)) < 1e-12


@settings(max_examples=12, deadline=None)
@given(st.sampled_from(RANDOM_KINDS), st.integers(0, 10_000))
def test_closed_form_derivatives_equal_differences_of_position(kind: str, seed: int) -> None:
    trajectory = reference_trajectory(kind, LIMITS, seed)  # type: ignore[arg-type]
    step = 1e-5
    time = np.random.default_rng(seed).uniform(0.0, trajectory.period_s - 2 * step, size=40) + step
    _, dq, ddq = trajectory.evaluate(time)
    before, after = trajectory.evaluate(time - step), trajectory.evaluate(time + step)
    np.testing.assert_allclose(dq, (after[0] - before[0]) / (2 * step), atol=1e-4)
    np.testing.assert_allclose(ddq, (after[1] - before[1]) / (2 * step), atol=2e-3)


def test_the_polynomial_moves_by_the_difference_of_waypoints() -> None:
    trajectory = PolynomialTrajectory(np.array([2.0, 4.0]), np.array([[0.5], [0.8], [0.5]]))
    # Half way the printed polynomial is 10/8 - 15/16 + 6/32 = 1/2 of its step.
    assert trajectory.evaluate(1.0)[0][0, 0] == pytest.approx(0.65)
    assert trajectory.evaluate(2.0)[0][0, 0] == pytest.approx(0.8)
    assert trajectory.evaluate(4.0)[0][0, 0] == pytest.approx(0.65)
    assert trajectory.evaluate(1.0)[1][0, 0] == pytest.approx(15.0 / 8.0 * 0.3 / 2.0)


@pytest.mark.parametrize(("kind", "intervals"), [("polynomial_10", 10), ("polynomial_20", 20)])
def test_polynomials_have_the_papers_intervals_and_duration(kind: str, intervals: int) -> None:
    trajectory = reference_trajectory(kind, LIMITS, 1)  # type: ignore[arg-type]
    assert isinstance(trajectory, PolynomialTrajectory)
    assert len(trajectory.duration_s) == intervals
    assert trajectory.period_s == pytest.approx(10.0)
    assert np.all(np.max(np.abs(np.diff(trajectory.waypoints, axis=0)), axis=0) > 0.1)


def test_the_sine_series_is_the_printed_one_until_its_way_back() -> None:
    trajectory = reference_trajectory("sine_series", LIMITS, 2)
    assert isinstance(trajectory, SineSeriesTrajectory)
    printed = np.sum(trajectory.amplitude * np.sin(trajectory.angular_frequency * 3.3), axis=1)
    np.testing.assert_allclose(trajectory.evaluate(3.3)[0][0], printed, atol=1e-13)
    assert trajectory.period_s == pytest.approx(12.0)


@pytest.mark.parametrize("kind", RANDOM_KINDS)
def test_a_seed_fixes_a_reference_and_its_file_brings_it_back(kind: str) -> None:
    first, second = (reference_trajectory(kind, LIMITS, 11) for _ in range(2))  # type: ignore[arg-type]
    other = reference_trajectory(kind, LIMITS, 12)  # type: ignore[arg-type]
    np.testing.assert_array_equal(first.table(100.0), second.table(100.0))
    assert np.max(np.abs(first.table(100.0) - other.table(100.0))) > 0.1
    loaded = trajectory_from_json(json.loads(json.dumps(first.to_json())))
    np.testing.assert_array_equal(loaded.table(100.0), first.table(100.0))
    np.testing.assert_allclose(first.scaled(0.5).table(100.0), 0.5 * first.table(100.0), atol=1e-12)


def test_a_judge_that_accepts_nothing_is_told_so() -> None:
    with pytest.raises(DesignError, match="polynomial_10"):
        reference_trajectory("polynomial_10", LIMITS, acceptable=lambda _: False)


def test_a_polynomial_that_does_not_close_is_refused() -> None:
    with pytest.raises(TrajectoryError, match="last waypoint"):
        PolynomialTrajectory(np.array([1.0]), np.array([[0.0], [0.1]]))
