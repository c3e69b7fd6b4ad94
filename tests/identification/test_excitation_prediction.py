"""Claims about σ promised before a motion; truth: the spread of plain least squares over simulated noise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from identification.base_parameters import BaseRegressor
from identification.errors import DesignError
from identification.excitation import default_trajectory
from identification.excitation.fourier import FourierTrajectory
from identification.excitation.prediction import NoiseColour, predict_deviations
from identification.recording_fit import FitSettings, fit_recordings
from identification.robots import load_robot
from identification.signals.periodic import PeriodicSettings
from tests.identification.synthetic import coloured_noise, inverse_dynamics, recording_of, table_three


def test_the_promised_deviations_are_the_spread_of_estimates_from_noisy_torque() -> None:
    regressor = BaseRegressor(load_robot("iiwa14"))
    noise = np.array([0.2, 0.1, 0.15, 0.1, 0.08, 0.05, 0.03])
    rate, periods = 20.0, 4
    # Every line that the rate can hold: then time-domain least squares uses the same rows.
    promised = predict_deviations(
        regressor,
        default_trajectory(),
        noise_nm=noise,
        periods=periods,
        rate_hz=rate,
        settings=PeriodicSettings(torque_bandwidth_hz=rate),
        colour=NoiseColour(share=0.0),
    )
    samples = round(10.0 * rate)
    matrix = regressor.matrix(*default_trajectory().evaluate(np.arange(samples) / rate))
    weighted = (matrix / noise[:, None]).reshape(-1, regressor.size)
    draws = np.random.default_rng(11).normal(size=(len(weighted), 600)) / np.sqrt(periods)
    spread = np.linalg.lstsq(weighted, draws, rcond=None)[0].std(axis=1)
    # 600 draws know a deviation to 2.9 %; 57 of them stay within 4 of those.
    np.testing.assert_allclose(spread, promised.std, rtol=0.12)


def test_the_density_of_coloured_noise_is_that_of_the_recursion_it_describes() -> None:
    colour, rate, samples = NoiseColour(0.3, 5.0), 1000.0, 2000
    generator = np.random.default_rng(5)
    pole = np.exp(-2.0 * np.pi * 5.0 / rate)
    slow = lfilter([np.sqrt(1.0 - pole**2)], [1.0, -pole], generator.normal(size=(400, 3 * samples)))[:, -samples:]
    noise = np.sqrt(0.3) * slow + np.sqrt(0.7) * generator.normal(size=(400, samples))
    power = np.mean(np.abs(np.fft.rfft(noise, axis=1)) ** 2, axis=0) / samples
    frequency = np.fft.rfftfreq(samples, 1.0 / rate)
    # Bands of some ten lines: 400 draws know each to about 2 %.
    for low, high in ((1.0, 5.0), (5.0, 10.0), (10.0, 30.0), (100.0, 400.0)):
        band = (frequency >= low) & (frequency < high)
        assert np.mean(power[band]) == pytest.approx(np.mean(colour.density(frequency[band], rate)), rel=0.08)
    assert colour.density(1.0, rate) > 15.0


def test_a_fit_of_as_many_periods_reports_the_promised_deviations() -> None:
    robot = load_robot("iiwa14")
    trajectory, noise, rate, periods = default_trajectory(), 0.2, 100.0, 16
    q, dq, ddq = trajectory.evaluate(np.arange(1000) / rate)
    torque = inverse_dynamics(robot, table_three(), q, dq, ddq)
    # All of the variance below 5 Hz, by a recursion that knows nothing of the promise.
    correlation = float(np.exp(-2.0 * np.pi * 5.0 / rate))
    error = coloured_noise((1000 * periods, 7), deviation=noise, correlation=correlation, seed=4)
    recording = recording_of(
        np.tile(q, (periods, 1)), np.tile(torque, (periods, 1)) + error, period_s=10.0, periods=periods
    )
    fitted = fit_recordings([recording], robot, FitSettings(physical=False))
    promised = predict_deviations(
        fitted.regressor,
        trajectory,
        noise_nm=np.full(7, noise),
        periods=periods,
        rate_hz=rate,
        colour=NoiseColour(1.0, 5.0),
    )
    ratio = fitted.std / promised.std
    # The fit measures its noise on 16 periods, some ten per cent on each line.
    assert np.median(ratio) == pytest.approx(1.0, abs=0.1)
    assert np.all((ratio > 0.75) & (ratio < 1.33))


def test_four_times_the_periods_halve_the_promised_deviations() -> None:
    regressor = BaseRegressor(load_robot("iiwa14"))
    once, four = (
        predict_deviations(regressor, default_trajectory(), periods=periods, rate_hz=100.0) for periods in (4, 16)
    )
    np.testing.assert_allclose(once.std, 2.0 * four.std)


def test_a_motion_that_leaves_parameters_open_is_refused() -> None:
    still = FourierTrajectory(0.1, np.zeros((7, 5)), np.zeros((7, 5)), np.zeros(7))
    with pytest.raises(DesignError, match="undetermined"):
        predict_deviations(BaseRegressor(load_robot("iiwa14")), still, rate_hz=100.0)


def test_a_noise_that_does_not_fit_the_robot_is_refused() -> None:
    with pytest.raises(DesignError, match="7 joints"):
        predict_deviations(BaseRegressor(load_robot("iiwa14")), default_trajectory(), noise_nm=np.ones(6))
