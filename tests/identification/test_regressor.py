"""The batched regressor. Truth: Pinocchio's computeJointTorqueRegressor and recursive Newton-Euler, and a pendulum."""

from __future__ import annotations

import numpy as np
import pinocchio
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from identification.base_parameters import BaseRegressor, RegressorOptions
from identification.regressor import torque_regressor
from identification.robots import RobotModel, load_robot, robot_from_arrays, robot_from_urdf
from tests.reference import recording_file

# Pinocchio orders a link's tensor Ixx Ixy Iyy Ixz Iyz Izz, eq. (3) XX XY XZ YY YZ ZZ.
FROM_PINOCCHIO = np.array([0, 1, 2, 3, 4, 5, 7, 6, 8, 9])

TREE = """<robot name="tree">
  <link name="base"/><link name="a"/><link name="b"/><link name="c"/><link name="d"/>
  <joint name="1" type="revolute"><axis xyz="0 1 0"/><origin xyz="0 0 0.3" rpy="0.2 0.1 0"/>
    <parent link="base"/><child link="a"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint>
  <joint name="2" type="prismatic"><axis xyz="-1 0 0"/><origin xyz="0.1 0.2 0.3" rpy="0 0.5 0"/>
    <parent link="a"/><child link="b"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint>
  <joint name="3" type="continuous"><axis xyz="1 1 0"/><origin xyz="0.1 0 0.3" rpy="1 0 0"/>
    <parent link="a"/><child link="c"/></joint>
  <joint name="4" type="prismatic"><axis xyz="0 3 4"/><origin xyz="0 0.2 0" rpy="0 0 1"/>
    <parent link="c"/><child link="d"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint>
</robot>"""


def pinocchio_regressor(robot: RobotModel, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
    data = robot.pinocchio_model.createData()
    columns = np.concatenate([10 * link + FROM_PINOCCHIO for link in range(robot.n)])
    return np.array(
        [
            np.array(pinocchio.computeJointTorqueRegressor(robot.pinocchio_model, data, *state)).reshape(robot.n, -1)[
                :, columns
            ]
            for state in zip(q, dq, ddq, strict=True)
        ]
    )


def assert_equals_pinocchio(robot: RobotModel, seed: int, samples: int = 20) -> None:
    generator = np.random.default_rng(seed)
    q, dq, ddq = (generator.uniform(-2.0, 2.0, (samples, robot.n)) for _ in range(3))
    ours = torque_regressor(robot, q, dq, ddq)
    theirs = pinocchio_regressor(robot, q, dq, ddq)
    assert ours.shape == (samples, robot.n, 10 * robot.n)
    np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=1e-12 * np.abs(theirs).max())


@pytest.mark.parametrize("name", ["iiwa14", "iiwa7"])
def test_iiwa_equals_pinocchio(name: str) -> None:
    assert_equals_pinocchio(load_robot(name), seed=1)


@pytest.mark.parametrize("name", ["panda", "tx40", "kr300"])
def test_urdf_robot_equals_pinocchio(name: str) -> None:
    assert_equals_pinocchio(load_robot(recording_file(f"{name}.urdf")), seed=2)


def test_tree_with_unaligned_axes_equals_pinocchio() -> None:
    assert_equals_pinocchio(robot_from_urdf(TREE, source="tree"), seed=3)


@settings(max_examples=25, deadline=None)
@given(st.integers(1, 9), st.integers(0, 2**32 - 1))
def test_random_chain_of_revolute_and_prismatic_joints_equals_pinocchio(n: int, seed: int) -> None:
    generator = np.random.default_rng(seed)
    robot = robot_from_arrays(generator.uniform(-2.0, 2.0, (n, 4)), revolute=generator.random(n) < 0.5)
    assert_equals_pinocchio(robot, seed=seed, samples=4)


def random_tree(generator: np.random.Generator, n: int) -> RobotModel:
    """Any parent, any axis, either joint type, any placement."""
    joints = []
    for joint in range(1, n + 1):
        axis, offset, angles = (" ".join(map(str, values)) for values in generator.normal(size=(3, 3)))
        kind = "prismatic" if generator.random() < 0.4 else "revolute"
        joints.append(
            f'<link name="l{joint}"/><joint name="{joint}" type="{kind}"><axis xyz="{axis}"/>'
            f'<origin xyz="{offset}" rpy="{angles}"/><parent link="l{generator.integers(joint)}"/>'
            f'<child link="l{joint}"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint>'
        )
    return robot_from_urdf(f'<robot name="tree"><link name="l0"/>{"".join(joints)}</robot>', source="tree")


@settings(max_examples=25, deadline=None)
@given(st.integers(1, 8), st.integers(0, 2**32 - 1))
def test_random_tree_with_axes_in_general_position_equals_pinocchio(n: int, seed: int) -> None:
    assert_equals_pinocchio(random_tree(np.random.default_rng(seed), n), seed=seed, samples=4)


@pytest.mark.parametrize("angle", [np.pi, -np.pi, np.pi / 2, 0.0, 1e4])
def test_angles_where_the_half_angle_formula_is_delicate_equal_pinocchio(iiwa14: RobotModel, angle: float) -> None:
    generator = np.random.default_rng(5)
    q = angle + generator.choice([0.0, 1e-12, -1e-9], (20, 7))
    dq, ddq = generator.uniform(-2.0, 2.0, (2, 20, 7))
    theirs = pinocchio_regressor(iiwa14, q, dq, ddq)
    np.testing.assert_allclose(torque_regressor(iiwa14, q, dq, ddq), theirs, rtol=0.0, atol=2e-12)


def test_chunks_join_without_a_seam(iiwa14: RobotModel) -> None:
    generator = np.random.default_rng(4)
    q, dq, ddq = (generator.uniform(-2.0, 2.0, (4017, 7)) for _ in range(3))
    whole = torque_regressor(iiwa14, q, dq, ddq)
    picked = [0, 1999, 2000, 2001, 3999, 4000, 4016]
    np.testing.assert_array_equal(whole[picked], torque_regressor(iiwa14, q[picked], dq[picked], ddq[picked]))


def test_pendulum_in_closed_form() -> None:
    """One horizontal axis: τ = ZZ q̈ + g (MX cos q − MY sin q) with q from the horizontal."""
    robot = robot_from_arrays(np.array([[np.pi / 2, 0.0, 0.0, 0.0]]))
    q = np.linspace(-3.0, 3.0, 11)[:, None]
    dq, ddq = np.full_like(q, 0.7), np.full_like(q, -1.3)
    columns = torque_regressor(robot, q, dq, ddq)[:, 0]
    gravity = 9.81
    np.testing.assert_allclose(columns[:, 1], gravity * np.cos(q[:, 0]), atol=1e-14)
    np.testing.assert_allclose(columns[:, 2], -gravity * np.sin(q[:, 0]), atol=1e-14)
    np.testing.assert_allclose(columns[:, 9], -1.3, atol=1e-14)
    np.testing.assert_allclose(np.delete(columns, [1, 2, 9], axis=1), 0.0, atol=1e-14)


def test_no_samples_give_an_empty_regressor(iiwa14: RobotModel) -> None:
    nothing = np.empty((0, 7))
    assert torque_regressor(iiwa14, nothing, nothing, nothing).shape == (0, 7, 70)


def test_wrong_shapes_are_refused(iiwa14: RobotModel) -> None:
    with pytest.raises(ValueError, match=r"\(samples, 7\)"):
        torque_regressor(iiwa14, np.zeros((5, 6)), np.zeros((5, 6)), np.zeros((5, 6)))
    with pytest.raises(ValueError, match=r"\(samples, 7\)"):
        torque_regressor(iiwa14, np.zeros((5, 7)), np.zeros((4, 7)), np.zeros((5, 7)))


def test_friction_and_drive_columns_are_diagonal_and_a_joint_at_rest_has_no_coulomb_torque(iiwa14: RobotModel) -> None:
    base = BaseRegressor(iiwa14, RegressorOptions(rotor_inertia=True, offset=True))
    velocity = np.array([[0.5, 0.0, -2.0, 1e-300, -1e-300, 3.0, -0.1]])
    acceleration = np.array([[1.0, -2.0, 0.0, 4.0, 5.0, 6.0, -7.0]])
    columns = base.matrix(np.zeros((1, 7)), velocity, acceleration)[0]
    assert sum(name.startswith(("FV_", "FS_", "OFF_", "IA_")) for name in base.names) == 26
    for symbol, values in (
        ("FV", velocity[0]),
        ("FS", [1.0, 0.0, -1.0, 1.0, -1.0, 1.0, -1.0]),
        ("OFF", np.ones(7)),
        ("IA", acceleration[0]),
    ):
        for joint in range(7):
            if f"{symbol}_{joint + 1}" in base.names:  # the rotors of joints 1 and 2 are part of ZZR_1, ZZR_2
                expected = values[joint] * np.eye(7)[joint]
                np.testing.assert_array_equal(columns[:, base.position_of(f"{symbol}_{joint + 1}")], expected)
