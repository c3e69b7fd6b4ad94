"""Estimators by name: efficiency against the Cramér–Rao bound, intervals that hold, outliers.

Truth: known parameters, closed-form information of the noise that was drawn, Pinocchio's inverse dynamics. The full
Monte Carlo with 1000 draws and 57 parameters is `python -m benchmarks.estimators`; here a small linear model of three
joints goes through the same functions, so that hundreds of draws cost seconds. On an arm: `test_estimators_of_an_arm`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.signal import lfilter

from identification.errors import EstimationError
from identification.estimators.observation import CompressedObservation
from identification.fitting.blocks import Block, variances_of
from identification.fitting.estimate import estimate_parameters
from identification.recording_fit import FitSettings, fit_recordings
from identification.robots import load_robot
from identification.signals.outliers import bound_outliers_across_periods, clean_across_periods, unclipped_share
from identification.signals.periodic import process_periodic, to_lines
from identification.signals.periods import PeriodTable, average_periods
from tests.identification.synthetic import fourier_motion, inverse_dynamics, recording_of, table_three

PERIODS, SAMPLES, PERIOD_S = 16, 400, 10.0
CORRELATION = np.array([0.5, 0.8, 0.95])
DEVIATION = np.array([0.3, 0.1, 0.02])
SIZE, JOINTS = 9, 3
NAMES = tuple(f"P_{number}" for number in range(SIZE))
TRUTH = np.arange(1.0, SIZE + 1.0)


def smooth_columns() -> np.ndarray:
    """(M, 3, 9) columns with harmonics 0 … 10 in them, the last joint without the first three parameters."""
    generator = np.random.default_rng(5)
    angle = 2.0 * np.pi * np.arange(SAMPLES) / SAMPLES
    waves = np.concatenate([np.cos(np.outer(angle, np.arange(11))), np.sin(np.outer(angle, np.arange(1, 11)))], axis=1)
    columns = np.einsum("mw,wjp->mjp", waves, generator.normal(size=(21, JOINTS, SIZE)))
    columns[:, 2, :3] = 0.0
    return columns


COLUMNS = smooth_columns()


def coloured(generator: np.random.Generator, rows: int) -> np.ndarray:
    white = generator.normal(size=(rows + 200, JOINTS))
    noise = [lfilter([np.sqrt(1.0 - phi**2)], [1.0, -phi], white[:, j]) for j, phi in enumerate(CORRELATION)]
    return DEVIATION * np.column_stack(noise)[200:]


def periodic_block(noise: np.ndarray, *, bound_outliers: bool = False) -> Block:
    """A block as the fit builds it, of the linear model instead of a robot."""
    torque = np.tile(COLUMNS @ TRUTH, (PERIODS, 1)) + noise
    recording = recording_of(np.tile(COLUMNS[:, :, 0], (PERIODS, 1)), torque, period_s=PERIOD_S, periods=PERIODS)
    signals = process_periodic(recording, bound_outliers=bound_outliers)
    columns = np.stack([signals.project(COLUMNS[:, joint]) for joint in range(JOINTS)], axis=1)
    return block_of(signals, columns, signals.project(signals.torque))


def block_of(signals, columns: np.ndarray, torque: np.ndarray) -> Block:  # type: ignore[no-untyped-def]
    every = np.ones(torque.shape, dtype=np.bool_)
    nothing = CompressedObservation(np.zeros((JOINTS, 1, SIZE + 1)), np.full(JOINTS, len(torque)), NAMES)
    return Block(signals, columns, torque, every, ~every, np.ones(torque.shape), nothing, None)


def stretch_block(noise: np.ndarray) -> Block:
    """The same data as one stretch of rows over time, without periods."""
    rows = 8 * SAMPLES
    columns = np.tile(COLUMNS, (8, 1, 1))
    torque = columns @ TRUTH + noise[:rows]
    signals = replace(periodic_block(np.zeros((PERIODS * SAMPLES, JOINTS))).signals, row_time=np.arange(rows) * 0.025)
    return block_of(signals, columns, torque)


@pytest.fixture(scope="module")
def bound() -> np.ndarray:
    """(9,) standard deviations of the Cramér–Rao bound: exact covariance of the noise, all rows of all periods."""
    information = np.zeros((SIZE, SIZE))
    rows = 4 * SAMPLES
    for joint, phi in enumerate(CORRELATION):
        columns = np.tile(COLUMNS[:, joint], (4, 1))
        covariance = DEVIATION[joint] ** 2 * toeplitz(phi ** np.arange(rows))
        information += columns.T @ np.linalg.solve(covariance, columns)
    return np.sqrt(np.diag(np.linalg.inv(information)) * 4.0 / PERIODS)


def draws(number: int, estimator: str, build, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # type: ignore[no-untyped-def]
    """Errors, stated σ and σ of eq. (15) over many draws of noise."""
    generator = np.random.default_rng(seed)
    results = [
        estimate_parameters([build(coloured(generator, PERIODS * SAMPLES))], NAMES, estimator) for _ in range(number)
    ]
    errors = np.array([result.least_squares.values - TRUTH for result in results])
    return errors, np.array([r.least_squares.std for r in results]), np.array([r.ordinary.std for r in results])


def test_maximum_likelihood_reaches_the_cramer_rao_bound_and_its_intervals_hold(bound: np.ndarray) -> None:
    errors, stated, _ = draws(500, "maximum_likelihood", periodic_block)
    ratio = np.sqrt(np.mean(errors**2, axis=0)) / bound
    # 500 draws: a ratio of 1 is measured to ±0.03, the largest of nine to about +0.06
    assert np.median(ratio) <= 1.06
    assert ratio.max() <= 1.13
    assert 0.93 <= np.mean(np.abs(errors) < 1.96 * stated) <= 0.97


def test_intervals_of_the_papers_estimator_hold_with_measured_noise_and_not_with_equation_15() -> None:
    errors, stated, paper = draws(300, "ols", periodic_block)
    assert 0.93 <= np.mean(np.abs(errors) < 1.96 * stated) <= 0.97
    assert np.mean(np.abs(errors) < 1.96 * paper) < 0.9


def test_intervals_hold_on_autoregressive_residuals_without_periods() -> None:
    """The residual's own power stands in for the noise: 80 s of rows, no period known."""
    errors, stated, paper = draws(500, "weighted", stretch_block)
    assert 0.93 <= np.mean(np.abs(errors) < 1.96 * stated) <= 0.97
    assert np.mean(np.abs(errors) < 1.96 * paper) < 0.9


def test_intervals_hold_where_one_period_was_recorded_and_its_noise_is_judged_from_the_residual() -> None:
    """Truth: Table 3 by Pinocchio; twelve draws of 57 parameters, which take up most residual where the motion is."""
    robot, samples, period_s = load_robot("iiwa14"), 1000, 10.0
    q, dq, ddq = fourier_motion(7, period_s=period_s, samples=samples, seed=100)
    torque = inverse_dynamics(robot, table_three(), q, dq, ddq)
    deviations = []
    for seed in range(12):
        noise = np.random.default_rng(seed).normal(scale=0.1, size=torque.shape)
        recording = recording_of(q, torque + noise, period_s=period_s)
        found = fit_recordings([recording], robot, FitSettings(physical=False, offset="no"))
        assert found.pipelines == ("periodic",)
        deviations.append((found.values - found.regressor.base_from_physical(table_three())) / found.std)
    assert np.mean(np.abs(deviations) < 1.96) > 0.91
    assert np.sqrt(np.mean(np.square(deviations))) < 1.15


def test_outliers_cost_little_when_bounded_and_much_when_not(bound: np.ndarray) -> None:
    generator = np.random.default_rng(3)
    spread = {}
    for bounded in (True, False):
        errors = []
        for _ in range(100):
            noise = coloured(generator, PERIODS * SAMPLES)
            noise = np.where(generator.random(noise.shape) < 0.02, 15.0 * noise, noise)
            result = estimate_parameters([periodic_block(noise, bound_outliers=bounded)], NAMES, "maximum_likelihood")
            errors.append(result.least_squares.values - TRUTH)
        spread[bounded] = np.median(np.sqrt(np.mean(np.square(errors), axis=0)) / bound)
    assert spread[True] < 1.15  # ±0.07 for one ratio of 100 draws, about ±0.02 for the median
    assert spread[False] > 1.3


def test_bounding_keeps_the_truth_of_clean_periods_and_marks_the_share_beyond() -> None:
    """Gaussian noise: 4.55 % lie beyond two deviations; the mean is that of the average within a tenth of its σ."""
    generator = np.random.default_rng(1)
    torque = generator.normal(scale=[1.0, 0.01], size=(16, 4000, 2))
    table = PeriodTable(torque, torque, np.arange(16), 4.0)
    bounded, beyond = bound_outliers_across_periods(table)
    np.testing.assert_allclose(beyond, 0.0455, atol=0.01)
    difference = average_periods(bounded).torque - average_periods(table).torque
    assert np.all(difference.std(axis=0) < 0.25 * torque.std(axis=(0, 1)) / 4.0)
    assert np.all(unclipped_share(torque, np.array([0.1, 0.1])) >= [0.5, 0.99])
    with pytest.raises(EstimationError, match="2 periods"):
        bound_outliers_across_periods(replace(table, torque=torque[:2]))


def test_outliers_cost_next_to_nothing_beside_the_same_noise_without_them() -> None:
    """Paired: the noise is the same, so 60 draws tell 2 %. Bounding alone costs the quiet joint 8 %."""
    generator = np.random.default_rng(8)
    errors: dict[bool, list[np.ndarray]] = {True: [], False: []}
    for _ in range(60):
        noise = coloured(generator, PERIODS * SAMPLES)
        wild = np.where(generator.random(noise.shape) < 0.02, 15.0 * noise, noise)
        for dirty in (True, False):
            block = periodic_block(wild if dirty else noise, bound_outliers=dirty)
            errors[dirty].append(estimate_parameters([block], NAMES, "maximum_likelihood").least_squares.values - TRUTH)
    with_them, without = (np.sqrt(np.mean(np.square(errors[dirty]), axis=0)) for dirty in (True, False))
    assert np.median(with_them / without) < 1.02
    assert np.max(with_them / without) < 1.05


def test_an_outlier_smaller_than_the_slow_noise_is_found_by_its_neighbours() -> None:
    generator = np.random.default_rng(4)
    slow = lfilter([np.sqrt(1.0 - 0.99**2)], [1.0, -0.99], generator.normal(size=9000))[1000:]
    torque = slow.reshape(8, 1000, 1).copy()
    hit = (np.arange(8), np.arange(8) * 97 + 30)
    torque[hit] += 1.0  # seven deviations of the step from sample to sample, one of the noise
    torque[2, 500] = np.nan
    cleaned, beyond, replaced = clean_across_periods(PeriodTable(torque, torque, np.arange(8), 10.0))
    truth = slow.reshape(8, 1000, 1)
    assert np.abs(cleaned.torque - truth)[hit].max() < 0.4
    untouched = np.isclose(cleaned.torque, torque, atol=1e-9)
    assert untouched.mean() > 0.99
    assert np.isnan(cleaned.torque[2, 500, 0])
    assert 8 / 8000 <= replaced[0] < 2.0 * 8 / 8000
    assert beyond[0] > 5.0 * replaced[0]


def test_periods_that_are_all_alike_stay_as_they_are() -> None:
    torque = np.tile(np.sin(np.arange(200))[None, :, None], (4, 1, 2))
    cleaned, _, replaced = clean_across_periods(PeriodTable(torque, torque, np.arange(4), 2.0))
    np.testing.assert_allclose(cleaned.torque, torque, atol=1e-12)
    assert not replaced.any()


def test_known_noise_is_used_and_misfit_takes_its_place_only_where_it_stands_out() -> None:
    block = periodic_block(coloured(np.random.default_rng(2), PERIODS * SAMPLES))
    noise = block.signals.row_noise
    assert noise is not None
    residual = noise.copy()
    np.testing.assert_allclose(variances_of(block, residual), noise**2)
    residual[100:120] *= 10.0
    variance = variances_of(block, residual)
    assert np.all(variance[105:115] > 50.0 * noise[105:115] ** 2)
    np.testing.assert_allclose(variance[:80], noise[:80] ** 2)


def test_lines_of_the_bound_and_of_the_block_are_the_same() -> None:
    block = periodic_block(np.zeros((PERIODS * SAMPLES, JOINTS)))
    lines = (len(block.torque) - 1) // 2
    np.testing.assert_allclose(block.columns[:, 1], to_lines(COLUMNS[:, 1], lines), atol=1e-12)
