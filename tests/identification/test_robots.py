"""Robots by name, from tables and from URDF files. Truth: KUKA's published geometry, Pinocchio's own URDF reading."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pinocchio
import pytest

from identification.errors import RobotError, RobotNotFoundError
from identification.robots import RobotModel, load_robot, robot_from_arrays, robot_from_table, robot_from_urdf
from tests.reference import TABLES, recording_file

HEADER = "link,gamma_rad,alpha_rad,d_m,theta,rl_m\n"

URDF = """<robot name="two">
  <link name="base"/><link name="a"/><link name="b"/><link name="tool"/>
  <joint name="slide" type="prismatic"><origin xyz="0 0 0.1" rpy="1.5708 0 0"/><axis xyz="0 0 -1"/>
    <parent link="base"/><child link="a"/><limit lower="-0.2" upper="0.3" velocity="0.5" effort="100"/></joint>
  <joint name="turn" type="continuous"><origin xyz="0.2 0 0"/><axis xyz="1 2 2"/>
    <parent link="a"/><child link="b"/></joint>
  <joint name="weld" type="fixed"><parent link="b"/><child link="tool"/></joint>
</robot>"""

XACRO = "http://www.ros.org/wiki/xacro"


def wrist_position(robot: RobotModel, q: np.ndarray) -> np.ndarray:
    data = robot.pinocchio_model.createData()
    pinocchio.forwardKinematics(robot.pinocchio_model, data, q)
    return data.oMi[robot.n].translation.copy()


@pytest.mark.parametrize(("name", "upper_arm", "forearm"), [("iiwa14", 0.42, 0.40), ("iiwa7", 0.40, 0.40)])
def test_built_in_arm_has_kukas_link_lengths(name: str, upper_arm: float, forearm: float) -> None:
    robot = load_robot(name)
    stretched = wrist_position(robot, np.zeros(7))
    np.testing.assert_allclose(stretched, [0.0, 0.0, upper_arm + forearm], atol=1e-15)
    bent = wrist_position(robot, np.array([0.0, 0.0, 0.0, np.pi / 2, 0.0, 0.0, 0.0]))
    assert bent[2] == pytest.approx(upper_arm, abs=1e-15)
    assert np.hypot(bent[0], bent[1]) == pytest.approx(forearm, abs=1e-15)


def test_axes_at_zero_are_those_of_the_paper() -> None:
    """ERRATA: +z −y +z +y +z −y +z with the paper's Table 1."""
    robot = load_robot("iiwa14")
    data = robot.pinocchio_model.createData()
    pinocchio.forwardKinematics(robot.pinocchio_model, data, np.zeros(7))
    axes = [data.oMi[joint].rotation[:, 2] for joint in range(1, 8)]
    z, y = np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])
    np.testing.assert_array_equal(axes, [z, -y, z, y, z, -y, z])


def test_limits_are_those_of_the_brochure() -> None:
    robot = load_robot("iiwa14")
    np.testing.assert_allclose(np.rad2deg(robot.position_upper), [170, 120, 170, 120, 170, 120, 175])
    np.testing.assert_allclose(np.rad2deg(robot.velocity), [85, 85, 100, 75, 130, 135, 135])
    np.testing.assert_array_equal(robot.effort, [320, 320, 176, 176, 110, 40, 40])
    np.testing.assert_allclose(np.rad2deg(load_robot("iiwa7").velocity), [98, 98, 100, 130, 140, 180, 180])


def test_the_papers_table_as_a_file_is_the_built_in_robot() -> None:
    robot = load_robot(TABLES / "table1_mdh.csv")
    built_in = load_robot("iiwa14")
    np.testing.assert_array_equal(robot.modified_denavit_hartenberg, built_in.modified_denavit_hartenberg)
    np.testing.assert_array_equal(robot.kinematics.rotation, built_in.kinematics.rotation)
    assert len(robot.digest) == 64
    assert robot.digest != built_in.digest


def test_placement_is_khalils_with_offsets_and_prismatic_joints() -> None:
    """Truth: the product of the four elementary transformations."""
    alpha, d, theta, rl = 0.3, 0.2, -0.7, 0.5
    robot = robot_from_arrays(
        np.array([[alpha, d, theta, rl], [alpha, d, theta, rl]]), revolute=np.array([True, False])
    )

    def x_rotation(a: float) -> pinocchio.SE3:
        return pinocchio.SE3(pinocchio.utils.rotate("x", a), np.zeros(3))

    def z_rotation(a: float) -> pinocchio.SE3:
        return pinocchio.SE3(pinocchio.utils.rotate("z", a), np.zeros(3))

    q = np.array([0.4, 0.25])
    expected = pinocchio.SE3.Identity()
    for turn, slide in ((theta + q[0], rl), (theta, rl + q[1])):
        expected = expected * x_rotation(alpha) * pinocchio.SE3(np.eye(3), np.array([d, 0, 0]))
        expected = expected * z_rotation(turn) * pinocchio.SE3(np.eye(3), np.array([0, 0, slide]))
    data = robot.pinocchio_model.createData()
    pinocchio.forwardKinematics(robot.pinocchio_model, data, q)
    np.testing.assert_allclose(data.oMi[2].homogeneous, expected.homogeneous, atol=1e-15)


@pytest.mark.parametrize("name", ["panda", "tx40", "kr300"])
def test_urdf_without_inertias_loads_with_the_files_kinematics(name: str) -> None:
    path = recording_file(f"{name}.urdf")
    robot = load_robot(path)
    raw = pinocchio.buildModelFromUrdf(str(path))
    assert robot.pinocchio_model.nq == robot.n == raw.nv
    angles = np.random.default_rng(3).uniform(-2.0, 2.0, robot.n)
    ours, theirs = robot.pinocchio_model.createData(), raw.createData()
    pinocchio.forwardKinematics(robot.pinocchio_model, ours, angles)
    # continuous joints: Pinocchio wants cosine and sine
    pinocchio.forwardKinematics(raw, theirs, np.column_stack([np.cos(angles), np.sin(angles)]).ravel())
    for joint in range(1, robot.n + 1):
        # the files print π/2 with ten digits; the difference is what that leaves out
        np.testing.assert_allclose(ours.oMi[joint].homogeneous, theirs.oMi[joint].homogeneous, atol=1e-8)


def test_urdf_keeps_names_limits_axes_and_drops_fixed_joints() -> None:
    robot = robot_from_urdf(URDF, source="two.urdf")
    assert (robot.name, robot.joint_names, robot.n) == ("two", ("slide", "turn"), 2)
    assert robot.kinematics.revolute.tolist() == [False, True]
    np.testing.assert_allclose(robot.kinematics.axis, [[0, 0, -1], [1 / 3, 2 / 3, 2 / 3]])
    np.testing.assert_array_equal(robot.position_upper, [0.3, np.nan])
    np.testing.assert_array_equal(robot.kinematics.rotation[0], [[1, 0, 0], [0, 0, -1], [0, 1, 0]])  # 1.5708 is π/2


def test_missing_file_has_exit_code_66(tmp_path: Path) -> None:
    with pytest.raises(RobotNotFoundError, match="iiwa14"):
        load_robot(tmp_path / "nothing.urdf")
    assert RobotNotFoundError.exit_code == 66
    assert RobotError.exit_code == 65


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("<robot", "not well-formed"),
        ("<sdf/>", "root element is <sdf>"),
        ("<robot name='r'/>", "no link"),
        ("<robot name='r'><link name='base'/></robot>", "no movable joint"),
        (URDF.replace('type="continuous"', 'type="floating"'), "'turn' is floating"),
        (URDF.replace('type="continuous"', 'type="planar"'), "'turn' is planar"),
        (URDF.replace('xyz="1 2 2"', 'xyz="0 0 0"'), "axis of joint 'turn' is 0 0 0"),
        (f"<robot name='r' xmlns:xacro='{XACRO}'><xacro:arm/></robot>", "not expanded .<xacro:arm>"),
        (URDF.replace("</robot>", f"<xacro:if xmlns:xacro='{XACRO}'/></robot>"), "not expanded .<xacro:if>"),
        (URDF.replace('<link name="b"/>', ""), "link 'b', which is not described"),
        (URDF.replace('type="prismatic"', 'type="fixed"').replace('type="continuous"', 'type="fixed"'), "no movable"),
    ],
)
def test_urdf_that_cannot_be_used_says_why(text: str, place: str, tmp_path: Path) -> None:
    file = tmp_path / "robot.urdf"
    file.write_text(text)
    with pytest.raises(RobotError, match=place) as caught:
        load_robot(file)
    assert caught.value.exit_code == 65
    assert "robot.urdf" in str(caught.value)


def test_what_the_urdf_parser_complains_of_is_said_in_the_error_and_nowhere_else(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Truth: `urdfdom` writes what it finds wrong to file descriptor 2, and Pinocchio raises without it."""
    file = tmp_path / "robot.urdf"
    file.write_text(URDF.replace('<axis xyz="', '<axis xyz="0 zero ', 1))
    for _ in range(2):
        with pytest.raises(RobotError, match="zero"):
            load_robot(file)
    os.write(2, b"the terminal is back\n")
    assert capfd.readouterr().err == "the terminal is back\n"


@pytest.mark.parametrize(
    ("text", "field", "joint"),
    [
        ("a,b\n1,2\n", "alpha_rad", None),
        (HEADER, "link", None),
        (HEADER + "1,0,zero,0,q1,0\n", "alpha_rad", 1),
        (HEADER + "1,0,0,0,q1,0\n2,0,pi/2,nan,q2,0\n", "d_m", 2),
        (HEADER + "1,0,0,0,q2,0\n", "theta", 1),
        (HEADER + "1,0,0,0,0.1,0\n", "theta", 1),
        (HEADER + "1,0,0,0,2*q1,0\n", "theta", 1),
        (HEADER + "1,1,0,0,q1,0\n", "gamma_rad", 1),
        (HEADER + "1,0,__import__('os'),0,q1,0\n", "alpha_rad", 1),
        (HEADER + "1,0,1/0,0,q1,0\n", "alpha_rad", 1),
        (HEADER + "1,0,0\n", "theta", 1),
    ],
)
def test_table_that_cannot_be_used_names_column_and_joint(text: str, field: str, joint: int | None) -> None:
    with pytest.raises(RobotError) as caught:
        robot_from_table(text, name="r", source="table.csv")
    assert (caught.value.field, caught.value.joint) == (field, joint)


def test_binary_file_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "robot.urdf"
    file.write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(RobotError, match="cannot be read"):
        load_robot(file)


def test_loads_are_given_in_the_controllers_tool_frame_also_where_a_flange_stands_before_it() -> None:
    """Truth: the frames of ROS-Industrial's arms: `flange` has x outwards, `tool0` the controller's axes, z outwards.

    So a point 0.1 m before the tool plate of an arm whose last axis is z stands at z = 0.1 m of load data.
    """
    frames = """<link name="flange"/><link name="tool0"/>
      <joint name="b-flange" type="fixed"><parent link="tool"/><child link="flange"/>
        <origin xyz="0 0 0.05" rpy="0 -1.5707963267948966 -1.5707963267948966"/></joint>
      <joint name="flange-tool0" type="fixed"><parent link="flange"/><child link="tool0"/>
        <origin rpy="1.5707963267948966 0 1.5707963267948966"/></joint></robot>"""
    robot = robot_from_urdf(URDF.replace("</robot>", frames), source="arm.urdf")
    assert robot.flange is not None
    assert np.allclose(robot.flange.point(np.array([0.02, 0.03, 0.15])), [0.02, 0.03, 0.1], atol=1e-12)


def test_a_urdf_may_be_in_another_encoding_that_it_declares(tmp_path: Path) -> None:
    text = (
        '<?xml version="1.0" encoding="ISO-8859-1"?><robot name="r"><!-- für --><link name="base"/><link name="rim"/>'
    )
    text += '<joint name="axle" type="continuous"><parent link="base"/><child link="rim"/><axis xyz="0 0 1"/></joint>'
    file = tmp_path / "wheel.urdf"
    file.write_bytes(f"{text}</robot>".encode("latin-1"))
    assert load_robot(file).joint_names == ("axle",)
    file.write_bytes(f"{text}</robot>".replace("ISO-8859-1", "nonsense").encode("latin-1"))
    with pytest.raises(RobotError, match="cannot be read as text: unknown encoding: nonsense"):
        load_robot(file)
