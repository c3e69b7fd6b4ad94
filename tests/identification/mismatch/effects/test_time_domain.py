"""Filters over time and the effects made of them. Truth: sinusoids in closed form, and SciPy's simulation of a mode."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from scipy.signal import lsim

from identification.mismatch.effects.base import Estimate, Place
from identification.mismatch.effects.structural_resonance import StructuralResonance
from identification.mismatch.effects.time_domain import time_derivative
from identification.mismatch.effects.torque_delay import TorqueDelay
from identification.mismatch.motion import Motion
from tests.identification.mismatch.effects.motions import motion_of, random_links, sliding_robot

FloatArray = npt.NDArray[np.float64]


def carrying(torque: FloatArray, rate_hz: float, *, periodic: bool = True) -> Motion:
    """A motion of 10 s whose first joint carries this torque."""
    robot = sliding_robot()
    motion = motion_of(robot, random_links(robot.n, 1), rate_hz=rate_hz, periodic=periodic)
    values = motion.torque.copy()
    values[:, 0] = torque
    return replace(motion, torque=values)


@pytest.mark.parametrize("delay", [0.002, 0.012, 0.03])
@pytest.mark.parametrize("place", [Place(joint=1), Place()])
def test_a_delayed_sinusoid_is_the_sinusoid_of_an_earlier_time(delay: float, place: Place) -> None:
    time = np.arange(2000) / 200.0
    motion = carrying(3.0 * np.sin(2.0 * np.pi * 0.7 * time), 200.0)
    columns = TorqueDelay().columns(motion, place, {"delay": delay, "lag": 0.0})
    assert columns is not None
    assert columns.joints == ((0,) if place.joint else (0, 1, 2))
    expected = 3.0 * (np.sin(2.0 * np.pi * 0.7 * (time - delay)) - np.sin(2.0 * np.pi * 0.7 * time))
    np.testing.assert_allclose(columns.values[:, 0, 0], expected, rtol=0.0, atol=1e-12)


def test_a_lagged_sinusoid_has_the_phase_and_amplitude_of_a_first_order_filter() -> None:
    time, omega, constant = np.arange(2000) / 200.0, 2.0 * np.pi * 0.7, 0.05
    motion = carrying(np.sin(omega * time), 200.0)
    columns = TorqueDelay().columns(motion, Place(joint=1), {"delay": constant, "lag": 1.0})
    assert columns is not None
    lagged = np.sin(omega * time - np.arctan(omega * constant)) / np.hypot(1.0, omega * constant)
    np.testing.assert_allclose(columns.values[:, 0, 0], lagged - np.sin(omega * time), rtol=0.0, atol=1e-12)


def test_a_lag_of_second_order_is_two_filters_of_half_its_time_in_a_row() -> None:
    time, omega, constant = np.arange(2000) / 200.0, 2.0 * np.pi * 0.7, 0.05
    motion = carrying(np.sin(omega * time), 200.0)
    columns = TorqueDelay().columns(motion, Place(joint=1), {"delay": constant, "lag": 2.0})
    assert columns is not None
    turned, left = 2.0 * np.arctan(0.5 * omega * constant), 1.0 / (1.0 + (0.5 * omega * constant) ** 2)
    lagged = left * np.sin(omega * time - turned)
    np.testing.assert_allclose(columns.values[:, 0, 0], lagged - np.sin(omega * time), rtol=0.0, atol=1e-12)


def test_a_delay_on_a_stretch_without_periods_is_right_away_from_its_ends() -> None:
    time, delay = np.arange(2000) / 200.0, 0.02
    motion = carrying(np.sin(2.3 * time), 200.0, periodic=False)
    columns = TorqueDelay().columns(motion, Place(joint=1), {"delay": delay, "lag": 0.0})
    assert columns is not None
    error = columns.values[:, 0, 0] - (np.sin(2.3 * (time - delay)) - np.sin(2.3 * time))
    assert np.abs(error[200:-200]).max() < 1e-4
    assert np.abs(error).max() < 0.02


def test_a_delay_is_reported_as_coefficient_times_shape() -> None:
    estimate = Estimate(
        Place(joint=2), {"delay": 0.004, "lag": 0.0}, np.array([0.75]), np.array([[0.01]]), {"delay": 0.001}
    )
    delay = TorqueDelay().parameters(estimate)[0]
    assert (delay.value, delay.unit) == (pytest.approx(3.0), "ms")
    assert delay.std == pytest.approx(0.4)


def test_derivatives_of_a_periodic_signal_are_exact_and_of_others_second_order() -> None:
    time = np.arange(2000) / 200.0
    signal, truth = np.sin(2.0 * np.pi * 0.7 * time), 2.0 * np.pi * 0.7 * np.cos(2.0 * np.pi * 0.7 * time)
    np.testing.assert_allclose(time_derivative(carrying(signal, 200.0), signal), truth, rtol=0.0, atol=1e-10)
    rough = time_derivative(carrying(signal, 200.0, periodic=False), signal)
    np.testing.assert_allclose(rough, truth, rtol=0.0, atol=1e-3)


@pytest.mark.parametrize("damping", [0.02, 0.08])
def test_a_mode_rings_after_a_torque_step_as_the_simulated_one_does(damping: float) -> None:
    """A torque that switches every 5 s through 1 − ω²/(s² + 2ζωs + ω²), simulated from rest for three periods."""
    frequency, rate = 8.0, 1000.0
    time = np.arange(10_000) / rate
    square = np.where(time < 5.0, 1.0, -1.0)
    motion = carrying(square, rate)
    omega = 2.0 * np.pi * frequency
    columns = StructuralResonance().columns(motion, Place(joint=1), {"frequency": frequency, "damping": damping})
    assert columns is not None
    mode = ([1.0, 2.0 * damping * omega, 0.0], [1.0, 2.0 * damping * omega, omega**2])
    periods = np.tile(square, 3)
    _, simulated, _ = lsim(mode, periods, np.arange(periods.size) / rate, interp=False)
    ours, theirs = columns.values[:, 0] @ [1.0, 2.0 * damping], simulated[-10_000:]
    # Two samples about each switch: a sampled step has no agreed middle.
    settled = np.abs((time + 2.5) % 5.0 - 2.5) > 0.01
    assert np.corrcoef(ours[settled], theirs[settled])[0, 1] > 0.995
    assert np.abs(ours[settled] - theirs[settled]).max() < 0.06


def test_the_share_of_a_mode_is_the_amplitude_at_resonance() -> None:
    """At resonance ω/s is −i: the two answers are at right angles."""
    estimate = Estimate(Place(joint=1), {"frequency": 8.0, "damping": 0.05}, np.array([0.3, 0.4]), np.zeros((2, 2)))
    share = StructuralResonance().parameters(estimate)[0]
    assert share.value == pytest.approx(50.0)
