"""Claims about model.json and the validation of models. Truth: the contract's fields, Table 3 by Pinocchio."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from identification.base_parameters import BaseRegressor, RegressorOptions
from identification.errors import ModelFileError, ModelFileNotFoundError
from identification.export.parameters import parameters_of
from identification.model_file import read_model, write_model
from identification.recording_fit import FitResult, FitSettings, fit_recordings
from identification.robots import load_robot
from identification.validation import validate_model
from tests.identification.exported import model_of, random_arm, random_bodies
from tests.identification.synthetic import fourier_motion, inverse_dynamics, recording_of, table_three

CONTRACT_KEYS = {
    "format", "robot", "base_parameters", "physical_parameters", "friction", "effects", "rms_nm", "certificate",
    "provenance",
}  # fmt: skip
WRONG_SETTINGS: tuple[dict[str, Any], ...] = (
    {"pipeline": "nope"}, {"split": 7}, {"split": "half"}, {"low_pass_hz": -5.0}, {"low_pass_hz": True},
    {"motion_bandwidth_hz": None}, {"torque_bandwidth_hz": "60 Hz"}, {"flip_torque": "maybe"},
)  # fmt: skip


def _result(seed: int = 1) -> FitResult:
    robot = load_robot("iiwa14")
    q, dq, ddq = fourier_motion(7, period_s=10.0, samples=1000, seed=seed)
    torque = inverse_dynamics(robot, table_three(), q, dq, ddq)
    torque += np.random.default_rng(seed).normal(scale=0.1, size=torque.shape)
    return fit_recordings([recording_of(q, torque, period_s=10.0)], robot, FitSettings(starts=1))


@pytest.fixture(scope="module")
def result() -> FitResult:
    return _result()


def test_model_has_the_contracts_fields(result: FitResult, tmp_path: Path) -> None:
    path = write_model(result.to_model_json(), tmp_path / "model.json")
    data = json.loads(path.read_text())
    assert set(data) >= CONTRACT_KEYS
    assert data["format"] == "iiwa-ident/model/1"
    assert data["robot"] == "iiwa14"
    assert [set(item) >= {"name", "value", "std", "unit"} for item in data["base_parameters"]] == [True] * 57
    assert [item["link"] for item in data["physical_parameters"]] == list(range(1, 8))
    assert [item["joint"] for item in data["friction"]] == list(range(1, 8))
    assert len(data["rms_nm"]["fit"]) == 7
    assert data["provenance"]["inputs"][0]["sha256"] == result.recordings[0].source.sha256
    assert data["provenance"]["seed"] == result.settings.seed
    assert data["provenance"]["versions"]["numpy"] == np.__version__


def test_model_is_read_back_bit_by_bit(result: FitResult, tmp_path: Path) -> None:
    model = read_model(write_model(result.to_model_json(), tmp_path / "model.json"))
    np.testing.assert_array_equal(model.values, result.values)
    np.testing.assert_array_equal(model.std, result.std)
    assert model.names == result.names
    assert model.physical is not None
    assert result.physical is not None
    np.testing.assert_array_equal(model.physical.inertia, result.physical.inertia)
    np.testing.assert_array_equal(model.physical.coulomb, result.physical.coulomb)


def test_validation_of_the_file_equals_validation_of_the_fit(result: FitResult, tmp_path: Path) -> None:
    """And the RMS on an unused noise-free motion is far below the noise that the fit had."""
    robot = load_robot("iiwa14")
    q, dq, ddq = fourier_motion(7, period_s=10.0, samples=1000, seed=77)
    unused = recording_of(q, inverse_dynamics(robot, table_three(), q, dq, ddq), period_s=10.0)
    model = read_model(write_model(result.to_model_json(), tmp_path / "model.json"))
    from_file, from_fit = validate_model(model, [unused]), validate_model(result, [unused])
    for ours, theirs in zip(from_file.rows, from_fit.rows, strict=True):
        assert ours.label == theirs.label
        np.testing.assert_allclose(ours.rms_nm, theirs.rms_nm, rtol=1e-9)
    base = from_fit.row("synthetic.mcap, base")
    assert base.rms_nm.max() < 0.06
    assert base.total_nm == pytest.approx(base.rms_nm.sum())


def test_rms_is_the_root_mean_square_of_measured_minus_modelled(result: FitResult) -> None:
    """Against a plain sum over samples: true torque plus a known constant error of 0.5 Nm on joint 3."""
    robot = load_robot("iiwa14")
    truth = BaseRegressor(robot).base_from_physical(table_three())
    q, dq, ddq = fourier_motion(7, period_s=10.0, samples=1000, seed=5)
    torque = inverse_dynamics(robot, table_three(), q, dq, ddq)
    measured = torque.copy()
    measured[:, 2] += 0.5
    data = result.to_model_json()
    for item, value in zip(data["base_parameters"], truth, strict=True):
        item["value"] = float(value)
    rows = _validated(data, recording_of(q, measured, period_s=10.0))
    np.testing.assert_allclose(rows.rms_nm, [0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 0.0], atol=1e-7)
    np.testing.assert_allclose(rows.torque_rms_nm, np.sqrt(np.mean(measured**2, axis=0)), rtol=1e-9)
    assert rows.total_nm == pytest.approx(0.5, abs=1e-6)


def _validated(data: dict[str, Any], recording: Any) -> Any:
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        model = read_model(write_model(data, Path(folder) / "model.json"))
        return validate_model(model, [recording]).row("synthetic.mcap, base")


def test_drives_of_the_physical_set_are_part_of_its_torque(tmp_path: Path) -> None:
    """A motor-side plant: the physical line of the file equals that of the fit only if IA and OFF are read back."""
    robot = load_robot("iiwa14")
    q, dq, ddq = fourier_motion(7, period_s=10.0, samples=1000, seed=1)
    torque = inverse_dynamics(robot, table_three(), q, dq, ddq) + 0.4 * ddq + 0.7
    recording = recording_of(q, torque, period_s=10.0)
    fitted = fit_recordings([recording], robot, FitSettings(rotor_inertia="yes", offset="yes", starts=1))
    offsets = [fitted.values[fitted.regressor.position_of(f"OFF_{joint}")] for joint in range(1, 8)]
    np.testing.assert_allclose(offsets, 0.7, atol=1e-6)
    model = read_model(write_model(fitted.to_model_json(), tmp_path / "model.json"))
    assert model.options == RegressorOptions(rotor_inertia=True, offset=True)
    ours, theirs = validate_model(model, [recording]), validate_model(fitted, [recording])
    label = "synthetic.mcap, physical"
    np.testing.assert_allclose(ours.row(label).rms_nm, theirs.row(label).rms_nm, rtol=1e-6, atol=1e-9)


def test_a_missing_or_spoilt_model_is_refused_with_the_field(result: FitResult, tmp_path: Path) -> None:
    with pytest.raises(ModelFileNotFoundError) as missing:
        read_model(tmp_path / "none.json")
    assert missing.value.exit_code == 66
    data = result.to_model_json()
    spoilt: list[tuple[str, Any, str]] = [
        ("format", "other/1", "format"),
        ("base_parameters", [], "base_parameters"),
        ("base_parameters", [{"name": "ZZR_1", "value": "x", "std": 1, "unit": ""}], "base_parameters"),
        ("physical_parameters", [{"link": 1, "mass": 1.0}], "physical_parameters"),
        ("friction", [{"joint": 2, "viscous": 1, "coulomb": 1}], "friction"),
        # As a file looks that was edited by hand.
        ("base_parameters", [*data["base_parameters"], data["base_parameters"][0]], "base_parameters"),
        ("base_parameters", [{**data["base_parameters"][0], "std": -1.0}], "base_parameters"),
        ("friction", [{**item, "coulomb": float("nan")} for item in data["friction"]], "friction"),
        (
            "physical_parameters",
            [{**item, "mass": np.inf} for item in data["physical_parameters"]],
            "physical_parameters",
        ),
        ("drives", [{"joint": 1, "rotor_inertia": 0.4, "offset": 0.0}], "drives"),
        ("effects", None, "effects"),
        ("effects", [{"effect": "payload"}], "effects"),
        ("provenance", None, "provenance"),
        ("provenance", {"inputs": ["a.mcap"]}, "provenance.inputs"),
        ("provenance", {"inputs": [{"rows_kept": "15 AAAA"}]}, "provenance.inputs"),
        ("provenance", {"settings": "auto"}, "provenance.settings"),
        *(("provenance", {"settings": wrong}, "provenance.settings") for wrong in WRONG_SETTINGS),
        ("provenance", {"torque_shift_s": "late"}, "provenance.torque_shift_s"),
        ("provenance", {"torque_shift_s": [0.001, "x"]}, "provenance.torque_shift_s"),
        ("provenance", {"torque_shift_s": [[0.001]] * 7}, "provenance.torque_shift_s"),
        ("provenance", {"speed_rms": [-0.1] * 7}, "provenance.speed_rms"),
        (
            "physical_parameters",
            [{**item, "mass": -item["mass"]} for item in data["physical_parameters"]],
            "physical_parameters",
        ),
    ]
    for number, (key, value, named) in enumerate(spoilt):
        path = tmp_path / f"{number}.json"
        path.write_text(json.dumps({**data, key: value}))
        with pytest.raises(ModelFileError) as caught:
            read_model(path)
        assert caught.value.exit_code == 65
        assert caught.value.field == named
    (tmp_path / "letters.json").write_text("not json")
    with pytest.raises(ModelFileError, match="JSON"):
        read_model(tmp_path / "letters.json")


def test_a_delay_of_other_joints_is_refused(result: FitResult, tmp_path: Path) -> None:
    data = result.to_model_json()
    data["provenance"]["torque_shift_s"] = [0.002] * 3
    with pytest.raises(ModelFileError, match="3 numbers, the robot 7 joints") as caught:
        _validated(data, result.recordings[0])
    assert caught.value.field == "provenance.torque_shift_s"


def test_a_model_without_any_deviation_is_no_ground_for_bodies(result: FitResult, tmp_path: Path) -> None:
    """A fit's values are off by its noise: no arm has exactly these, and σ = 0 allows for no others."""
    data = result.to_model_json()
    data |= {"base_covariance": [], "base_parameters": [{**item, "std": 0.0} for item in data["base_parameters"]]}
    with pytest.raises(ModelFileError, match="every 'std' is zero") as caught:
        parameters_of(read_model(write_model(data, tmp_path / "model.json")))
    assert (caught.value.exit_code, caught.value.field) == (65, "base_parameters")


def test_a_model_of_another_robot_is_refused(result: FitResult, tmp_path: Path) -> None:
    data = result.to_model_json()
    data["base_parameters"] = data["base_parameters"][:-1]
    model = read_model(write_model(data, tmp_path / "model.json"))
    with pytest.raises(ModelFileError, match="missing"):
        model.base_values(BaseRegressor(load_robot("iiwa14")))


def test_numbers_that_json_does_not_know_are_not_written(result: FitResult, tmp_path: Path) -> None:
    data = result.to_model_json()
    data["base_parameters"][0]["value"] = float("nan")
    with pytest.raises(ModelFileError, match="not finite"):
        write_model(data, tmp_path / "model.json")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("option", ["viscous", "coulomb", "rotor_inertia", "offset", "coulomb_velocity"])
def test_every_option_of_the_regressor_survives_the_file(result: FitResult, tmp_path: Path, option: str) -> None:
    """Each turned from its default in turn: what a model.json does not note is lost to all who read it."""
    plain = RegressorOptions().to_json()
    turned = RegressorOptions(**{**plain, option: 0.02 if option == "coulomb_velocity" else not plain[option]})  # type: ignore[arg-type]
    data = result.to_model_json()
    noted = {**data, "provenance": {**data["provenance"], "regressor": turned.to_json()}}
    assert read_model(write_model(noted, tmp_path / "model.json")).options == turned
    assert set(plain) == {field.name for field in fields(RegressorOptions)}


def test_a_width_of_friction_that_is_no_number_is_refused(result: FitResult, tmp_path: Path) -> None:
    data = result.to_model_json()
    data["provenance"]["regressor"] = {"coulomb_velocity": -0.01}
    with pytest.raises(ModelFileError, match="coulomb_velocity"):
        read_model(write_model(data, tmp_path / "model.json"))


def test_a_model_finds_its_robot_from_anywhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It named the URDF as the shell did that fitted it, and was lost in any other folder."""
    (tmp_path / "arms").mkdir()
    (tmp_path / "arms" / "arm.urdf").write_text(random_arm(3, 1))
    (tmp_path / "fits").mkdir()
    monkeypatch.chdir(tmp_path / "arms")
    written = model_of(tmp_path / "fits", "arm.urdf", random_bodies(3, 2))
    assert written.data["robot"] == "../arms/arm.urdf"
    (tmp_path / "arms" / "fits").mkdir()
    monkeypatch.chdir(tmp_path / "arms" / "fits")
    assert read_model(tmp_path / "fits" / "model.json").load_robot().n == 3
    old = replace(written, robot="../arm.urdf")  # as earlier versions wrote it, from another folder
    assert old.load_robot().n == 3
