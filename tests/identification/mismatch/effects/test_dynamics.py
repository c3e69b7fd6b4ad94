"""Rigid-body quantities of the effects. Truth: Pinocchio, and a Pinocchio model with a spinning rotor as a body."""

from __future__ import annotations

import numpy as np
import pinocchio
import pytest

from identification.mismatch.effects.base import Place
from identification.mismatch.effects.distal_rotor_reaction import DistalRotorReaction
from identification.mismatch.effects.dynamics import across, rigid_torque, tilt_torques, torque_derivatives
from identification.mismatch.motion import Motion
from identification.physical_parameters import PhysicalParameters
from identification.robots import RobotModel
from tests.identification.mismatch.effects.motions import (
    motion_of,
    pinocchio_model,
    pinocchio_torque,
    random_links,
    sliding_robot,
)


@pytest.fixture(params=["iiwa14", "sliding"])
def case(request: pytest.FixtureRequest, iiwa14: RobotModel) -> tuple[Motion, PhysicalParameters]:
    robot = iiwa14 if request.param == "iiwa14" else sliding_robot()
    links = random_links(robot.n, 3)
    return motion_of(robot, links, rate_hz=5.0), links


def test_rigid_torque_and_joint_moments_equal_pinocchio(case: tuple[Motion, PhysicalParameters]) -> None:
    motion, links = case
    model = pinocchio_model(motion.robot, links)
    data = model.createData()
    torque, moments, base_force, base_moment = rigid_torque(motion)
    for sample in range(motion.samples):
        state = motion.position[sample], motion.velocity[sample], motion.acceleration[sample]
        np.testing.assert_allclose(torque[sample], pinocchio.rnea(model, data, *state), rtol=0.0, atol=1e-10)
        expected = [data.f[joint + 1].angular for joint in range(motion.n)]
        np.testing.assert_allclose([own[:, sample] for own in moments], expected, rtol=0.0, atol=1e-10)
        on_base = data.liMi[1].act(data.f[1])
        np.testing.assert_allclose(base_force[:, sample], on_base.linear, rtol=0.0, atol=1e-10)
        np.testing.assert_allclose(base_moment[:, sample], on_base.angular, rtol=0.0, atol=1e-10)


def test_derivatives_of_torque_equal_pinocchio(case: tuple[Motion, PhysicalParameters]) -> None:
    motion, links = case
    model = pinocchio_model(motion.robot, links)
    data = model.createData()
    by_joint = [torque_derivatives(motion, joint) for joint in range(motion.n)]
    ours = [np.stack(parts, axis=2) for parts in zip(*by_joint, strict=True)]
    for sample in range(motion.samples):
        state = motion.position[sample], motion.velocity[sample], motion.acceleration[sample]
        pinocchio.computeRNEADerivatives(model, data, *state)
        mass_matrix = np.triu(data.M) + np.triu(data.M, 1).T
        for derivative, truth in zip(ours, (data.dtau_dq, data.dtau_dv, mass_matrix), strict=True):
            np.testing.assert_allclose(derivative[sample], truth, rtol=0.0, atol=2e-5 * max(1.0, np.abs(truth).max()))


def test_tilt_torques_are_those_of_a_turned_base(case: tuple[Motion, PhysicalParameters]) -> None:
    motion, links = case
    model = pinocchio_model(motion.robot, links)
    states = motion.position, motion.velocity, motion.acceleration
    level = pinocchio_torque(model, *states)
    for axis in range(3):
        turned = model.copy()
        rotation = pinocchio.exp3(1e-6 * np.eye(3)[axis])
        # Gravity seen from a base that was turned by the rotation.
        turned.gravity.linear = rotation.T @ model.gravity.linear
        change = (pinocchio_torque(turned, *states) - level) / 1e-6
        np.testing.assert_allclose(tilt_torques(motion)[..., axis], change, rtol=0.0, atol=1e-4)


@pytest.mark.parametrize("spinning", [3, 5, 7])
def test_rotor_reaction_is_that_of_a_spinning_body(iiwa14: RobotModel, spinning: int) -> None:
    """A small ball on link j − 1 that turns about joint j's axis 160 times as fast, against the same ball locked."""
    links = random_links(7, 5)
    motion = motion_of(iiwa14, links, rate_hz=5.0)
    model = pinocchio_model(iiwa14, links)
    own = motion.robot.kinematics
    ratio, inertia = 160.0, 2e-4
    joint = model.addJoint(
        spinning - 1,
        pinocchio.JointModelRZ(),
        pinocchio.SE3(own.rotation[spinning - 1], own.translation[spinning - 1]),
        "rotor",
    )
    ball = pinocchio.Inertia(0.5, np.zeros(3), inertia * np.eye(3))
    model.appendBodyToJoint(joint, ball, pinocchio.SE3.Identity())
    # Pinocchio numbers the joints by support, so that the rotor may come before later links.
    at = model.joints[joint].idx_v
    place = np.delete(np.arange(8), at)

    def torque(share: float) -> np.ndarray:
        states = np.zeros((3, motion.samples, 8))
        for state, values in zip(states, (motion.position, motion.velocity, motion.acceleration), strict=True):
            state[:, place] = values
        states[1:, :, at] = share * np.stack([motion.velocity, motion.acceleration])[..., spinning - 1]
        return pinocchio_torque(model, *states)[:, place]

    reaction = torque(ratio) - torque(0.0)
    columns = DistalRotorReaction().columns(motion, Place(joint=spinning), {})
    assert columns is not None
    expected = np.zeros_like(reaction)
    expected[:, list(columns.joints)] = ratio * inertia * columns.values[..., 0]
    assert np.abs(reaction).max() > 1e-3
    # The rotor's own drive torque is not on the joint's sensor; the joint itself feels only what it carries.
    np.testing.assert_allclose(reaction[:, : spinning - 1], expected[:, : spinning - 1], rtol=0.0, atol=1e-10)


def test_two_vectors_across_an_axis_are_x_and_y_for_z() -> None:
    np.testing.assert_array_equal(across(np.array([0.0, 0.0, 1.0])), np.eye(3)[:2])
    np.testing.assert_array_equal(across(np.array([0.0, 0.0, -1.0])), np.eye(3)[:2])
    slanted = np.array([1.0, 2.0, -2.0]) / 3.0
    np.testing.assert_allclose(across(slanted) @ slanted, 0.0, atol=1e-15)
    np.testing.assert_allclose(across(slanted) @ across(slanted).T, np.eye(2), atol=1e-15)


def test_what_depends_on_the_motion_alone_is_computed_once_and_forgotten_with_it(iiwa14: RobotModel) -> None:
    motion = motion_of(iiwa14, random_links(7, 1), rate_hz=2.0)
    first = rigid_torque(motion)
    assert rigid_torque(motion) is first
    assert rigid_torque(motion_of(iiwa14, random_links(7, 1), rate_hz=2.0)) is not first
