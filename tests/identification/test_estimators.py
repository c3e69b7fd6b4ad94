"""Estimators by name: efficiency against the Cramér–Rao bound, intervals that hold, outliers, delays, position noise.

Truth: known parameters, closed-form information of the noise that was drawn, Pinocchio's inverse dynamics. The full
Monte Carlo with 1000 draws and 57 parameters is `python -m benchmarks.estimators`; here a small linear model of three
joints goes through the same functions, so that hundreds of draws cost seconds.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.signal import lfilter
from typer.testing import CliRunner

import daemon.cli.analysis  # noqa: F401  registers the command
from daemon.cli.app import app
from daemon.errors import ConfigurationError
from identification.base_parameters import BaseRegressor
from identification.errors import EstimationError
from identification.estimators.observation import CompressedObservation
from identification.fitting.blocks import Block, variances_of
from identification.fitting.estimate import estimate_parameters
from identification.recording_fit import FitSettings, fit_recordings
from identification.recordings import Recording
from identification.robots import load_robot
from identification.signals import average_periods, process_periodic
from identification.signals.outliers import bound_outliers_across_periods, clean_across_periods, unclipped_share
from identification.signals.periodic import to_lines
from identification.signals.periods import PeriodTable
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


# The robot: 57 parameters, torque by Pinocchio


def iiwa_recording(*, delay: np.ndarray | float = 0.0, seed: int = 1, periods: int = 4) -> Recording:
    """Periods of the random motion with a little noise; each joint's torque later by its delay (s)."""
    samples, period_s = 2000, 10.0
    q, dq, ddq = fourier_motion(7, period_s=period_s, samples=samples, seed=seed)
    torque = inverse_dynamics(load_robot("iiwa14"), table_three(), q, dq, ddq)
    turn = np.exp(-2j * np.pi * np.fft.rfftfreq(samples, period_s / samples)[:, None] * delay)
    torque = np.fft.irfft(np.fft.rfft(torque, axis=0) * turn, n=samples, axis=0)
    noise = np.random.default_rng(seed).normal(scale=0.05, size=(periods * samples, 7))
    measured = np.tile(torque, (periods, 1)) + noise
    return recording_of(np.tile(q, (periods, 1)), measured, period_s=period_s, periods=periods)


@pytest.mark.parametrize("pipeline", ["periodic", "aperiodic"])
def test_a_delay_is_measured_per_joint_and_its_correction_gives_the_parameters_back(pipeline: str) -> None:
    robot = load_robot("iiwa14")
    late = 1e-3 * np.array([2.0, 3.0, 0.0, -1.0, 2.0, 4.0, 2.0])
    recording = iiwa_recording(delay=late)
    settings = FitSettings(pipeline=pipeline, physical=False)  # type: ignore[arg-type]
    plain = fit_recordings([recording], robot, settings)
    delay = plain.torque_delay
    assert np.all(np.abs(delay.per_joint - late) < 4.0 * delay.per_joint_std + 2e-5)
    assert np.all(delay.per_joint_std[:4] < 1e-3)
    corrected = fit_recordings([recording], robot, replace(settings, delay_correction="per_joint"))
    truth = plain.regressor.base_from_physical(table_three())
    before, after = ((result.values - truth) / plain.std for result in (plain, corrected))
    assert np.abs(before).max() > 8.0
    assert np.abs(after).max() < 5.0
    # A delay of a joint's weight is torque that goes with its velocity, as viscous friction is: known less surely.
    expected = white_noise_std(corrected.regressor)
    friction = corrected.regressor.names.index("FV_2")
    assert corrected.std[friction] == pytest.approx(expected[friction], rel=0.35)


def white_noise_std(regressor: BaseRegressor) -> np.ndarray:
    """(p,) of `iiwa_recording`'s white noise where each joint's delay is unknown too: σ² (Aᵀ A)⁻¹, A with its rates."""
    q, dq, ddq = fourier_motion(7, period_s=10.0, samples=2000, seed=1)
    torque = inverse_dynamics(load_robot("iiwa14"), table_three(), q, dq, ddq)
    turn = 2j * np.pi * np.fft.rfftfreq(2000, 10.0 / 2000)[:, None]
    rate = np.fft.irfft(turn * np.fft.rfft(torque, axis=0), n=2000, axis=0)
    columns = np.concatenate([regressor.matrix(q, dq, ddq), rate[:, :, None] * np.eye(7)], axis=2)
    rows = columns.reshape(-1, columns.shape[2])
    deviation = np.sqrt(np.diag(np.linalg.inv(rows.T @ rows)))
    return np.asarray(0.05 / np.sqrt(4) * deviation[: regressor.size])


@pytest.mark.parametrize("pipeline", ["periodic", "aperiodic"])
def test_a_delay_that_is_no_small_change_of_the_torque_is_measured(pipeline: str) -> None:
    """With periods up to 60 Hz are compared, where it is more than a turn; without, it is as long as friction turns."""
    recording = iiwa_recording(delay=0.025)
    settings = FitSettings(pipeline=pipeline, physical=False)  # type: ignore[arg-type]
    late = fit_recordings([recording], load_robot("iiwa14"), settings).torque_delay
    assert abs(late.common - 0.025) < 4.0 * late.std_between_joints < 1e-3
    assert np.all(np.abs(late.per_joint - 0.025) < 4.0 * late.per_joint_std)


def test_a_delay_of_many_samples_is_taken_off_where_periods_repeat() -> None:
    recording = iiwa_recording(delay=0.025)
    settings = FitSettings(pipeline="periodic", physical=False, delay_correction="common")
    result = fit_recordings([recording], load_robot("iiwa14"), settings)
    delay = result.torque_delay
    assert abs(delay.common - 0.025) < 4.0 * delay.common_std < 3e-4
    assert np.all(result.rms.rows[0].rms_nm < 1.1 * 0.05 / np.sqrt(4))  # the noise of the mean of four periods


def test_the_paper_s_chain_shows_a_delay_though_its_filter_took_the_steps_of_friction_out_of_the_torque() -> None:
    settings = FitSettings(pipeline="paper", physical=False)
    late, plain = (
        fit_recordings([iiwa_recording(delay=delay)], load_robot("iiwa14"), settings).torque_delay
        for delay in (0.025, 0.0)
    )
    assert late.common - plain.common == pytest.approx(0.025, abs=0.003)
    assert abs(late.common - 0.025) < 3.0 * late.common_std  # what the chain leaves looks like a delay, too


def test_without_delay_none_is_claimed() -> None:
    result = fit_recordings([iiwa_recording()], load_robot("iiwa14"), FitSettings(physical=False))
    delay = result.torque_delay
    assert abs(delay.common) < 4.0 * delay.common_std
    assert delay.common_std < 2e-4
    assert "ms" in delay.sentence()


def test_huber_survives_outliers_with_and_without_periods() -> None:
    robot = load_robot("iiwa14")
    clean = iiwa_recording(periods=2)
    generator = np.random.default_rng(4)
    wild = generator.random(clean.torque.shape) < 0.02
    spoiled = replace(clean, torque=clean.torque + np.where(wild, generator.normal(scale=3.0, size=wild.shape), 0.0))
    for pipeline in ("periodic", "aperiodic"):
        settings = FitSettings(pipeline=pipeline, physical=False)  # type: ignore[arg-type]
        fits = {
            name: fit_recordings([spoiled], robot, replace(settings, estimator=name))  # type: ignore[arg-type]
            for name in ("huber", "weighted")
        }
        reference = fit_recordings([clean], robot, settings)
        away = {name: np.median(np.abs(fit.values - reference.values) / reference.std) for name, fit in fits.items()}
        assert away["huber"] < 0.5 * away["weighted"], pipeline
        assert fits["huber"].estimator == "huber"
        assert fits["huber"].to_model_json()["provenance"]["estimator"] == "huber"


def test_instruments_take_away_the_bias_that_position_noise_makes() -> None:
    """White position noise of 0.5 mrad, differentiated twice below 10 Hz: the mean error of some draws is the bias."""
    robot = load_robot("iiwa14")
    errors: dict[str, list[np.ndarray]] = {"weighted": [], "instrumental": []}
    clean = iiwa_recording(periods=2)
    for seed in range(4):
        noise = np.random.default_rng(900 + seed).normal(scale=5e-4, size=clean.position.shape)
        noisy = replace(clean, position=clean.position + noise, command_position=clean.position)
        for name, kept in errors.items():
            settings = FitSettings(physical=False, estimator=name, pipeline="aperiodic")  # type: ignore[arg-type]
            result = fit_recordings([noisy], robot, settings)
            kept.append(result.values - result.regressor.base_from_physical(table_three()))
    bias = {name: np.abs(np.mean(kept, axis=0)) for name, kept in errors.items()}
    assert np.median(bias["instrumental"]) < 0.4 * np.median(bias["weighted"])
    assert bias["instrumental"].max() < 0.1 * bias["weighted"].max()


def test_halves_of_the_periods_serve_as_instruments_and_the_stated_deviation_holds() -> None:
    robot = load_robot("iiwa14")
    errors = []
    for seed in range(3):
        clean = iiwa_recording(seed=seed)
        noise = np.random.default_rng(seed).normal(scale=2e-4, size=clean.position.shape)
        noisy = replace(clean, position=clean.position + noise)
        result = fit_recordings([noisy], robot, FitSettings(physical=False, estimator="instrumental"))
        truth = result.regressor.base_from_physical(table_three())
        errors.append((result.values - truth) / result.std)
    assert 0.6 < np.sqrt(np.mean(np.square(errors))) < 1.5


def test_instruments_need_a_second_measurement_of_the_motion() -> None:
    recording = iiwa_recording(periods=1)
    settings = FitSettings(physical=False, estimator="instrumental", pipeline="aperiodic")
    with pytest.raises(EstimationError, match="commanded position"):
        fit_recordings([recording], load_robot("iiwa14"), settings)
    commanded = replace(recording, command_position=recording.position)
    same = fit_recordings([commanded], load_robot("iiwa14"), settings)
    plain = fit_recordings([recording], load_robot("iiwa14"), replace(settings, estimator="weighted"))
    np.testing.assert_allclose(same.values, plain.values, rtol=1e-6, atol=1e-8)


def test_lines_of_the_bound_and_of_the_block_are_the_same() -> None:
    block = periodic_block(np.zeros((PERIODS * SAMPLES, JOINTS)))
    lines = (len(block.torque) - 1) // 2
    np.testing.assert_allclose(block.columns[:, 1], to_lines(COLUMNS[:, 1], lines), atol=1e-12)


def test_the_command_line_takes_estimator_bounds_and_consistency(tmp_path: Path) -> None:
    recording = iiwa_recording()
    log, bounds, model = tmp_path / "log.npz", tmp_path / "bounds.yaml", tmp_path / "model.json"
    np.savez(log, t=recording.time, q=recording.position, tau=recording.torque, period_s=10.0, robot="iiwa14")
    bounds.write_text("mass: [0.5, 9]\nviscous: [0.05, null]\n")
    words = [
        "fit",
        str(log),
        "--estimator",
        "huber",
        "--bounds",
        str(bounds),
        "--full-consistency",
        "--out",
        str(model),
    ]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0, result.output
    for text in ("σ, eq. (15)", "fully physically consistent", "huber", "The torque comes", "made of matter"):
        assert text in result.output
    written = json.loads(model.read_text())
    assert written["provenance"]["estimator"] == "huber"
    assert written["provenance"]["settings"]["bounds"]["mass"] == [0.5, 9]
    assert written["provenance"]["torque_delay"]["common_std_s"] > 0.0
    assert min(link["mass"] for link in written["physical_parameters"]) >= 0.5
    assert "feasible" in written["certificate"]["base_parameters"]
    bounds.write_text("weight: [0.5, 9]\n")
    refused = CliRunner().invoke(app, ["fit", str(log), "--bounds", str(bounds)])
    assert isinstance(refused.exception, ConfigurationError)
    assert "weight" in str(refused.exception)
