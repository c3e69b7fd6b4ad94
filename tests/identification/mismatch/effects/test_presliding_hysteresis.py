"""Dahl's loop. Truth: the closed form on a triangular motion, SciPy's integration, elasto-plasticity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from identification.mismatch.effects.presliding_hysteresis import dahl_state
from identification.mismatch.motion import Motion
from tests.identification.mismatch.effects.motions import motion_of, random_links, sliding_robot

FloatArray = npt.NDArray[np.float64]


def moving(position: FloatArray, *, periodic: bool = True) -> Motion:
    """A motion whose first joint follows these positions."""
    robot = sliding_robot()
    motion = motion_of(robot, random_links(robot.n, 1), rate_hz=position.size / 10.0, periodic=periodic)
    values = motion.position.copy()
    values[:, 0] = position
    return replace(motion, position=values)


def triangle(stroke: float, samples: int = 1000) -> FloatArray:
    phase = np.arange(samples) / samples
    return stroke * (1.0 - np.abs(2.0 * phase - 1.0))


@given(stroke=st.floats(5e-3, 0.5), distance=st.floats(1e-3, 0.05))
@settings(max_examples=30, deadline=None)
def test_on_a_triangle_the_state_swings_between_the_closed_forms_ends(stroke: float, distance: float) -> None:
    """Steady state over the stroke D: z_m = 1 − (1 + z_m) e^(−D/δ), so z_m = tanh(D/2δ)."""
    # One period does not reach the steady state from zero when the stroke is short against the distance.
    repeats = 40
    state = dahl_state(moving(np.tile(triangle(stroke, 200), repeats)), 0, distance)
    end = np.tanh(stroke / (2.0 * distance))
    reached = 1.0 - np.exp(-2.0 * repeats * stroke / distance)
    assert state.max() == pytest.approx(end, abs=1e-9 + 2.0 * (1.0 - reached))
    assert state.min() == pytest.approx(-end, abs=1e-9 + 2.0 * (1.0 - reached))


@pytest.mark.parametrize("exponent", [0.5, 1.0, 1.7])
def test_the_state_follows_dahls_equation(exponent: float) -> None:
    time = np.arange(2000) / 200.0
    motion = moving(0.02 * np.sin(2.0 * np.pi * 0.3 * time))
    distance = 0.008

    def rate(t: float, z: FloatArray) -> FloatArray:
        velocity = 0.02 * 2.0 * np.pi * 0.3 * np.cos(2.0 * np.pi * 0.3 * t)
        gap = np.maximum(1.0 - z * np.sign(velocity), 0.0)
        return velocity * gap**exponent / distance

    truth = solve_ivp(rate, (0.0, 20.0), [0.0], t_eval=time + 10.0, rtol=1e-8, atol=1e-10, max_step=0.01).y[0]
    np.testing.assert_allclose(dahl_state(motion, 0, distance, exponent), truth, rtol=0.0, atol=2e-4)


def test_a_vanishing_exponent_is_an_elastoplastic_element() -> None:
    position = 0.03 * np.sin(2.0 * np.pi * np.arange(1000) / 1000.0)
    state = 0.0
    truth = []
    for step in np.diff(np.tile(position, 2), prepend=0.0):
        state = float(np.clip(state + step / 0.01, -1.0, 1.0))
        truth.append(state)
    np.testing.assert_allclose(dahl_state(moving(position), 0, 0.01, 1e-9), truth[1000:], rtol=0.0, atol=5e-3)


@given(seed=st.integers(0, 1000), exponent=st.floats(0.1, 3.0), periodic=st.booleans())
@settings(max_examples=20, deadline=None)
def test_the_state_stays_within_the_coulomb_level_on_any_motion(seed: int, exponent: float, periodic: bool) -> None:
    steps = np.random.default_rng(seed).normal(scale=0.003, size=500)
    steps[100:140] = 0.0
    state = dahl_state(moving(np.cumsum(steps), periodic=periodic), 0, 0.01, exponent)
    assert np.abs(state).max() <= 1.0 + 1e-12
    # Rate independence in its plainest form: no motion, no change.
    assert np.ptp(state[101:140]) < 1e-14


def test_a_joint_at_rest_has_no_state() -> None:
    assert not dahl_state(moving(np.full(200, 0.3)), 0, 0.01).any()
