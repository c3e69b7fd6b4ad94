"""Claims about (14c)-(14g), corrected, and the true limits; truth from the printed inequalities and dense sampling."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from identification.errors import DesignError
from identification.excitation import ExcitationLimits, FourierTrajectory, iiwa_limits
from identification.excitation.constraints import (
    PaperConstraints,
    TrueConstraints,
    repaired,
    rest_null_space,
    verify,
)

FloatArray = npt.NDArray[np.float64]

LIMITS = iiwa_limits("iiwa14")


def _random(seed: int, harmonics: int = 5, size: float = 1.0) -> FloatArray:
    return size * np.random.default_rng(seed).normal(size=(7, 2 * harmonics))


def _trajectory(coefficients: FloatArray, offset: FloatArray | None = None) -> FourierTrajectory:
    a, b = np.split(coefficients, 2, axis=1)
    return FourierTrajectory(0.1, a, b, np.zeros(7) if offset is None else offset)


def test_limits_of_the_iiwa14_are_kukas() -> None:
    np.testing.assert_allclose(
        LIMITS.position_upper, [2.9671, 2.0944, 2.9671, 2.0944, 2.9671, 2.0944, 3.0543], atol=5e-5
    )
    np.testing.assert_allclose(LIMITS.velocity, [1.4835, 1.4835, 1.7453, 1.3090, 2.2689, 2.3562, 2.3562], atol=5e-5)


def test_the_corrected_equalities_mean_rest_at_the_start() -> None:
    basis = rest_null_space(5)
    q, dq, ddq = _trajectory(_random(0) @ basis @ basis.T).evaluate(0.0)
    for value in (q, dq, ddq):
        assert np.max(np.abs(value)) < 1e-13


def test_the_printed_equalities_do_not() -> None:
    order = np.arange(1, 6)
    zero = np.zeros(5)
    printed = np.stack(
        [np.concatenate([1.0 / order, zero]), np.concatenate([zero, np.ones(5)]), np.concatenate([order, zero])]
    )
    free = np.eye(10) - np.linalg.pinv(printed) @ printed
    q, dq, ddq = _trajectory(_random(0) @ free).evaluate(0.0)
    assert np.max(np.abs(q)) > 0.1
    assert np.max(np.abs(dq)) > 0.1
    assert np.max(np.abs(ddq)) > 0.1


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.01, 30.0))
def test_repaired_coefficients_satisfy_every_printed_inequality(seed: int, size: float) -> None:
    constraints = PaperConstraints(LIMITS, np.zeros(7), 0.1, 5)
    inside = repaired(_random(seed, size=size), constraints, rest_null_space(5))
    omega = 2.0 * math.pi * 0.1
    for joint in range(7):
        a, b = inside[joint, :5], inside[joint, 5:]
        q_max, dq_max = LIMITS.position_upper[joint], LIMITS.velocity[joint]
        assert sum(math.hypot(a[k], b[k]) / (k + 1) for k in range(5)) <= omega * q_max * (1 + 1e-12)
        assert sum(math.hypot(a[k], b[k]) for k in range(5)) <= dq_max * (1 + 1e-12)
        for k in range(5):
            bound = min((k + 1) * 2.0 * math.pi / (5 * 10.0) * q_max, dq_max)
            assert max(abs(a[k]), abs(b[k])) <= bound * (1 + 1e-12)
        assert abs(sum(b[k] / (k + 1) for k in range(5))) < 1e-12
        assert abs(sum(a)) < 1e-12
        assert abs(sum((k + 1) * b[k] for k in range(5))) < 1e-12


def test_coefficients_inside_are_left_alone() -> None:
    constraints = PaperConstraints(LIMITS, np.zeros(7), 0.1, 5)
    basis = rest_null_space(5)
    small = _random(3, size=0.01) @ basis @ basis.T
    np.testing.assert_allclose(repaired(small, constraints, basis), small, rtol=1e-9, atol=1e-15)


def test_slopes_of_the_sums_equal_finite_differences() -> None:
    constraints = PaperConstraints(LIMITS, np.zeros(7), 0.1, 5)
    point, direction = _random(4), _random(5)
    _, slopes = constraints.values(point)
    step = 1e-6
    ahead, behind = constraints.values(point + step * direction)[0], constraints.values(point - step * direction)[0]
    np.testing.assert_allclose(
        np.einsum("jkc,jc->jk", slopes, direction), (ahead - behind) / (2 * step), rtol=1e-6, atol=1e-7
    )


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([5, 10]))
def test_true_limits_hold_at_every_millisecond_after_repair(seed: int, harmonics: int) -> None:
    offset = np.array([0.0, 0.2, 0.0, -0.5, 0.0, 0.4, 0.0])
    constraints = TrueConstraints(LIMITS, offset, 0.1, harmonics, 10 * harmonics)
    inside = repaired(_random(seed, harmonics, size=5.0), constraints, rest_null_space(harmonics))
    q, dq, ddq = _trajectory(inside, offset).evaluate(np.arange(10_000) / 1000.0)
    assert np.all(np.max(np.abs(dq), axis=0) <= LIMITS.velocity)
    assert np.all(np.max(np.abs(ddq), axis=0) <= LIMITS.acceleration)
    assert np.all(q <= LIMITS.position_upper)
    assert np.all(q >= LIMITS.position_lower)


def test_verification_finds_a_joint_that_is_too_fast() -> None:
    basis = rest_null_space(5)
    constraints = PaperConstraints(LIMITS, np.zeros(7), 0.1, 5)
    inside = repaired(_random(8, size=10.0), constraints, basis)
    assert verify(_trajectory(inside), LIMITS)["within_paper_limits"]
    assert verify(_trajectory(inside), LIMITS)["within_limits"]
    inside[3] *= 3.0
    report = verify(_trajectory(inside), LIMITS)
    assert not report["within_paper_limits"]
    assert not report["within_limits"]
    assert int(np.argmax(report["velocity"])) == 3


def test_too_few_harmonics_to_start_at_rest_are_refused() -> None:
    with pytest.raises(DesignError, match="at least 3 harmonics"):
        rest_null_space(2)


@pytest.mark.parametrize("velocity", [0.0, -1.0, float("nan")])
def test_an_unusable_velocity_limit_names_its_joint(velocity: float) -> None:
    with pytest.raises(DesignError, match="joint 2"):
        ExcitationLimits(np.array([-1.0, -1.0]), np.array([1.0, 1.0]), np.array([1.0, velocity]), np.array([1.0, 1.0]))


def test_an_offset_outside_the_range_names_its_joint() -> None:
    with pytest.raises(DesignError, match="joint 2"):
        LIMITS.reach(np.array([0.0, 3.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
