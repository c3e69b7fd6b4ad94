"""Claims about a given model against recordings. Truth: the simulators' own inverse dynamics, and a concealed plant."""

from __future__ import annotations

import importlib.util
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from daemon.cli.diagnosis import set_up_lines
from identification.audit.leaderboard import leaderboard
from identification.base_parameters import BaseRegressor, RegressorOptions
from identification.errors import ModelFileError, RobotError, RobotNotFoundError
from identification.export.write import export_model
from identification.export.write_back import write_back
from identification.interface import Answer
from identification.mismatch.baseline import baseline_values
from identification.mismatch.diagnosis import diagnose
from identification.model_file import Model
from identification.physical_parameters import PhysicalParameters
from identification.recordings.reader import Inputs
from identification.report.comparison_section import comparison_section
from identification.report.document import Paragraph
from identification.robots import RobotModel, load_robot
from identification.robots.simulator_models import read_simulator_model, read_with_drives
from tests.identification.exported import consistent, model_of
from tests.identification.mismatch.plant import on_joint, record
from tests.identification.synthetic import fourier_motion, inverse_dynamics, recording_of


def _model_of_base(iiwa14_base: BaseRegressor, values: np.ndarray) -> Model:
    size = iiwa14_base.size
    empty = np.zeros(0)
    return Model(
        "iiwa14", iiwa14_base.names, values, np.ones(size), iiwa14_base.units, None, empty, empty, iiwa14_base.options
    )


@pytest.mark.parametrize("form", ["urdf", "mjcf", "sdf"])
def test_a_simulator_s_file_has_the_base_parameters_it_was_written_from(
    tmp_path: Path, iiwa14_base: BaseRegressor, table3: PhysicalParameters, form: str
) -> None:
    if form == "sdf" and importlib.util.find_spec("pydrake") is None:
        pytest.skip("SDF is read by Drake, which is not installed")
    file = tmp_path / f"arm.{form}"
    export_model(model_of(tmp_path, "iiwa14", consistent(table3)), file, form, parameter_set="physical")
    expected = iiwa14_base.base_from_physical(consistent(table3))
    assert np.allclose(read_simulator_model(file, iiwa14_base), expected, atol=1e-6)


def test_rotor_inertias_of_a_urdf_are_read_from_drakes_tags(tmp_path: Path, table3: PhysicalParameters) -> None:
    """Where export puts them: read without them, the arm was said to carry a load."""
    rotor = np.array([0.4, 0.4, 0.2, 0.2, 0.1, 0.05, 0.05])
    file = tmp_path / "arm.urdf"
    export_model(model_of(tmp_path, "iiwa14", consistent(table3), rotor=rotor), file, "urdf", parameter_set="physical")
    for geared in (False, True):
        if geared:  # the same, as a motor behind a gear has it
            text = file.read_text().replace('gear_ratio value="1.0"', 'gear_ratio value="100.0"')
            file.write_text(re.sub(r'(rotor_inertia value=")([^"]+)', lambda m: f"{m[1]}{float(m[2]) / 1e4!r}", text))
        base, values = read_with_drives(file, load_robot("iiwa14"))
        found = [values[base.names.index(f"IA_{joint}")] for joint in range(3, 8)]
        assert found == pytest.approx(rotor[2:], rel=1e-6)


def test_a_file_that_moves_otherwise_is_refused_with_the_joint(
    tmp_path: Path, iiwa14_base: BaseRegressor, table3: PhysicalParameters
) -> None:
    file = tmp_path / "arm.urdf"
    export_model(model_of(tmp_path, "iiwa7", consistent(table3)), file, "urdf", parameter_set="physical")
    with pytest.raises(RobotError, match="zero positions, axes, lengths"):
        read_simulator_model(file, iiwa14_base)
    with pytest.raises(RobotNotFoundError):
        read_simulator_model(tmp_path / "absent.urdf", iiwa14_base)


def test_a_model_json_without_some_inertia_is_refused(iiwa14_base: BaseRegressor) -> None:
    whole = _model_of_base(iiwa14_base, np.ones(iiwa14_base.size))
    keep = [index for index, name in enumerate(iiwa14_base.names) if name != "MX_7"]
    with pytest.raises(ModelFileError, match="MX_7"):
        baseline_values(
            replace(whole, names=tuple(whole.names[i] for i in keep), values=whole.values[keep]), iiwa14_base
        )


def test_a_lift_s_model_without_offsets_is_compared_with_parameters_that_have_one(tmp_path: Path) -> None:
    """The motor's torque of a vertical lift is m (q̈ + g) + J q̈: with an offset, m and J are grouped otherwise."""
    file = tmp_path / "lift.urdf"
    file.write_text(
        '<robot name="lift"><link name="base"/><link name="cage"/><joint name="lift" type="prismatic">'
        '<parent link="base"/><child link="cage"/><axis xyz="0 0 1"/>'
        '<limit lower="0" upper="1" effort="100" velocity="1"/></joint></robot>'
    )
    lift, mass, rotor = load_robot(file), 3.0, 1.5
    own, asked = (BaseRegressor(lift, RegressorOptions(rotor_inertia=True, offset=offset)) for offset in (False, True))
    values = np.array([{"M_1": mass, "IA_1": rotor}.get(name.replace("R_", "_"), 0.0) for name in own.names])
    model = Model("lift", own.names, values, values, own.units, None, np.zeros(0), np.zeros(0), own.options)
    q, acceleration = np.zeros((4, 1)), np.array([[-2.0], [0.0], [1.0], [5.0]])
    torque = asked.matrix(q, q, acceleration) @ baseline_values(model, asked)[1]
    assert torque == pytest.approx(mass * (acceleration + 9.81) + rotor * acceleration)


def test_one_wrong_parameter_is_told_from_missing_friction(
    iiwa14: RobotModel, iiwa14_base: BaseRegressor, table3: PhysicalParameters
) -> None:
    """The model is wrong in MX_7; the plant has a Stribeck friction on joint 2 that no parameter holds."""

    def hidden(_q: np.ndarray, dq: np.ndarray, _torque: np.ndarray) -> np.ndarray:
        return on_joint(2, np.sign(dq[:, 1]) * 0.6 * np.exp(-((dq[:, 1] / 0.05) ** 2)))

    recording = record(iiwa14, table3, hidden)
    values = iiwa14_base.base_from_physical(table3).copy()
    values[iiwa14_base.names.index("MX_7")] += 0.01
    comparison = diagnose([recording], iiwa14, model=_model_of_base(iiwa14_base, values)).model_comparison
    assert comparison is not None
    assert [item.link for item in comparison.links if item.wrong] == [7]
    assert [item.name for item in comparison.parameters if item.wrong] == ["MX_7"]
    assert comparison.missing_nm[1] > 2.0 * comparison.findings_nm[1]
    assert "Wrong parameters" in comparison.sentence


def test_a_right_model_has_no_wrong_parameter(
    iiwa14: RobotModel, iiwa14_base: BaseRegressor, table3: PhysicalParameters
) -> None:
    given = _model_of_base(iiwa14_base, iiwa14_base.base_from_physical(table3))
    diagnosis = diagnose([record(iiwa14, table3)], iiwa14, model=given)
    assert diagnosis.model_comparison is not None
    assert not any(item.wrong for item in diagnosis.model_comparison.links)
    assert not any(item.wrong for item in diagnosis.model_comparison.parameters)
    assert diagnosis.to_json()["model_comparison"]["sentence"] in diagnosis.notes
    assert not diagnosis.model_comparison.no_check
    assert diagnosis.standing(iiwa14) is iiwa14


def test_a_model_is_compared_with_the_effects_that_it_holds(
    iiwa14: RobotModel, iiwa14_base: BaseRegressor, table3: PhysicalParameters
) -> None:
    """The plant brakes more in one direction; the model has the true parameters and that friction."""

    def hidden(_q: np.ndarray, dq: np.ndarray, _torque: np.ndarray) -> np.ndarray:
        return on_joint(3, 0.8 * np.abs(dq[:, 2]))

    recording = record(iiwa14, table3, hidden)
    effect = {
        "effect": "asymmetric_viscous_friction", "joint": 3, "link": None,
        "model": {"other_joint": None, "shape": {}, "coefficients": [0.8]},
    }  # fmt: skip
    plain = _model_of_base(iiwa14_base, iiwa14_base.base_from_physical(table3))
    plain = replace(plain, std=np.full(iiwa14_base.size, 1e-4))
    without, holding = (
        diagnose([recording], iiwa14, model=replace(plain, data={"effects": effects})) for effects in ([], [effect])
    )
    assert without.model_comparison is not None
    assert holding.model_comparison is not None
    noise = holding.baseline.noise_floor_nm
    assert without.model_comparison.model_nm[2] > 5.0 * noise[2]
    assert np.all(holding.model_comparison.model_nm < 1.1 * noise)
    assert not any(item.wrong for item in holding.model_comparison.links)
    assert not any(item.wrong for item in holding.model_comparison.parameters)
    assert without.audit is not None
    assert without.audit.verdict != "nothing"
    assert holding.audit is not None
    assert holding.audit.verdict == "nothing"


def test_a_model_is_compared_with_the_offsets_that_a_fit_would_not_take(
    iiwa14: RobotModel, table3: PhysicalParameters
) -> None:
    """One joint alone has an offset, so a fit takes none; those of the model were dropped, and it was said to miss."""
    recording = record(iiwa14, table3, lambda _q, dq, _torque: on_joint(3, np.full(len(dq), 0.6)))
    base = BaseRegressor(iiwa14, RegressorOptions(offset=True))
    values = base.base_from_physical(table3)
    values[base.names.index("OFF_3")] = 0.6
    given = replace(_model_of_base(base, values), std=np.full(base.size, 1e-4))
    diagnosis = diagnose([recording], iiwa14, model=given)
    compared = diagnosis.model_comparison
    assert compared is not None
    assert np.all(compared.model_nm < 1.1 * diagnosis.baseline.noise_floor_nm)
    assert not any(item.wrong for item in (*compared.links, *compared.parameters))


def test_a_simulators_file_with_rotor_inertias_is_read_with_them(
    tmp_path: Path, iiwa14: RobotModel, table3: PhysicalParameters
) -> None:
    """Every MJCF of a motor-side arm has `armature`: it was called another arm, of other axes, lengths or gravity."""
    rotor = np.array([0.4, 0.4, 0.2, 0.2, 0.1, 0.05, 0.05])
    file, links = tmp_path / "arm.xml", consistent(table3)
    export_model(model_of(tmp_path, "iiwa14", links, rotor=rotor), file, "mjcf", parameter_set="physical")
    q, dq, ddq = fourier_motion(7, period_s=8.0, samples=1600, seed=3)
    torque = np.tile(inverse_dynamics(iiwa14, links, q, dq, ddq) + rotor * ddq, (4, 1))
    torque += np.random.default_rng(3).normal(scale=0.05, size=torque.shape)
    recording = recording_of(np.tile(q, (4, 1)), torque, period_s=8.0, periods=4)
    (standing,) = leaderboard([file], [recording], iiwa14)
    assert standing.rms is not None, standing.refusal
    assert standing.rms.rms_nm.max() < 0.1
    assert standing.audit is not None
    assert standing.audit.verdict == "nothing"
    compared = diagnose([recording], iiwa14, model=file).model_comparison
    assert compared is not None
    assert compared.model_nm.max() < 0.05
    written = write_back([recording], iiwa14, file, [], tmp_path / "found.xml")
    assert written.rms(written.after).max() < 0.1


def test_a_model_that_was_fitted_to_the_recording_is_no_news_of_it(
    iiwa14: RobotModel, iiwa14_base: BaseRegressor, table3: PhysicalParameters
) -> None:
    recording = record(iiwa14, table3)
    given = _model_of_base(iiwa14_base, iiwa14_base.base_from_physical(table3))
    noted = {"provenance": {"inputs": [{"sha256": recording.source.sha256}]}}
    diagnosis = diagnose([recording], iiwa14, model=replace(given, data=noted))
    compared = diagnosis.model_comparison
    assert compared is not None
    assert diagnosis.to_json()["model_comparison"]["fitted_to"] == [Path(recording.source.path).name]
    (said,) = compared.no_check
    assert said.startswith("NO CHECK: the model was fitted to ")
    assert set_up_lines(diagnosis)[0] == said
    assert str(Answer(diagnosis, Inputs((recording,), iiwa14))).startswith(said)
    section = comparison_section(compared)
    assert section is not None
    assert section.blocks[0] == Paragraph(said, "warning")
