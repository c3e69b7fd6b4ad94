"""Claims about the kinematic URDF: another program that reads it puts the flange where every iiwa has it.

Truth: the product of exponentials of the screw axes that all public descriptions of the iiwa agree on (z, y, z, −y, z,
y, z at zero, at the heights of the data sheet), evaluated by SciPy's matrix exponential; Pinocchio reads the URDF.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio
import pytest
from scipy.linalg import expm

from identification.errors import RobotError
from identification.export.kinematic_urdf import kinematic_urdf
from identification.robots import load_robot, robot_from_urdf

AXES = ((0, 0, 1), (0, 1, 0), (0, 0, 1), (0, -1, 0), (0, 0, 1), (0, 1, 0), (0, 0, 1))
HEIGHTS = {"iiwa14": (0.36, 0.42, 0.40, 0.126), "iiwa7": (0.34, 0.40, 0.40, 0.126)}
POSITIONS = np.random.default_rng(5).uniform(-2.0, 2.0, (20, 7))


def cross_matrix(vector: np.ndarray) -> np.ndarray:
    return np.cross(np.eye(3), vector)


def flange_by_screws(robot: str, position: np.ndarray) -> np.ndarray:
    shoulder, upper, lower, flange = HEIGHTS[robot]
    heights = (shoulder, shoulder, shoulder + upper, shoulder + upper, *[shoulder + upper + lower] * 3)
    pose = np.eye(4)
    for axis, height, angle in zip(np.array(AXES, float), heights, position, strict=True):
        twist = np.zeros((4, 4))
        twist[:3, :3] = cross_matrix(axis)
        twist[:3, 3] = -np.cross(axis, (0.0, 0.0, height))
        pose = pose @ expm(twist * angle)
    at_zero = np.eye(4)
    at_zero[2, 3] = shoulder + upper + lower + flange
    return pose @ at_zero


@pytest.mark.parametrize("name", ["iiwa14", "iiwa7"])
def test_the_flange_is_where_public_descriptions_have_it_in_position_and_orientation(name: str) -> None:
    model = pinocchio.buildModelFromXML(kinematic_urdf(load_robot(name)))
    data = model.createData()
    frame = model.getFrameId("flange")
    for position in POSITIONS:
        pinocchio.framesForwardKinematics(model, data, position)
        assert np.abs(data.oMf[frame].homogeneous - flange_by_screws(name, position)).max() < 1e-12


def test_link_frames_are_the_tables_lifted_and_turned() -> None:
    robot = load_robot("iiwa14")
    model = pinocchio.buildModelFromXML(kinematic_urdf(robot))
    data, table_data = model.createData(), robot.pinocchio_model.createData()
    base = pinocchio.SE3(np.diag([-1.0, -1.0, 1.0]), np.array([0.0, 0.0, 0.36]))
    for position in POSITIONS:
        pinocchio.forwardKinematics(model, data, position)
        pinocchio.forwardKinematics(robot.pinocchio_model, table_data, position)
        for joint in range(1, 8):
            assert np.allclose(data.oMi[joint].homogeneous, (base * table_data.oMi[joint]).homogeneous, atol=1e-12)


def test_limits_and_names_survive_and_our_own_reader_takes_it(tmp_path: Path) -> None:
    robot = load_robot("iiwa14")
    names = [f"iiwa_joint_{joint}" for joint in range(1, 8)]
    file = tmp_path / "robot.urdf"
    file.write_text(kinematic_urdf(robot, joint_names=names))
    read = load_robot(file)
    assert list(read.joint_names) == names
    for name in ("position_lower", "position_upper", "velocity", "effort"):
        assert np.allclose(getattr(read, name), getattr(robot, name), atol=1e-15), name


def test_a_robot_without_a_known_base_is_refused_by_name() -> None:
    text = "<robot name='other'><link name='a'/><link name='b'/><joint name='j' type='revolute'><parent link='a'/>"
    text += "<child link='b'/><axis xyz='0 0 1'/><limit lower='-1' upper='1' effort='1' velocity='1'/></joint></robot>"
    with pytest.raises(RobotError) as caught:
        kinematic_urdf(robot_from_urdf(text, source="text"))
    assert "other" in str(caught.value)
