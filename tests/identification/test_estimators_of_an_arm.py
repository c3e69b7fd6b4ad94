"""Estimators by name on an arm: delays, outliers, position noise, and what the command writes.

Truth: 57 known parameters, torque by Pinocchio's inverse dynamics.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import daemon.cli.analysis  # noqa: F401  registers the command
from daemon.cli.app import app
from daemon.errors import ConfigurationError
from identification.base_parameters import BaseRegressor
from identification.errors import EstimationError
from identification.recording_fit import FitSettings, fit_recordings
from identification.recordings import Recording
from identification.robots import load_robot
from tests.identification.synthetic import fourier_motion, inverse_dynamics, recording_of, table_three


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
