"""What a model leaves on held-out recordings. Truth: SciPy's normal distribution, and draws from it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from identification.mismatch.heldout import Residuals

JOINTS, ROWS, DIRECTIONS = 2, 15, 3


def drawn(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Sensor noise (n, R) Nm, scatter (n, R, k) Nm: a few times the noise along three directions."""
    random = np.random.default_rng(seed)
    noise = random.uniform(0.5, 2.0, (JOINTS, ROWS))
    return noise, random.normal(size=(JOINTS, ROWS, DIRECTIONS)) * noise[..., None]


def left(rows: np.ndarray, noise: np.ndarray, scatter: np.ndarray) -> Residuals:
    wide = np.sqrt(noise**2 + (scatter**2).sum(axis=2))
    return Residuals(rows=rows, noise=wide, sensor_noise=noise, used=noise > 0.0, samples=1, scatter=scatter)


def covariance(noise: np.ndarray, scatter: np.ndarray) -> np.ndarray:
    flat = scatter.reshape(-1, scatter.shape[2])
    return np.asarray(np.diag(noise.ravel() ** 2) + flat @ flat.T)


def test_differences_of_the_log_likelihood_are_those_of_the_normal_density() -> None:
    noise, scatter = drawn(1)
    smaller = 0.3 * scatter
    rows = np.random.default_rng(2).normal(size=noise.shape)
    other = rows + 0.7 * noise
    true = [
        multivariate_normal(np.zeros(noise.size), covariance(noise, part)).logpdf(values.ravel())
        for part, values in ((scatter, rows), (smaller, other))
    ]
    told = left(rows, noise, scatter).log_likelihood - left(other, noise, smaller).log_likelihood
    assert told == pytest.approx(true[0] - true[1])


def test_the_distance_of_two_predictions_is_that_of_mahalanobis() -> None:
    noise, scatter = drawn(3)
    rows, moved = np.random.default_rng(4).normal(size=(2, *noise.shape))
    difference = (rows - moved).ravel()
    distance = difference @ np.linalg.solve(covariance(noise, scatter), difference)
    assert left(rows, noise, scatter).squared_distance(left(moved, noise, scatter)) == pytest.approx(distance)


def test_excess_energy_scatters_as_much_as_it_says_where_few_parameters_move_all_rows() -> None:
    noise, scatter = drawn(5)
    random = np.random.default_rng(6)
    parameters = random.normal(size=(20_000, DIRECTIONS))
    rows = noise * random.normal(size=(20_000, *noise.shape)) + np.einsum("nrk,sk->snr", scatter, parameters)
    model = left(np.zeros_like(noise), noise, scatter)
    energies = (rows**2 - model.noise**2).sum(axis=2)
    assert energies.std(axis=0) == pytest.approx(model.excess_deviation, rel=0.05)
