"""Ramps, looked at from outside: sampled densely, differenced, held against the limits. Ruckig's figures are not
used.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from safety.braking import stopping_travel
from safety.guard import CommandGuard
from safety.limits import IIWA7_R800, IIWA14_R820, JointLimits
from safety.ramps import Ramp, RampError, plan_start_ramp, plan_stop_ramp
from tests.safety.motions import judged

LIMITS = IIWA14_R820


def _sampled(ramp: Ramp, step: float = 5e-4) -> np.ndarray:
    times = np.arange(0.0, ramp.duration_s + 3 * step, step)
    return np.array([ramp.at(float(t))[0] for t in times])


def _assert_inside(path: np.ndarray, step: float, limits: JointLimits) -> None:
    assert np.all(path <= limits.position_upper + 2e-7)
    assert np.all(path >= limits.position_lower - 2e-7)
    velocity = np.diff(path, axis=0) / step
    assert np.all(np.abs(velocity) <= limits.velocity * (1 + 1e-5) + 1e-6)
    acceleration = np.diff(velocity, axis=0) / step
    assert np.all(np.abs(acceleration) <= limits.acceleration * 1.001)


def feasible_state(generator: np.random.Generator, limits: JointLimits, *, at_the_edge: bool) -> tuple[np.ndarray, ...]:
    """A state from which the firmest stop stays inside every limit; at the edge, half the joints use all their room."""
    n = limits.joint_count
    a = generator.uniform(-1, 1, n) * limits.acceleration
    reserve = limits.velocity - a**2 / (2 * limits.jerk)
    v = generator.uniform(-1, 1, n) * reserve
    q = np.empty(n)
    for i in range(n):
        up = stopping_travel(v[i], a[i], limits.acceleration[i], limits.jerk[i])
        down = stopping_travel(-v[i], -a[i], limits.acceleration[i], limits.jerk[i])
        low, high = limits.position_lower[i] + down, limits.position_upper[i] - up
        q[i] = (
            generator.choice([low, high]) if at_the_edge and generator.random() < 0.5 else generator.uniform(low, high)
        )
    return q, v, a


@settings(max_examples=150, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), edge=st.booleans(), seven=st.booleans())
def test_from_any_feasible_state_the_stop_stays_inside_every_limit_and_ends_at_rest(
    seed: int, edge: bool, seven: bool
) -> None:
    limits = IIWA7_R800 if seven else IIWA14_R820
    q, v, a = feasible_state(np.random.default_rng(seed), limits, at_the_edge=edge)
    ramp = plan_stop_ramp(q, v, a, limits)
    path = _sampled(ramp)
    _assert_inside(path, 5e-4, limits)
    start_q, start_v, start_a = ramp.at(0.0)
    assert start_q == pytest.approx(q, abs=1e-9)
    assert start_v == pytest.approx(v, abs=1e-9)
    assert start_a == pytest.approx(a, abs=1e-9)
    assert np.ptp(path[-3:], axis=0) == pytest.approx(np.zeros(7), abs=1e-12)
    # The last half millisecond before the end is already as good as at rest: no jump into the held state.
    assert np.abs(np.diff(path, axis=0)[-3]).max() < 1e-7


def test_a_stop_in_the_open_is_gentle() -> None:
    ramp = plan_stop_ramp(np.zeros(7), 0.5 * LIMITS.velocity, np.zeros(7), LIMITS)
    acceleration = np.diff(_sampled(ramp), 2, axis=0) / 5e-4**2
    assert np.all(np.abs(acceleration) <= 0.36 * LIMITS.acceleration)


def test_near_a_limit_the_stop_becomes_firmer() -> None:
    speed = np.zeros(7)
    speed[0] = 1.4
    room = stopping_travel(1.4, 0.0, LIMITS.acceleration[0], LIMITS.jerk[0])
    q = np.zeros(7)
    q[0] = LIMITS.position_upper[0] - 1.02 * room
    ramp = plan_stop_ramp(q, speed, np.zeros(7), LIMITS)
    assert ramp.fraction == 1.0
    _assert_inside(_sampled(ramp), 5e-4, LIMITS)


def test_a_state_that_cannot_be_stopped_is_named_with_joint_and_numbers_and_the_firmest_stop_is_kept() -> None:
    speed = np.zeros(7)
    speed[3] = -1.2
    room = stopping_travel(1.2, 0.0, LIMITS.acceleration[3], LIMITS.jerk[3])
    q = np.zeros(7)
    q[3] = LIMITS.position_lower[3] + 0.8 * room
    with pytest.raises(RampError, match=r"joint 4 to -2\.\d+ rad.*-2\.09440 rad") as caught:
        plan_stop_ramp(q, speed, np.zeros(7), LIMITS)
    error = caught.value
    assert (error.joint, error.quantity, error.unit) == (4, "position", "rad")
    assert error.value == pytest.approx(LIMITS.position_lower[3] - 0.2 * room, abs=1e-6)
    assert error.firmest is not None
    assert error.firmest.at(9.0)[1].tolist() == [0.0] * 7


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_stop_exists_exactly_where_the_closed_form_says_so(seed: int) -> None:
    """Moved 0.1 mrad past the edge, the same state is refused; at the edge it is accepted."""
    generator = np.random.default_rng(seed)
    q, v, a = feasible_state(generator, LIMITS, at_the_edge=False)
    i = int(generator.integers(7))
    v[i], a[i] = abs(v[i]) + 0.01, abs(a[i]) / 2
    v[i] = min(v[i], LIMITS.velocity[i] - a[i] ** 2 / (2 * LIMITS.jerk[i]))
    q[i] = LIMITS.position_upper[i] - stopping_travel(v[i], a[i], LIMITS.acceleration[i], LIMITS.jerk[i])
    assert plan_stop_ramp(q, v, a, LIMITS).duration_s > 0.0
    q[i] += 1e-4
    with pytest.raises(RampError) as caught:
        plan_stop_ramp(q, v, a, LIMITS)
    assert caught.value.joint == i + 1


def test_noise_past_the_limits_does_not_prevent_a_stop() -> None:
    ramp = plan_stop_ramp(
        LIMITS.position_upper + 1e-3, np.zeros(7), np.zeros(7), LIMITS
    )  # at rest, slightly outside: nothing to do, and nothing to complain about
    assert ramp.duration_s == 0.0
    fast = plan_stop_ramp(np.zeros(7), 1.05 * LIMITS.velocity, -1.1 * LIMITS.acceleration, LIMITS)
    path = _sampled(fast)
    assert np.all(np.abs(np.diff(path, axis=0)) / 5e-4 <= 1.051 * LIMITS.velocity)
    assert np.all(np.abs(np.diff(path, 2, axis=0)) / 5e-4**2 <= 1.101 * LIMITS.acceleration)
    assert fast.at(fast.duration_s)[1].tolist() == [0.0] * 7


def test_a_stop_of_an_arm_at_rest_holds_its_place() -> None:
    position = np.linspace(-1, 1, 7)
    ramp = plan_stop_ramp(position, np.zeros(7), np.zeros(7), LIMITS)
    for t in (0.0, 0.001, 5.0):
        q, dq, ddq = ramp.at(t)
        assert q == pytest.approx(position)
        assert not dq.any()
        assert not ddq.any()


@settings(max_examples=100, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_start_ramps_reach_the_moving_target_on_a_tick_inside_every_limit(seed: int) -> None:
    generator = np.random.default_rng(seed)
    begin = generator.uniform(0.6 * LIMITS.position_lower, 0.6 * LIMITS.position_upper)
    # The first sample of an excitation: away from the limits by the room that getting up to speed takes.
    target = generator.uniform(0.5 * LIMITS.position_lower, 0.5 * LIMITS.position_upper)
    acceleration = generator.uniform(-0.5, 0.5, 7) * LIMITS.acceleration
    velocity = generator.uniform(-0.7, 0.7, 7) * LIMITS.velocity
    ramp = plan_start_ramp(begin, target, velocity, acceleration, LIMITS)
    ticks = ramp.duration_s / 0.001
    assert ticks == pytest.approx(round(ticks), abs=1e-6)
    q, dq, ddq = ramp.at(ramp.duration_s)
    assert np.array_equal(q, target)
    assert np.array_equal(dq, velocity)
    assert np.array_equal(ddq, acceleration)
    before = np.array([ramp.at(ramp.duration_s - t)[0] for t in (3e-4, 2e-4, 1e-4)])
    # Ruckig's own end, a moment before the exact target is handed out, leads into it without a step.
    assert before[2] + velocity * 1e-4 == pytest.approx(target, abs=3e-7)
    path = np.array([ramp.at(k * 0.001)[0] for k in range(round(ticks) + 1)])
    _assert_inside(path, 0.001, LIMITS)
    assert path[0] == pytest.approx(begin, abs=1e-9)


@pytest.mark.parametrize("period", [0.001, 0.002, 0.005, 0.01])
def test_start_ramps_fit_every_send_period(period: float) -> None:
    ramp = plan_start_ramp(np.zeros(7), np.full(7, 0.3), np.full(7, 0.2), np.zeros(7), LIMITS, command_period_s=period)
    assert ramp.duration_s / period == pytest.approx(round(ramp.duration_s / period), abs=1e-9)


def test_an_arm_already_on_a_resting_target_needs_no_ramp() -> None:
    ramp = plan_start_ramp(np.full(7, 0.2), np.full(7, 0.2), np.zeros(7), np.zeros(7), LIMITS)
    assert ramp.duration_s == 0.0
    assert ramp.at(0.0)[0] == pytest.approx(np.full(7, 0.2))


@pytest.mark.parametrize(
    ("position", "velocity", "acceleration", "words"),
    [
        (2.2, 0.0, 0.0, r"target of the ramp has joint 4 at 2\.20000 rad, beyond its limit of 2\.09440 rad"),
        (0.0, 1.4, 0.0, r"target of the ramp needs 1\.4000 rad/s at joint 4; its velocity limit is 1\.3090"),
        (0.0, 0.0, 12.0, r"target of the ramp needs 12\.0000 rad/s² at joint 4; its acceleration limit is 11\.3600"),
        (0.0, 1.3, -8.0, r"target of the ramp needs 1\.5\d+ rad/s at joint 4; its velocity limit is 1\.3090"),
        (float("nan"), 0.0, 0.0, r"target position of joint 4 is nan"),
    ],
)
def test_an_impossible_target_is_refused_with_its_numbers(
    position: float, velocity: float, acceleration: float, words: str
) -> None:
    target, speed, rate = np.zeros(7), np.zeros(7), np.zeros(7)
    target[3], speed[3], rate[3] = position, velocity, acceleration
    with pytest.raises(RampError, match=words) as caught:
        plan_start_ramp(np.zeros(7), target, speed, rate, LIMITS)
    assert caught.value.joint == 4


def test_a_target_that_is_on_its_way_out_needs_room_before_it() -> None:
    """At the upper limit, moving up at speed: no ramp within the limits can end there, and joint and limit are
    named.
    """
    target = np.zeros(7)
    target[1] = LIMITS.position_lower[1] + 1e-3
    speed = np.zeros(7)
    speed[1] = 1.0  # to arrive there upwards the joint would have to come from below its lower limit
    with pytest.raises(RampError, match="joint 2") as caught:
        plan_start_ramp(np.zeros(7), target, speed, np.zeros(7), LIMITS)
    assert caught.value.quantity == "position"


def test_a_wrong_number_of_joints_is_refused() -> None:
    with pytest.raises(RampError, match=r"shape \(6,\)"):
        plan_stop_ramp(np.zeros(6), np.zeros(7), np.zeros(7), LIMITS)


def test_a_stop_from_the_guards_state_goes_on_without_a_step() -> None:
    """The first commands of the stop continue the accepted ones: no acceleration beyond what was there before."""
    guard = CommandGuard(LIMITS, 0.001)
    omega, amplitude = 2 * np.pi * 0.4, 0.4
    positions = amplitude * (1 - np.cos(omega * np.arange(0, 900) * 0.001))[:, None] * np.ones(7)
    guard.anchor(positions[0])
    for row in positions[1:]:
        assert judged(guard, row, row) is None
    ramp = plan_stop_ramp(guard.position, guard.velocity, guard.acceleration, LIMITS)
    joined = np.vstack([positions[-3:], [ramp.at(k * 0.001)[0] for k in range(1, 4)]])
    jumps = np.abs(np.diff(joined, 3, axis=0)) / 0.001**3
    assert np.all(jumps <= LIMITS.jerk)
