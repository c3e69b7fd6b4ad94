"""The noise of the mean comes out as it was put in, whatever else changes between periods."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import f as fisher

from identification.mismatch.noise import noise_of_mean
from identification.signals.periodic import to_lines


def rows_of(periods: np.ndarray, lines: int) -> np.ndarray:
    return np.stack([to_lines(period, lines) for period in periods])


@pytest.mark.parametrize("periods", [2, 4, 8, 16])
def test_white_noise_is_measured_without_bias(periods: int) -> None:
    random = np.random.default_rng(1)
    values = random.normal(scale=0.3, size=(periods, 1000, 40))
    std, _ = noise_of_mean(rows_of(values, 300))
    assert np.sqrt(np.mean(std[1:] ** 2)) == pytest.approx(0.3 / np.sqrt(periods), rel=0.02)


def test_coloured_noise_keeps_its_colour() -> None:
    random = np.random.default_rng(2)
    white = random.normal(size=(16 * 2000, 20))
    pole = 0.97
    coloured = np.zeros_like(white)
    for row in range(1, white.shape[0]):
        coloured[row] = pole * coloured[row - 1] + white[row]
    std, _ = noise_of_mean(rows_of(coloured.reshape(16, 2000, 20), 400))
    line = np.arange(1, 401)
    exact = 1.0 / np.abs(1.0 - pole * np.exp(-2j * np.pi * line / 2000)) / 4.0
    measured = np.sqrt(np.mean(std[1::2] ** 2, axis=1))
    assert np.median(np.abs(measured / exact - 1.0)) < 0.06
    assert np.all(np.abs(measured[5:] / exact[5:] - 1.0) < 0.35)


def test_a_contact_in_one_period_is_no_noise() -> None:
    random = np.random.default_rng(3)
    values = random.normal(size=(16, 1000, 10))
    plain, _ = noise_of_mean(rows_of(values, 300))
    values[7, 300:400] += 20.0
    touched, _ = noise_of_mean(rows_of(values, 300))
    assert np.median(touched / plain) < 1.1


def test_drift_from_period_to_period_is_no_noise() -> None:
    random = np.random.default_rng(4)
    values = random.normal(size=(16, 1000, 30))
    plain, _ = noise_of_mean(rows_of(values, 300))
    drifting, _ = noise_of_mean(rows_of(values + 0.01 * np.arange(16)[:, None, None], 300))
    assert np.mean(drifting[0] ** 2) / np.mean(plain[0] ** 2) < 1.15


def test_line_zero_is_never_below_its_neighbours() -> None:
    random = np.random.default_rng(5)
    values = random.normal(size=(16, 1000, 200))
    values -= values.mean(axis=1, keepdims=True)
    std, _ = noise_of_mean(rows_of(values, 300))
    assert np.median(std[0]) == pytest.approx(0.25, rel=0.15)


def test_freedom_grows_with_periods_and_with_the_lines_averaged() -> None:
    values = np.random.default_rng(6).normal(size=(16, 1000, 2))
    _, many = noise_of_mean(rows_of(values, 300))
    _, few = noise_of_mean(rows_of(values[:4], 300))
    assert np.all(many > few)
    assert np.all(many[-1] > 5.0 * many[1])


@pytest.mark.parametrize("excess", [1.0, 100.0])
def test_line_zero_is_judged_by_the_freedom_that_stands_behind_it(excess: float) -> None:
    """A sensor's zero wanders more than its lines scatter: sixteen numbers, not those of the neighbours, say by how
    much.
    """
    rows = np.random.default_rng(7).normal(size=(16, 41, 20000))
    rows[:, 0] *= np.sqrt(excess)
    std, freedom = noise_of_mean(rows)
    square = (rows.mean(axis=0)[0] / std[0]) ** 2
    for chance in (0.05, 0.01, 1e-3):
        assert np.mean(fisher.sf(square, 1.0, freedom[0]) < chance) < chance + 3.0 * np.sqrt(chance / square.size)
    alone = np.mean(freedom[0] < 0.5 * freedom[1])
    assert alone < 0.07 if excess == 1.0 else alone > 0.95
