"""Claims about σ promised before a motion; truth: the spread of plain least squares over simulated noise."""

from __future__ import annotations

import numpy as np
import pytest

from identification.base_parameters import BaseRegressor
from identification.errors import DesignError
from identification.excitation import default_trajectory
from identification.excitation.fourier import FourierTrajectory
from identification.excitation.prediction import predict_deviations
from identification.robots import load_robot
from identification.signals.periodic import PeriodicSettings


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
    )
    samples = round(10.0 * rate)
    matrix = regressor.matrix(*default_trajectory().evaluate(np.arange(samples) / rate))
    weighted = (matrix / noise[:, None]).reshape(-1, regressor.size)
    draws = np.random.default_rng(11).normal(size=(len(weighted), 600)) / np.sqrt(periods)
    spread = np.linalg.lstsq(weighted, draws, rcond=None)[0].std(axis=1)
    # 600 draws know a deviation to 2.9 %; 57 of them stay within 4 of those.
    np.testing.assert_allclose(spread, promised.std, rtol=0.12)


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
