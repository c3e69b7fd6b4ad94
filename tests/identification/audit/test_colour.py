"""Claims about residuals that go on from row to row.

Truth: the covariance of an autoregression of order two in closed form (Yule and Walker's equations).
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import toeplitz
from scipy.signal import lfilter

from identification.audit.colour import Colour, colour_of, preceded

FIRST, SECOND, DEVIATION = 1.2, -0.5, 0.3


def covariance(rows: int) -> np.ndarray:
    """(rows, rows) of a stationary series x_t = FIRST x_(t−1) + SECOND x_(t−2) + e_t."""
    correlation = [1.0, FIRST / (1.0 - SECOND)]
    for _ in range(rows - 2):
        correlation.append(FIRST * correlation[-1] + SECOND * correlation[-2])
    variance = DEVIATION**2 / (1.0 - FIRST * correlation[1] - SECOND * correlation[2])
    return variance * toeplitz(correlation)


def series(rows: int, seed: int) -> np.ndarray:
    noise = DEVIATION * np.random.default_rng(seed).standard_normal((rows + 200, 1))
    return np.asarray(lfilter([1.0], [1.0, -FIRST, -SECOND], noise, axis=0))[200:]


def estimated() -> Colour:
    left = series(40_000, 7)
    return colour_of(left, np.ones(left.shape, dtype=np.bool_))


def test_innovations_of_an_autoregression_are_white_from_the_first_row_of_a_stretch_on() -> None:
    colour, rows = estimated(), 30
    assert abs(colour.std[0] / DEVIATION - 1.0) < 0.02
    starts = np.arange(rows) == 12
    before = preceded(np.ones((rows, 1), dtype=np.bool_), starts)
    turned = colour.innovations(np.eye(rows)[:, None, :], before)[:, 0]
    assert not turned[12:, :12].any()
    for stretch in (slice(0, 12), slice(12, 30)):
        part = turned[stretch, stretch]
        white = part @ covariance(rows)[stretch, stretch] @ part.T / DEVIATION**2
        np.testing.assert_allclose(white, np.eye(len(white)), atol=0.06)


def test_rows_behind_a_joint_at_rest_are_foretold_by_none_before_it() -> None:
    used = np.array([[True], [True], [False], [True], [True], [True]])
    starts = np.array([True, False, False, False, False, True])
    assert preceded(used, starts)[:, 0].tolist() == [0, 1, 2, 0, 1, 0]


def test_what_a_fit_took_of_a_short_series_still_counts_as_its_noise() -> None:
    """Truth: the spectrum at zero of an autoregression, σ²/(1 − a)². Slow waves that are fitted take most of it."""
    rows, slowness = 70, 0.5
    phase = np.pi * (np.arange(rows) + 0.5) / rows
    waves = np.stack([np.cos(k * phase) for k in range(10)], axis=1)
    used, before = np.ones((rows, 1), dtype=np.bool_), np.arange(rows)[:, None]
    found = []
    for seed in range(60):
        noise = np.random.default_rng(seed).standard_normal((rows + 50, 1))
        torque = lfilter([1.0], [1.0, -slowness], noise, axis=0)[50:]
        colour, doubt = Colour.white(np.ones(1)), np.zeros((rows, 1, 10))
        for _ in range(6):
            own = colour.innovations(waves[:, None], before)[:, 0] / colour.std
            seen = colour.innovations(torque, before) / colour.std
            left = torque - waves @ np.linalg.lstsq(own, seen, rcond=None)[0]
            colour = colour_of(left, used, doubt)
            doubt = (waves @ np.linalg.cholesky(np.linalg.inv(own.T @ own)))[:, None]
        found.append(float(colour.std[0] / colour.taps[0, -1].sum()))
    assert abs(np.median(found) * (1.0 - slowness) - 1.0) < 0.2


def test_white_residuals_stay_as_they_are() -> None:
    left = np.random.default_rng(3).standard_normal((5000, 2))
    used = np.ones(left.shape, dtype=np.bool_)
    colour = colour_of(left, used)
    before = preceded(used, np.arange(len(left)) == 0)
    np.testing.assert_allclose(colour.innovations(left, before), left, atol=0.2)
    np.testing.assert_allclose(colour.std, left.std(axis=0), rtol=0.01)
    np.testing.assert_array_equal(Colour.white(np.ones(2)).innovations(left, before), left)
