"""Claims about folds over recordings; truth: which recording carries a fault, and the fit of the others by itself."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from identification.errors import EstimationError
from identification.fitting.misfit import notes_on_joints_missed, notes_on_models_contradicted
from identification.fitting.rms import RmsRow, RmsTable
from identification.mismatch.prediction import validate_with_effects
from identification.model_file import read_model, write_model
from identification.recording_fit import FitSettings, fit_recordings
from identification.recordings import Recording, read_recording
from identification.robots import load_robot
from identification.validation import cross_validate, validate_model
from tests.identification.synthetic import fourier_motion, inverse_dynamics, recording_of, table_three
from tests.reference import recording_file

BASE_ONLY = FitSettings(physical=False)
NOISE_NM = 0.05


@pytest.fixture(scope="module")
def recordings() -> list[Recording]:
    """Three runs in folders of their own, each with a motion of its own."""
    made = []
    for seed, name in ((1, "first"), (2, "second"), (3, "third")):
        q, dq, ddq = fourier_motion(7, period_s=10.0, samples=1000, seed=seed)
        torque = inverse_dynamics(load_robot("iiwa14"), table_three(), q, dq, ddq)
        torque += np.random.default_rng(seed).normal(scale=NOISE_NM, size=torque.shape)
        recording = recording_of(q, torque, period_s=10.0)
        made.append(replace(recording, source=replace(recording.source, path=f"runs/{name}/recording.mcap")))
    return made


@pytest.fixture(scope="module")
def table(recordings: list[Recording]) -> RmsTable:
    return cross_validate(recordings, load_robot("iiwa14"), BASE_ONLY)


def test_each_recording_is_scored_by_the_fit_of_the_others(recordings: list[Recording], table: RmsTable) -> None:
    assert len(table.rows) == 4
    fitted = fit_recordings(recordings[::2], load_robot("iiwa14"), BASE_ONLY)
    alone = validate_model(fitted, recordings[1:2])
    np.testing.assert_allclose(table.rows[1].rms_nm, alone.rows[0].rms_nm)
    together = np.sqrt(np.mean([row.rms_nm**2 for row in table.rows[:3]], axis=0))
    np.testing.assert_allclose(table.row("all left out, base").rms_nm, together)
    # A model of 57 parameters from 14000 values adds a few per cent to the noise of what it has not seen.
    np.testing.assert_allclose(together, NOISE_NM, rtol=0.15)


def test_a_recording_unlike_the_others_shows_where_it_is_left_out(recordings: list[Recording]) -> None:
    torque = recordings[2].torque.copy()
    torque[:, 4] += 0.4
    table = cross_validate([*recordings[:2], replace(recordings[2], torque=torque)], load_robot("iiwa14"), BASE_ONLY)
    assert table.rows[2].rms_nm[4] == pytest.approx(np.hypot(0.4, NOISE_NM), rel=0.1)
    assert max(row.rms_nm[4] for row in table.rows[:2]) < 0.3


def test_logs_of_the_same_name_are_told_apart_by_their_folders(table: RmsTable) -> None:
    assert [row.label for row in table.rows[:2]] == ["first/recording.mcap, base", "second/recording.mcap, base"]


@pytest.mark.parametrize("folds", [1, 4])
def test_folds_that_leave_nothing_to_fit_or_to_score_are_refused(recordings: list[Recording], folds: int) -> None:
    with pytest.raises(EstimationError, match="3 recordings"):
        cross_validate(recordings, load_robot("iiwa14"), BASE_ONLY, folds)


def test_a_model_that_leaves_more_than_the_torque_itself_is_said(recordings: list[Recording]) -> None:
    """Torques of the other sign: the model's make them twice as large."""
    robot = load_robot("iiwa14")
    fitted = fit_recordings(recordings[:1], robot, BASE_ONLY)
    turned = replace(recordings[1], torque=-recordings[1].torque)
    (said,) = notes_on_models_contradicted(validate_model(fitted, [turned]))
    assert said.startswith("WARNING, ")
    assert "more than no model would" in said
    assert not notes_on_models_contradicted(validate_model(fitted, recordings[1:2]))


def test_a_warning_of_a_joint_that_is_missed_says_which_parameters_miss_it() -> None:
    """Torques in kNm have base parameters, and no body: what least squares leave is noise."""
    torque, noise = np.array([10.0, 5.0]), np.array([0.1, 0.1])
    near, far = np.array([0.1, 0.11]), np.array([0.2, 40.0])
    both = RmsTable((RmsRow("fit, base", near, torque, noise), RmsRow("fit, physical", far, torque, noise)))
    (said,) = notes_on_joints_missed(both)
    assert said.startswith("WARNING, the feasible set, not the base parameters, describes nothing of joint 2")
    assert "800 %" in said
    (said,) = notes_on_joints_missed(RmsTable((RmsRow("fit, base", far, torque, noise),)))
    assert said.startswith("WARNING, the model describes nothing of joint 2")


@pytest.mark.parametrize("effects", [False, True])
def test_a_slower_recording_is_compared_up_to_what_its_rate_allows(tmp_path: Path, effects: bool) -> None:
    """The band of the fit did not fit it, and the refusal advised another one, which nobody can give here."""
    first, second = (read_recording(recording_file(f"emps_{name}.npz")) for name in "ab")
    robot = load_robot(recording_file("emps.urdf"))
    data = fit_recordings([first], robot, replace(BASE_ONLY, low_pass_hz=20.0)).to_model_json(notes=False)
    if effects:
        model = {"other_joint": None, "shape": {}, "coefficients": [0.0]}
        data["effects"] = [{"effect": "asymmetric_viscous_friction", "joint": 1, "link": None, "model": model}]
    model = read_model(write_model(data, tmp_path / "model.json"))
    slow = second.rows(np.arange(second.samples) % 25 == 0)
    slow = replace(slow, sampling_period_s=25.0 * second.sampling_period_s)
    assert 1.0 / slow.sampling_period_s / 2.5 < 20.0
    # 4.4 % at the full rate; every 25th row has the noise of all frequencies in its band.
    assert validate_with_effects(model, [slow]).rows[0].percent[0] < 15.0
