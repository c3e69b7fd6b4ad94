"""Claims about the tool: what the operator says of it reaches preflight, torque and log, and what cannot be is refused.

Truth for the torque: the change of the potential energy m g z of the tool's centre with each joint, z from the URDF of
the arm as public descriptions have it, read by Pinocchio.
"""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pinocchio
import pytest

from daemon.cli.acquisition import tool_from
from daemon.errors import ConfigurationError, MissingInputError
from daemon.motion.preparation import prepare_motion, write_run_request
from daemon.motion.tool import Tool, read_tool
from daemon.motion.torque_foresight import torque_foresight
from daemon.motion.workspace import load_surroundings
from daemon.motion.workspace_file import WorkspaceFile
from identification.export.kinematic_urdf import kinematic_urdf
from identification.robots import load_robot

WHOLE = """
name: gripper
mass_kg: 2.5
center_of_mass_m: [0.01, -0.02, 0.06]
inertia_kg_m2: [0.004, 0.004, 0.002, 0, 0, 0]
length_m: 0.2
radius_m: 0.05
"""


def test_mass_and_place_in_one_word() -> None:
    assert read_tool("2.5@0,-0.01,0.06") == Tool(mass_kg=2.5, center_of_mass_m=(0.0, -0.01, 0.06))
    assert read_tool("none") is None


def test_a_file_says_it_all(tmp_path: Path) -> None:
    (tmp_path / "tool.yaml").write_text(WHOLE)
    tool = read_tool(str(tmp_path / "tool.yaml"))
    assert tool is not None
    assert tool.describe() == "gripper, 2.5 kg at (0.01, -0.02, 0.06) m, 0.2 m long with radius 0.05 m"
    assert tool.tags()["tool_inertia_kg_m2"] == "0.004, 0.004, 0.002, 0.0, 0.0, 0.0"


def test_a_name_is_taken_where_names_are_noted_and_refused_where_a_tool_is_asked_for() -> None:
    for name in ("gripper", "2F-85"):
        assert read_tool(name, is_name=True) == Tool(name=name)
    with pytest.raises(ConfigurationError, match="gripper"):
        read_tool("gripper")


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("mass_kg: 2500\ncenter_of_mass_m: [0, 0, 0.06]\n", "mass_kg"),
        ("mass_kg: 2.5\n", "mass_kg"),
        ("mass_kg: .nan\ncenter_of_mass_m: [0, 0, 0.06]\n", "mass_kg"),
        ("mass_kg: 2.5\ncenter_of_mass_m: [0, 0, 60]\n", "center_of_mass_m"),
        ("mass_kg: 1\ncenter_of_mass_m: [0, 0, 0]\ninertia_kg_m2: [1, 1, 3, 0, 0, 0]\n", "inertia_kg_m2"),
        ("mass_kg: 2.5\ncenter_of_mass_m: [0, 0, 0.06]\ninertia_kg_m2: [4000, 4000, 2000, 0, 0, 0]\n", "inertia_kg_m2"),
        ("mass_kg: 0\ncenter_of_mass_m: [0, 0, 0.06]\ninertia_kg_m2: [1, 1, 1, 0, 0, 0]\n", "inertia_kg_m2"),
        ("length_m: 0.2\n", "length_m"),
        ("length_m: 0.2\nradius_m: -1\n", "radius_m"),
        ("weight: 3\n", "weight"),
    ],
)
def test_what_no_tool_can_be_is_refused_with_its_field(text: str, field: str, tmp_path: Path) -> None:
    file = tmp_path / "tool.yaml"
    file.write_text(text)
    with pytest.raises(ConfigurationError) as refusal:
        read_tool(str(file))
    assert (refusal.value.file, refusal.value.field) == (str(file), field)


@pytest.mark.parametrize(
    "text",
    [
        "2.5kg@0,0,0.06",
        "2.5@0;0;0.06",
        "2.5@0,0",
        "tools/gripper",
        "gripper.json",
        "2.5",
        "2,5",
        "2.5 kg",
        "2.5; 0, 0, 0.06",
    ],
)
def test_what_was_meant_as_a_load_or_a_file_is_not_taken_for_the_name_of_a_tool_that_weighs_nothing(text: str) -> None:
    with pytest.raises(ConfigurationError, match="is no tool: give MASS@X,Y,Z"):
        read_tool(text, is_name=True)
    named = read_tool("gripper v1.2", is_name=True)
    assert named is not None
    assert named.name == "gripper v1.2"


@pytest.mark.parametrize("is_name", [False, True])
def test_nothing_is_no_word_for_no_tool(is_name: bool) -> None:
    """`--tool "$TOOL"` with an unset variable took the workspace's tool away, weight and shape."""
    for text in ("", " "):
        with pytest.raises(ConfigurationError, match="is no tool"):
            read_tool(text, is_name=is_name)


def test_a_file_that_is_not_there_is_missing_input(tmp_path: Path) -> None:
    with pytest.raises(MissingInputError):
        read_tool(str(tmp_path / "tool.yaml"))


def test_its_weight_is_in_the_foreseen_torque() -> None:
    tool = Tool(mass_kg=5.0, center_of_mass_m=(0.03, -0.02, 0.1))
    model = pinocchio.buildModelFromXML(kinematic_urdf(load_robot("iiwa14")))
    data, flange = model.createData(), model.getFrameId("flange")
    pose, step = np.array([0.3, 0.9, -0.4, -1.1, 0.5, 0.7, -0.2]), 1e-6

    def energy(position: np.ndarray) -> float:
        pinocchio.framesForwardKinematics(model, data, position)
        return float(5.0 * 9.81 * data.oMf[flange].act(np.array(tool.center_of_mass_m))[2])

    weight = [(energy(pose + step * axis) - energy(pose - step * axis)) / (2.0 * step) for axis in np.eye(7)]
    bare, loaded = torque_foresight("iiwa14"), torque_foresight("iiwa14", None, tool)
    assert bare is not None
    assert loaded is not None
    table = np.tile(pose, (8, 1))
    np.testing.assert_allclose((loaded.along(table, 1e-3) - bare.along(table, 1e-3))[0], weight, atol=1e-5)
    assert "5 kg" in loaded.source


def test_what_the_option_says_stands_before_the_workspace_file_and_both_go_into_the_run(tmp_path: Path) -> None:
    cell = tmp_path / "cell.yaml"
    cell.write_text("floor_height_m: -0.5\ntool: {name: old, length_m: 0.2, radius_m: 0.05}\n")
    motion = prepare_motion(None, amplitude=0.1, workspace=cell, tool=read_tool("2@0,0,0.05"))
    request = write_run_request(motion, tmp_path / "run", run_id="r")
    assert request.tool == "old, 2 kg at (0, 0, 0.05) m, 0.2 m long with radius 0.05 m"
    assert request.workspace_file is not None
    kept = msgspec.yaml.decode(Path(request.workspace_file).read_bytes(), type=WorkspaceFile)
    assert kept.floor_height_m == -0.5
    assert kept.tool == Tool(name="old", length_m=0.2, radius_m=0.05, mass_kg=2.0, center_of_mass_m=(0.0, 0.0, 0.05))
    # Where the supervisor and the ladder look, they find the same surroundings.
    assert load_surroundings("iiwa14", request.workspace_file).digest == motion.surroundings.digest


def test_a_known_mass_is_fastened_to_the_tool_of_the_workspace_file_and_not_put_in_its_place(tmp_path: Path) -> None:
    """5 kg at 0.1 m and 2 kg at 0.05 m: 7 kg at 0.6 / 7 m, and 10/7 kg of reduced mass 0.05 m apart."""
    cell = tmp_path / "cell.yaml"
    cell.write_text("tool: {mass_kg: 5, center_of_mass_m: [0, 0, 0.1], length_m: 0.2, radius_m: 0.05}\n")
    for said in (None, read_tool("gripper", is_name=True)):
        tool = load_surroundings("iiwa14", cell, said, (2.0, 0.0, 0.0, 0.05)).tool
        assert tool.mass_kg == 7.0
        assert tool.center_of_mass_m == pytest.approx((0.0, 0.0, 0.6 / 7.0))
        assert tool.inertia_kg_m2 == pytest.approx((10.0 / 7.0 * 0.05**2, 10.0 / 7.0 * 0.05**2, 0.0, 0.0, 0.0, 0.0))
        assert (tool.length_m, tool.radius_m) == (0.2, 0.05)
    bare = load_surroundings("iiwa14", cell, tool_from("none"), (2.0, 0.0, 0.0, 0.05)).tool
    assert (bare.mass_kg, bare.length_m) == (2.0, None)


def test_none_takes_the_tool_of_the_workspace_file_away(tmp_path: Path) -> None:
    cell = tmp_path / "cell.yaml"
    cell.write_text("floor_height_m: -0.5\ntool: {name: old, length_m: 0.2, radius_m: 0.05}\n")
    assert tool_from(None) is None
    bare = load_surroundings("iiwa14", cell, tool_from("none"))
    assert (bare.entry.floor_height_m, bare.entry.tool, bare.tool.describe()) == (-0.5, None, "none")
    assert len(bare.geometry.capsules) == len(load_surroundings("iiwa14").geometry.capsules)


def test_a_tool_of_the_workspace_file_stands_in_the_request(tmp_path: Path) -> None:
    cell = tmp_path / "cell.yaml"
    cell.write_text("tool: {length_m: 0.2, radius_m: 0.05}\n")
    request = write_run_request(prepare_motion(None, amplitude=0.1, workspace=cell), tmp_path / "run", run_id="r")
    assert request.tool == "0.2 m long with radius 0.05 m"


def test_another_load_is_another_ladder_and_another_name_is_not() -> None:
    bare = load_surroundings("iiwa14").digest
    assert load_surroundings("iiwa14", tool=Tool(name="gripper")).digest == bare
    assert load_surroundings("iiwa14", tool=read_tool("2@0,0,0.05")).digest != bare
