"""The guard: what it accepts, what it refuses, and that it forgets what it refused."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from safety.errors import TrajectoryShapeError
from safety.guard import CommandGuard
from safety.limits import IIWA14_R820
from tests.safety.motions import judged

PERIOD = 0.001
LIMITS = IIWA14_R820


def _guard(position: np.ndarray | None = None) -> CommandGuard:
    guard = CommandGuard(LIMITS, PERIOD, maximum_distance_to_measured=0.1)
    guard.anchor(np.zeros(7) if position is None else position)
    return guard


def _moved(joint: int, by: float, start: np.ndarray | None = None) -> np.ndarray:
    command = np.zeros(7) if start is None else start.copy()
    command[joint - 1] += by
    return command


def test_a_guard_that_was_never_anchored_refuses_everything() -> None:
    guard = CommandGuard(LIMITS, PERIOD)
    verdict = judged(guard, [0.0] * 7, [0.0] * 7)
    assert verdict is not None
    assert verdict.criterion == "anchor"
    assert "has not been told" in verdict.sentence()


def test_a_released_guard_refuses_again() -> None:
    guard = _guard()
    assert judged(guard, np.zeros(7), np.zeros(7)) is None
    guard.release()
    verdict = judged(guard, np.zeros(7), np.zeros(7))
    assert verdict is not None
    assert verdict.criterion == "anchor"


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_command_that_is_not_finite_is_refused_and_the_joint_named(bad: float) -> None:
    command = np.zeros(7)
    command[4] = bad
    verdict = judged(_guard(), command, np.zeros(7))
    assert verdict is not None
    assert (verdict.criterion, verdict.joint) == ("finite", 5)


def test_a_measured_position_that_is_not_finite_is_refused() -> None:
    verdict = judged(_guard(), np.zeros(7), [0.0, math.nan, 0, 0, 0, 0, 0])
    assert verdict is not None
    assert (verdict.criterion, verdict.joint) == ("distance_to_measured", 2)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_command_past_a_position_limit_is_refused_with_both_numbers(side: float) -> None:
    position = np.zeros(7)
    position[3] = side * 2.0943
    command = position.copy()
    command[3] = side * 2.13
    verdict = judged(_guard(position), command, command)
    assert verdict is not None
    assert (verdict.criterion, verdict.joint, verdict.value) == ("position", 4, command[3])
    assert verdict.limit == pytest.approx(side * math.radians(120))
    assert "2.13000 rad" in verdict.sentence()


def test_a_step_larger_than_the_velocity_limit_is_refused() -> None:
    verdict = judged(_guard(), _moved(1, 1.4835 * PERIOD * 1.01), np.zeros(7))
    assert verdict is not None
    assert (verdict.criterion, verdict.joint, verdict.unit) == ("velocity", 1, "rad/s")


def test_a_jump_within_the_velocity_limit_is_refused_for_its_acceleration() -> None:
    verdict = judged(_guard(), _moved(1, 1.4 * PERIOD), np.zeros(7))
    assert verdict is not None
    assert (verdict.criterion, verdict.joint) == ("acceleration", 1)
    assert verdict.value == pytest.approx(1.4 / PERIOD)


def test_the_distance_to_the_measured_position_is_limited() -> None:
    guard = _guard()
    assert judged(guard, np.zeros(7), _moved(7, 0.099)) is None
    verdict = judged(guard, np.zeros(7), _moved(7, 0.101))
    assert verdict is not None
    assert (verdict.criterion, verdict.joint, verdict.limit) == ("distance_to_measured", 7, 0.1)


def test_measurement_noise_never_trips_the_guard() -> None:
    guard = _guard()
    generator = np.random.default_rng(20)
    for _ in range(2000):  # noise of 10 mrad is 28 rad/s when differenced at 1 ms
        assert judged(guard, np.zeros(7), generator.uniform(-0.01, 0.01, 7)) is None


def test_a_refused_command_leaves_no_trace() -> None:
    guard = _guard()
    assert judged(guard, _moved(2, 2e-6), np.zeros(7)) is None
    before = (guard.position, guard.velocity, guard.acceleration)
    assert judged(guard, _moved(2, 0.5), np.zeros(7)) is not None
    for old, new in zip(before, (guard.position, guard.velocity, guard.acceleration), strict=True):
        assert np.array_equal(old, new)


def test_a_wrong_number_of_joints_is_refused() -> None:
    verdict = judged(_guard(), [0.0] * 6, [0.0] * 7)
    assert verdict is not None
    assert verdict.criterion == "shape"
    with pytest.raises(TrajectoryShapeError, match="6 numbers"):
        _guard().anchor([0.0] * 6)
    with pytest.raises(TrajectoryShapeError, match="joint 3"):
        _guard().anchor([0.0, 0.0, math.nan, 0.0, 0.0, 0.0, 0.0])


def test_a_motion_exactly_at_the_limits_of_velocity_acceleration_and_jerk_passes() -> None:
    """Joint 4 goes to its velocity limit with full jerk and full acceleration, stays there, and stops the same way."""
    velocity, acceleration, jerk = math.radians(75), 11.36, 113.6
    rise = acceleration / jerk
    hold = velocity / acceleration - rise
    cruise = 0.5
    phases = [(rise, jerk), (hold, 0.0), (rise, -jerk), (cruise, 0.0), (rise, -jerk), (hold, 0.0), (rise, jerk)]
    guard = _guard(_moved(4, -0.5))
    for k in range(1, 1000):
        t, q, v, a = k * PERIOD, -0.5, 0.0, 0.0
        for duration, j in phases:  # the motion integrated exactly, phase by phase
            s = min(t, duration)
            q, v, a, t = q + s * (v + s * (a / 2 + s * j / 6)), v + s * (a + s * j / 2), a + s * j, t - s
        command = _moved(4, q)
        verdict = judged(guard, command, command)
        assert verdict is None, verdict.sentence() if verdict else ""
    assert v == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("frequency", [0.1, 0.3, 0.9])
def test_a_sine_with_its_peak_velocity_exactly_at_the_limit_passes(frequency: float) -> None:
    omega = 2 * math.pi * frequency
    amplitude = 1.3089969389957472 / omega  # joint 4
    scale = min(1.0, 1.0 / amplitude)
    guard = _guard(_moved(4, -amplitude * scale))
    for k in range(1, 3000):
        t = k * PERIOD
        # The amplitude grows smoothly from rest to full over the first second.
        growth = min(1.0, t) ** 3 * (10 - 15 * min(1.0, t) + 6 * min(1.0, t) ** 2)
        command = _moved(4, scale * amplitude * (-1.0 + growth * (1.0 - math.cos(omega * max(0.0, t - 1.0)))))
        verdict = judged(guard, command, command)
        assert verdict is None, verdict.sentence() if verdict else ""


def test_a_command_from_which_no_stop_fits_is_refused_before_the_limit_is_reached() -> None:
    # Joint 1 drives at 1.4 rad/s towards its limit and does not brake: refused while it still can stop.
    guard = _guard()
    speed, position = 0.0, np.zeros(7)
    for _ in range(4000):
        speed = min(1.4, speed + 2.0 * PERIOD)
        position = _moved(1, speed * PERIOD, position)
        verdict = judged(guard, position, position)
        if verdict is not None:
            break
    assert verdict is not None
    assert (verdict.criterion, verdict.joint) == ("stopping_position", 1)
    limit = math.radians(170)
    # Braking from 1.4 rad/s at 8.57 rad/s² and 85.7 rad/s³ takes v²/2A + vA/2J = 0.1844 rad (textbook trapezoid).
    assert guard.position[0] == pytest.approx(limit - (1.4**2 / (2 * 8.57) + 1.4 * 0.1 / 2), abs=2.5e-3)


def test_the_stopping_state_is_the_parabola_with_one_period_of_braking_at_full_jerk() -> None:
    guard = _guard()
    for k in range(1, 50):
        t = k * PERIOD
        assert judged(guard, _moved(6, 0.5 * 3.0 * t * t), np.zeros(7)) is None
    jerk = 157.2  # of joint 6
    assert guard.acceleration[5] == pytest.approx(3.0 - jerk * PERIOD, rel=1e-6)
    assert guard.velocity[5] == pytest.approx(3.0 * 0.049 - jerk * PERIOD**2 / 3, rel=1e-6)


def test_the_stopping_state_of_an_arm_at_rest_is_rest() -> None:
    guard = _guard()
    assert judged(guard, np.zeros(7), np.zeros(7)) is None
    assert not guard.velocity.any()
    assert not guard.acceleration.any()


def test_lists_tuples_and_arrays_are_judged_alike() -> None:
    command = _moved(3, 3e-6)
    guards = [_guard(), _guard(), _guard()]
    for guard, form in zip(guards, (command, command.tolist(), tuple(command)), strict=True):
        assert judged(guard, form, form) is None
    assert np.array_equal(guards[0].position, guards[1].position)
    assert np.array_equal(guards[0].position, guards[2].position)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), size=st.floats(1e-7, 1e-2))
def test_whatever_is_accepted_lies_within_the_limits(seed: int, size: float) -> None:
    """Random walks: the accepted stream, differenced by NumPy, keeps to position, velocity and acceleration limits."""
    generator = np.random.default_rng(seed)
    guard = _guard()
    accepted = [np.zeros(7), np.zeros(7)]
    for _ in range(200):
        wish = 2 * accepted[-1] - accepted[-2] + generator.normal(0.0, size, 7) * generator.choice([0.01, 1.0], 7)
        if judged(guard, wish, wish) is None:
            accepted.append(wish)
    stream = np.array(accepted)
    assert np.all(np.abs(stream) <= LIMITS.position_upper + 1e-9)
    assert np.all(np.abs(np.diff(stream, axis=0)) <= LIMITS.velocity * PERIOD * (1 + 1e-5))
    assert np.all(np.abs(np.diff(stream, 2, axis=0)) <= LIMITS.acceleration * PERIOD**2 * 1.0011)
