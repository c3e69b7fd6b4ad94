"""Claims about the fit as a whole. Truth: Table 3 through Pinocchio's inverse dynamics, never our own regressor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from identification.errors import EstimationError, RecordingError, UndeterminedParametersError
from identification.estimators.feasibility import violations
from identification.physical_parameters import PhysicalParameters
from identification.recording_fit import FitSettings, Split, fit_recordings
from identification.recordings import Recording
from identification.recordings.joint_choice import for_robot
from identification.robots import RobotModel, load_robot
from identification.robots.locking import lock_joints
from tests.identification.synthetic import (
    coloured_noise,
    fourier_motion,
    inverse_dynamics,
    recording_of,
    table_three,
)
from tests.reference import TABLES

PERIOD_S, SAMPLES = 10.0, 2000


def _clean(seed: int = 1) -> Recording:
    robot = load_robot("iiwa14")
    q, dq, ddq = fourier_motion(7, period_s=PERIOD_S, samples=SAMPLES, seed=seed)
    return recording_of(q, inverse_dynamics(robot, table_three(), q, dq, ddq), period_s=PERIOD_S)


def _noisy(*, periods: int = 8, seed: int = 1, deviation: float = 0.2) -> Recording:
    clean = _clean(seed)
    torque = np.tile(clean.torque, (periods, 1))
    torque += coloured_noise(torque.shape, deviation=deviation, correlation=0.99, seed=100 + seed)
    position = np.tile(clean.position, (periods, 1))
    position += np.random.default_rng(200 + seed).normal(scale=2e-5, size=position.shape)
    return recording_of(position, torque, period_s=PERIOD_S, periods=periods)


def _table_two_sigma() -> dict[str, float]:
    """σ of the paper's Table 2: relative standard deviation times value (half a last digit for one printed as 0)."""
    sigma = {}
    for line in (TABLES / "table2_base_parameters.csv").read_text().splitlines()[1:]:
        name, value, percent = line.split(",")
        sigma[name] = max(abs(float(value)), 0.0005) * float(percent) / 100.0
    return sigma


def _bias_in_sigma(pipeline: str) -> np.ndarray:
    robot = load_robot("iiwa14")
    settings = FitSettings(pipeline=pipeline, physical=False)  # type: ignore[arg-type]
    result = fit_recordings([_clean()], robot, settings)
    truth = result.regressor.base_from_physical(table_three())
    sigma = _table_two_sigma()
    scale = np.array([sigma.get(name, np.nan) for name in result.names])
    assert np.isfinite(scale).all(), "every parameter of Table 2 is found under the paper's name"
    return np.abs(result.values - truth) / scale


def test_periodic_pipeline_is_unbiased_on_noise_free_data() -> None:
    assert _bias_in_sigma("periodic").max() < 0.05


def test_paper_chain_biases_by_several_sigma_on_the_same_data() -> None:
    bias = _bias_in_sigma("paper")
    assert np.median(bias) > 1.0
    assert bias.max() > 10.0


def test_sigma_holds_on_coloured_noise() -> None:
    """68 % of the errors within one σ, 95 % within two: here over 4 recordings × 57 parameters, noise of 0.5 s."""
    robot = load_robot("iiwa14")
    errors = []
    for seed in range(4):
        result = fit_recordings([_noisy(seed=seed)], robot, FitSettings(physical=False))
        truth = result.regressor.base_from_physical(table_three())
        errors.append((result.values - truth) / result.std)
    inside = np.abs(np.concatenate(errors))
    assert np.mean(inside < 2.0) > 0.88
    assert np.mean(inside < 3.0) > 0.97
    assert 0.6 < np.sqrt(np.mean(inside**2)) < 1.5


def test_equation_15_understates_sigma_on_coloured_noise() -> None:
    result = fit_recordings([_noisy()], load_robot("iiwa14"), FitSettings(physical=False))
    truth = result.regressor.base_from_physical(table_three())
    plain = fit_recordings([_noisy()], load_robot("iiwa14"), FitSettings(physical=False, estimator="ols"))
    np.testing.assert_array_equal(plain.values, plain.least_squares.values)
    np.testing.assert_array_equal(plain.equation_15_std, result.equation_15_std)
    assert np.sqrt(np.mean(((plain.values - truth) / plain.equation_15_std) ** 2)) > 1.5


def test_residual_of_the_mean_period_is_the_noise_floor() -> None:
    result = fit_recordings([_noisy()], load_robot("iiwa14"), FitSettings(physical=False))
    rms = result.rms.row("fit, base").rms_nm
    assert np.all(rms < 1.3 * result.noise_floor_nm)
    assert np.all(rms > 0.5 * result.noise_floor_nm)


def test_two_recordings_together_are_better_than_each_alone() -> None:
    robot = load_robot("iiwa14")
    recordings = [_noisy(seed=seed, periods=4) for seed in (1, 2)]
    settings = FitSettings(physical=False)
    alone = [fit_recordings([recording], robot, settings) for recording in recordings]
    together = fit_recordings(recordings, robot, settings)
    for result in alone:
        assert np.median(together.std / result.std) < 0.95
    assert len(together.provenance["inputs"]) == 2


def test_physical_parameters_are_feasible_and_cost_little() -> None:
    result = fit_recordings([_noisy()], load_robot("iiwa14"), FitSettings(starts=2))
    assert result.constrained is not None
    certificate = result.constrained.certificate
    assert violations(result.constrained.rules, result.constrained.physical, result.regressor.options.symbols) == ()
    assert certificate.lower_bound <= certificate.cost
    base, physical = result.rms.row("fit, base"), result.rms.row("fit, physical")
    assert physical.total_nm < 1.1 * base.total_nm


def test_inverted_torque_is_refused_and_can_be_turned() -> None:
    robot = load_robot("iiwa14")
    recording = _noisy(periods=3)
    inverted = replace(recording, torque=-recording.torque)
    with pytest.raises(RecordingError, match="opposite sign") as caught:
        fit_recordings([inverted], robot, FitSettings(physical=False))
    assert caught.value.exit_code == 65
    turned = fit_recordings([inverted], robot, FitSettings(physical=False, flip_torque=True))
    straight = fit_recordings([recording], robot, FitSettings(physical=False))
    np.testing.assert_allclose(turned.values, straight.values, rtol=1e-9, atol=1e-12)
    assert straight.torque_sign.gravity_correlation > 0.5


def test_one_joint_of_the_wrong_sign_makes_a_warning() -> None:
    """The others' torques contradict it, so that turning all of them would mend nothing."""
    robot = load_robot("iiwa14")
    recording = _noisy(periods=3)
    one = replace(recording, torque=recording.torque * np.where(np.arange(7) == 3, -1.0, 1.0))
    result = fit_recordings([one], robot, FitSettings(physical=False))
    assert result.notes[0].startswith("WARNING, inertia or friction of joint")
    sound = fit_recordings([recording], robot, FitSettings(physical=False))
    assert not any(note.startswith("WARNING") for note in sound.notes)


def test_a_joint_that_the_model_misses_altogether_is_said_with_the_fit() -> None:
    """The sensor of joint 3 turned round: no rigid arm has such a torque. Joint 7 is half noise anyway."""
    recording, robot = _noisy(periods=4), load_robot("iiwa14")
    turned = replace(recording, torque=recording.torque * [1, 1, -1, 1, 1, 1, 1])
    sound, missed = (fit_recordings([item], robot, FitSettings(physical=False)) for item in (recording, turned))
    assert missed.rms.row("fit, base").percent[2] > 100.0
    (said,) = [note for note in missed.to_model_json()["provenance"]["notes"] if "WARNING" in note]
    assert "nothing of joint 3: " in said
    assert "doctor --log" in said
    assert not any("WARNING" in note for note in sound.notes)


def test_the_same_motion_without_period_gives_the_same_parameters() -> None:
    """The aperiodic pipeline on noise-free data stays within 0.1 % of the torque and finds the same friction."""
    robot = load_robot("iiwa14")
    recording = _clean()
    aperiodic = fit_recordings([recording], robot, FitSettings(pipeline="aperiodic", physical=False))
    truth = aperiodic.regressor.base_from_physical(table_three())
    assert aperiodic.rms.row("fit, base").percent.max() < 0.1
    for joint in range(1, 8):
        column = aperiodic.regressor.position_of(f"FS_{joint}")
        assert aperiodic.values[column] == pytest.approx(truth[column], abs=2e-3)


def test_a_robot_at_rest_and_the_wrong_robot_are_refused() -> None:
    recording = _clean()
    robot = load_robot("iiwa14")
    still = replace(recording, position=np.zeros_like(recording.position))
    with pytest.raises(RecordingError, match="moves"):
        fit_recordings([still], robot)
    with pytest.raises(RecordingError, match="7"):
        fit_recordings([replace(recording, position=recording.position[:, :6], torque=recording.torque[:, :6])], robot)
    with pytest.raises(RecordingError, match="in A"):
        fit_recordings([replace(recording, torque_unit="A")], robot)
    for constant in (0.0, 3.0):
        torque = np.where(np.arange(7) == 2, constant, recording.torque)
        with pytest.raises(RecordingError, match="torque of joint 3 never changes") as caught:
            fit_recordings([replace(recording, torque=torque)], robot)
        assert (caught.value.field, caught.value.joint) == ("tau", 3)
    with pytest.raises(EstimationError):
        fit_recordings([], robot)


def test_a_motion_of_one_joint_names_what_it_leaves_undetermined() -> None:
    robot = load_robot("iiwa14")
    q, dq, ddq = fourier_motion(7, period_s=PERIOD_S, samples=SAMPLES, seed=1)
    for state in (q, dq, ddq):
        state[:, 1:] = 0.0
    recording = recording_of(q, inverse_dynamics(robot, table_three(), q, dq, ddq), period_s=PERIOD_S)
    with pytest.raises(UndeterminedParametersError) as caught:
        fit_recordings([recording], robot)
    assert caught.value.exit_code == 65
    assert "FV_3" in caught.value.parameters


def test_a_joint_that_stands_still_is_named_with_the_lock_that_lets_the_others_be_fitted() -> None:
    """Leaving rotor inertias out does not help: of the joint's friction no row tells anything."""
    robot = load_robot("iiwa14")
    q, dq, ddq = fourier_motion(7, period_s=PERIOD_S, samples=SAMPLES, seed=1)
    q[:, 2], dq[:, 2], ddq[:, 2] = 0.4, 0.0, 0.0
    recording = recording_of(q, inverse_dynamics(robot, table_three(), q, dq, ddq), period_s=PERIOD_S)
    with pytest.raises(UndeterminedParametersError, match=r"3 stands .*--lock A3=0\.4 --joints 1,2,4,5,6,7") as caught:
        fit_recordings([recording], robot, FitSettings(rotor_inertia="yes"))
    assert "--rotor-inertia" not in str(caught.value)
    locked = for_robot(recording, lock_joints(robot, {"A3": 0.4}), ["1", "2", "4", "5", "6", "7"])
    found = fit_recordings([locked], lock_joints(robot, {"A3": 0.4}), FitSettings(physical=False))
    values = dict(zip(found.names, found.values, strict=True))
    assert values["FV_3"] == pytest.approx(table_three().viscous[3], rel=1e-6)


def test_progress_runs_from_zero_to_one() -> None:
    seen: list[float] = []
    fit_recordings(
        [_clean()], load_robot("iiwa14"), FitSettings(physical=False),
        progress=lambda _, share: seen.append(share),
    )  # fmt: skip
    assert seen == sorted(seen)
    assert seen[-1] == 1.0


def test_splits_are_parsed_and_partition_the_time() -> None:
    time = np.linspace(0.0, 6.0, 601)
    first = Split.parse("first:0.6").held_out(time, 0.0, 6.0)
    assert first.sum() == 241
    assert not first[:360].any()
    blocks = Split.parse("blocks:0.5:3").held_out(time, 0.0, 6.0)
    assert blocks[101:149].all()
    assert not blocks[:100].any()
    for text in ("", "half", "first:1.5", "blocks:0.5", "blocks:0:3", "first:x"):
        with pytest.raises(EstimationError):
            Split.parse(text)


@pytest.mark.parametrize("split", ["blocks:50:3", "first:0.999"])
def test_a_split_that_holds_nothing_out_is_refused(split: str) -> None:
    """10 s of recording: the first 50 s are fitted, and what the low-pass leaves of the last 10 ms is no row."""
    with pytest.raises(RecordingError, match=f"'{split}' holds out no row of what lasts 9.995 s") as caught:
        fit_recordings([_clean()], load_robot("iiwa14"), FitSettings(split=split, physical=False))
    assert caught.value.exit_code == 65


def test_settings_that_do_not_exist_are_refused() -> None:
    with pytest.raises(EstimationError, match="pipeline"):
        FitSettings(pipeline="magic")  # type: ignore[arg-type]


def test_a_fit_warns_of_a_clock_that_runs_at_half_its_rate(iiwa14: RobotModel, table3: PhysicalParameters) -> None:
    """Inertias came out four times what they are, and only `doctor --log` said why."""
    q, dq, ddq = fourier_motion(7, period_s=20.0, samples=4000, seed=3)
    torque = inverse_dynamics(iiwa14, table3, q, dq, ddq)
    torque += 0.02 * np.random.default_rng(3).standard_normal(torque.shape)
    sound = recording_of(q, torque, period_s=20.0)
    slow = replace(sound, time=2.0 * sound.time, sampling_period_s=2.0 * sound.sampling_period_s, period_s=None,
                   period_index=None, sample_in_period=None, samples_per_period=None)  # fmt: skip
    settings = FitSettings(physical=False)
    told, silent = (
        [note for note in fit_recordings([each], iiwa14, settings).notes if "the time base is wrong" in note]
        for each in (slow, replace(sound, period_s=None, period_index=None, sample_in_period=None))
    )
    assert told[0].startswith("WARNING, synthetic.mcap: the time base is wrong")
    assert not silent
