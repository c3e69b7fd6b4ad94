"""Claims about the file beside an exported model: what identified torque the formats have no place for."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from identification.base_parameters import BaseRegressor, RegressorOptions
from identification.export.write import export_model
from identification.physical_parameters import PhysicalParameters
from identification.robots import load_robot
from tests.identification.exported import consistent, model_of, random_bodies


def test_what_no_simulator_holds_goes_into_a_file_beside(tmp_path: Path, table3: PhysicalParameters) -> None:
    effects = [{"effect": "stribeck_friction", "joint": 1}, {"effect": "payload", "joint": None, "link": 7}]
    offset = [0.0, 0.4, 0.0, 0.0, 0.0, 0.0, 0.0]
    model = model_of(tmp_path, "iiwa14", consistent(table3), offset=offset, effects=effects)
    result = export_model(model, tmp_path / "arm.urdf", "urdf", parameter_set="physical")
    beside = json.loads((tmp_path / "arm.urdf.effects.json").read_text())
    assert result.effects_path == tmp_path / "arm.urdf.effects.json"
    assert [(item["effect"], item["joint"]) for item in beside["effects"]] == [
        ("stribeck_friction", 1), ("torque_offset", 2),
    ]  # fmt: skip
    assert "stribeck_friction of joint 1" in (tmp_path / "arm.urdf").read_text()


def test_a_constant_torque_far_below_friction_is_kept_beside_but_no_advice(
    tmp_path: Path, table3: PhysicalParameters
) -> None:
    """0.5 mNm on a joint with 0.3 Nm of Coulomb friction ended in "apply it as a joint torque"."""
    physical = consistent(table3)
    offset = 1e-3 * physical.coulomb
    offset[1] = 0.5 * physical.coulomb[1]
    result = export_model(
        model_of(tmp_path, "iiwa14", physical, offset=offset.tolist()), tmp_path / "a.urdf", "urdf",
        parameter_set="physical",
    )  # fmt: skip
    assert [note for note in result.notes if "torque_offset" in note] == [
        "torque_offset of joint 2 has no place in a simulator model: apply it as a joint torque."
    ]
    assert len(json.loads((tmp_path / "a.urdf.effects.json").read_text())["effects"]) == 7


@pytest.mark.parametrize("which", ["consistent", "physical"])
def test_the_constant_torque_beside_the_file_is_that_of_the_set_in_the_file(which: str, tmp_path: Path) -> None:
    """Truth: gravity acts on neither joint of a level crane, so at rest it shows the identified offsets alone. Those of
    program (10) stood beside the bodies of the other set, whose weight makes up for others; a force was called Nm.
    """
    (tmp_path / "crane.urdf").write_text(
        """<robot name="crane"><link name="floor"/><link name="mast"/><link name="trolley"/>
        <joint name="slew" type="revolute"><parent link="floor"/><child link="mast"/><axis xyz="0 0 1"/>
        <limit lower="-3" upper="3" effort="90" velocity="2"/></joint>
        <joint name="run" type="prismatic"><origin xyz="1 0 1"/><parent link="mast"/><child link="trolley"/>
        <axis xyz="1 0 0"/><limit lower="-0.5" upper="3" effort="900" velocity="1.5"/></joint></robot>"""
    )
    physical, robot = random_bodies(2, 1), str(tmp_path / "crane.urdf")
    base = BaseRegressor(load_robot(robot), RegressorOptions(offset=True, coulomb_velocity=(0.02, 0.003)))
    pairs = zip(base.names, base.base_from_physical(physical), strict=True)
    identified = {"OFF_1": 0.4, "OFF_2": -3.0}
    values = [identified.get(name, value) for name, value in pairs]
    parameters = [
        {"name": name, "value": float(value), "std": 1e-4, "unit": unit}
        for name, value, unit in zip(base.names, values, base.units, strict=True)
    ]
    of_program_10 = [0.5, -2.0]
    model = model_of(
        tmp_path, robot, physical, offset=of_program_10, base_parameters=parameters,
        provenance={"regressor": base.options.to_json()},
    )  # fmt: skip
    export_model(model, tmp_path / "crane.xml", "mjcf", parameter_set=which)
    beside = json.loads((tmp_path / "crane.xml.effects.json").read_text())
    offsets = [each["parameters"]["offset"] for each in beside["effects"]]
    expected = list(identified.values()) if which == "consistent" else of_program_10
    assert [each["value"] for each in offsets] == pytest.approx(expected, abs=1e-3)
    assert [each["unit"] for each in offsets] == ["Nm", "N"]
    assert beside["friction_transition"]["velocity"] == [0.02, 0.003]
    assert beside["friction_transition"]["unit"] == ["rad/s", "m/s"]


def test_torque_without_a_name_goes_into_the_file_beside_and_is_said(
    tmp_path: Path, table3: PhysicalParameters
) -> None:
    """Of a model that a diagnosis wrote it was dropped without a word: 3.4 Nm on one joint of a UR-like arm."""
    terms = {"terms": [{"class": "own_position", "joint": 3}, {"class": "own_load", "joint": 5}]}
    model = model_of(tmp_path, "iiwa14", consistent(table3), class_terms=terms)
    result = export_model(model, tmp_path / "arm.sdf", "sdf", parameter_set="physical")
    assert result.effects_path is not None
    assert json.loads(result.effects_path.read_text())["class_terms"] == terms
    assert "torque without a name on joints 3, 5" in (tmp_path / "arm.sdf").read_text()
