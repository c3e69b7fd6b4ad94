"""The torque of each effect. Truth: Pinocchio at displaced states, MuJoCo's joint forces, closed forms."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import mujoco
import numpy as np
import numpy.typing as npt
import pinocchio
import pytest

from identification.base_parameters import BaseRegressor
from identification.mismatch.effects import EFFECTS, effect_named
from identification.mismatch.effects.base import Place
from identification.mismatch.effects.dynamics import bending_moments, rigid_torque
from identification.mismatch.motion import Motion
from identification.physical_parameters import PhysicalParameters
from identification.robots import RobotModel
from tests.identification.mismatch.effects.motions import (
    motion_of,
    pinocchio_model,
    pinocchio_torque,
    random_links,
    shipped_motion,
    sliding_robot,
)

FloatArray = npt.NDArray[np.float64]
NO_SHIFT = {"hidden_moment": 0.0, "hidden_inertia": 0.0}


@pytest.fixture(scope="module")
def links() -> PhysicalParameters:
    return random_links(7, 11)


@pytest.fixture(scope="module")
def motion(iiwa14: RobotModel, links: PhysicalParameters) -> Motion:
    return shipped_motion(iiwa14, links, rate_hz=50.0)


def torque(motion: Motion, name: str, place: Place, shape: Mapping[str, float] | None = None) -> FloatArray:
    """(S, n, m), zero on the joints that the effect leaves alone."""
    columns = effect_named(name).columns(motion, place, shape or {})
    assert columns is not None
    result = np.zeros((motion.samples, motion.n, columns.values.shape[2]))
    result[:, list(columns.joints)] = columns.values
    return result


def displaced(motion: Motion, links: PhysicalParameters, joint: int, by: FloatArray) -> FloatArray:
    """Pinocchio's torque when joint `joint` (from 0) is off by this (S,), with its exact rates, less that when not."""
    model = pinocchio_model(motion.robot, links)
    spectrum = np.fft.rfft(by)
    rotation = 2.0j * np.pi * np.fft.rfftfreq(by.size, motion.sampling_period_s)
    states = [motion.position.copy(), motion.velocity.copy(), motion.acceleration.copy()]
    for order, state in enumerate(states):
        state[:, joint] += np.fft.irfft(spectrum * rotation**order, n=by.size)
    return pinocchio_torque(model, *states) - pinocchio_torque(
        model, motion.position, motion.velocity, motion.acceleration
    )


@pytest.mark.parametrize("joint", [1, 2, 4, 6])
def test_elasticity_is_the_torque_at_the_position_behind_the_spring(
    motion: Motion, links: PhysicalParameters, joint: int
) -> None:
    model = pinocchio_model(motion.robot, links)
    load = pinocchio_torque(model, motion.position, motion.velocity, motion.acceleration)[:, joint - 1]
    stiffness = 1e6
    truth = displaced(motion, links, joint - 1, -load / stiffness) * stiffness
    ours = torque(motion, "joint_elasticity", Place(joint=joint))[..., 0]
    np.testing.assert_allclose(ours, truth, rtol=0.0, atol=2e-4 * np.abs(truth).max())


def test_a_hardening_spring_winds_up_by_the_root_of_its_cubic_law(motion: Motion, links: PhysicalParameters) -> None:
    model = pinocchio_model(motion.robot, links)
    load = pinocchio_torque(model, motion.position, motion.velocity, motion.acceleration)[:, 3]
    hard_from, stiffness = 0.5 * np.abs(load).max(), 1e6
    roots = [np.roots([1.0 / hard_from**2, 0.0, 1.0, -value]) for value in load]
    wind_up = np.array([float(root[np.abs(root.imag).argmin()].real) for root in roots]) / stiffness
    truth = displaced(motion, links, 3, -wind_up) * stiffness
    ours = torque(motion, "joint_elasticity", Place(joint=4), {"hardening_torque": hard_from})[..., 0]
    np.testing.assert_allclose(ours, truth, rtol=0.0, atol=2e-4 * np.abs(truth).max())


@pytest.mark.parametrize("joint", [2, 3, 6, 7])
def test_a_zero_offset_is_the_torque_at_the_other_angle(motion: Motion, links: PhysicalParameters, joint: int) -> None:
    truth = displaced(motion, links, joint - 1, np.full(motion.samples, 1e-5)) / 1e-5
    ours = torque(motion, "joint_zero_offset", Place(joint=joint))[..., 0]
    np.testing.assert_allclose(ours, truth, rtol=0.0, atol=1e-4 * np.abs(truth).max())


@pytest.mark.parametrize("joint", [2, 4, 6])
def test_large_displacements_are_not_linear_and_the_chord_follows(
    motion: Motion, links: PhysicalParameters, joint: int
) -> None:
    by = np.full(motion.samples, 0.05)
    truth = displaced(motion, links, joint - 1, by) / 0.05
    chord = torque(motion, "joint_zero_offset", Place(joint=joint), {"at_offset": 0.05})[..., 0]
    tangent = torque(motion, "joint_zero_offset", Place(joint=joint))[..., 0]
    largest = np.abs(truth).max()
    np.testing.assert_allclose(chord, truth, rtol=0.0, atol=1e-4 * largest)
    assert np.abs(tangent - truth).max() > 5e-3 * largest


def before_a_spring(
    link: Motion, links: PhysicalParameters, joint: int, compliance: float
) -> tuple[Motion, FloatArray, FloatArray]:
    """What a motor's encoder sees of a link's motion, the torque (S, n) of the link's motion, and that of the motor's.

    Pinocchio's torque with friction; the motor is ahead by the compliance times the torque of its joint.
    """
    model = pinocchio_model(link.robot, links)

    def with_friction(states: list[FloatArray]) -> FloatArray:
        return pinocchio_torque(model, *states) + links.viscous * states[1] + links.coulomb * np.sign(states[1])

    states = [link.position, link.velocity, link.acceleration]
    truth = with_friction(states)
    spectrum = np.fft.rfft(compliance * truth[:, joint])
    spectrum[-1] = 0.0  # its rate is not known from the samples
    rotation = 2.0j * np.pi * np.fft.rfftfreq(link.samples, link.sampling_period_s)
    states = [state.copy() for state in states]
    for order, state in enumerate(states):
        state[:, joint] += np.fft.irfft(spectrum * rotation**order, n=link.samples)
    position, velocity, acceleration = states
    seen = with_friction(states)
    motor = replace(link, position=position, velocity=velocity, acceleration=acceleration, torque=seen)
    return motor, truth, seen


@pytest.mark.parametrize("joint", [2, 4, 6])
def test_a_spring_carries_the_torque_of_the_links_own_motion_and_friction_that_turns_round(
    iiwa14: RobotModel, links: PhysicalParameters, joint: int
) -> None:
    link = shipped_motion(iiwa14, links, rate_hz=200.0)
    compliance = 0.03 / np.abs(link.torque[:, joint - 1]).max()
    motor, truth, seen = before_a_spring(link, links, joint - 1, compliance)
    shape = {"at_compliance": compliance, "hardening_torque": 1e9, "friction_behind": 1.0}
    ours = compliance * torque(motor, "joint_elasticity", Place(joint=joint), shape)[..., 0]
    # Within a few samples of a reversal the friction may have turned round in one and not yet in the other.
    moving = np.abs(link.velocity[:, joint - 1]) > 0.02
    assert moving.mean() > 0.8
    left = (seen + ours - truth)[moving]
    assert np.sqrt((left**2).mean()) < 0.02 * np.sqrt(((seen - truth)[moving] ** 2).mean())


def test_torque_does_not_depend_on_the_angle_about_a_vertical_first_axis(motion: Motion) -> None:
    assert effect_named("joint_zero_offset").columns(motion, Place(joint=1), {}) is None


def test_play_is_lost_on_the_side_that_the_load_presses_to(motion: Motion, links: PhysicalParameters) -> None:
    model = pinocchio_model(motion.robot, links)
    load = pinocchio_torque(model, motion.position, motion.velocity, motion.acceleration)[:, 1]
    width = 0.3 * np.abs(load).max()
    truth = displaced(motion, links, 1, -0.5e-6 * np.tanh(load / width)) / 1e-6
    ours = torque(motion, "backlash", Place(joint=2), {"crossing_torque": width})[..., 0]
    np.testing.assert_allclose(ours, truth, rtol=0.0, atol=1e-3 * np.abs(truth).max())


def test_backlash_says_nothing_about_a_joint_whose_torque_never_reverses(iiwa14: RobotModel) -> None:
    """A heavy last link held out level by joint 2, which moves by a few degrees."""
    links = random_links(7, 11)
    motion = motion_of(iiwa14, links, rate_hz=20.0)
    small = replace(
        motion,
        position=0.02 * motion.position + np.array([0.0, 1.2, 0.0, 0.0, 0.0, 0.0, 0.0]),
        velocity=0.02 * motion.velocity,
        acceleration=0.02 * motion.acceleration,
    )
    assert effect_named("backlash").columns(small, Place(joint=2), {"crossing_torque": 1.0}) is None


def test_bending_moments_are_mujocos_joint_forces(iiwa14: RobotModel) -> None:
    """An arm of three bodies in MuJoCo, its wrench between bodies moved to the joint's origin."""
    robot = sliding_robot()
    links = random_links(3, 4)
    motion = motion_of(robot, links, rate_hz=2.0)
    kinematics = robot.kinematics
    bodies = ""
    for link in range(3):
        turn = pinocchio.Quaternion(kinematics.rotation[link]).coeffs()
        moments = links.inertia[link]
        tensor = [moments[0, 0], moments[1, 1], moments[2, 2], moments[0, 1], moments[0, 2], moments[1, 2]]
        bodies += (
            f'<body name="{link}" pos="{words(kinematics.translation[link])}" quat="{words(turn[[3, 0, 1, 2]])}">'
            f'<joint type="{"hinge" if kinematics.revolute[link] else "slide"}" '
            f'axis="{words(kinematics.axis[link])}"/>'
            f'<inertial mass="{links.mass[link]}" pos="{words(links.center_of_mass[link])}" '
            f'fullinertia="{words(tensor)}"/>'
        )
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><option gravity='{words(robot.gravity)}'/><compiler angle='radian'/>"
        f"<worldbody>{bodies}{'</body>' * 3}</worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    bending = {
        joint: torque(motion, "bending_crosstalk", Place(joint=joint + 1), NO_SHIFT)[:, joint] for joint in (0, 2)
    }
    for sample in range(motion.samples):
        data.qpos[:], data.qvel[:] = motion.position[sample], motion.velocity[sample]
        data.qacc[:] = motion.acceleration[sample]
        mujoco.mj_inverse(model, data)
        mujoco.mj_rnePostConstraint(model, data)
        for joint in (0, 2):
            body = joint + 1
            lever = data.subtree_com[model.body_rootid[body]] - data.xpos[body]
            world = data.cfrc_int[body, :3] + np.cross(lever, data.cfrc_int[body, 3:])
            local = data.xmat[body].reshape(3, 3).T @ world
            ours = bending[joint][sample]
            axis = kinematics.axis[joint]
            # Both moments are across the axis, and together with it they make up the whole.
            across = local - (local @ axis) * axis
            assert np.linalg.norm(ours) == pytest.approx(np.linalg.norm(across), rel=1e-9)
            if joint == 0:  # about y: the two across are z and x
                np.testing.assert_allclose(ours, local[[2, 0]], rtol=0.0, atol=1e-9 * np.abs(local).max())


def test_what_no_torque_shows_of_a_link_is_made_up_for_in_the_bending_moments(
    motion: Motion, links: PhysicalParameters, iiwa14_base: BaseRegressor
) -> None:
    """The shortest parameters with the same torques have other moments; two numbers per joint turn them into the true.

    Not so at joint 1, where a level base hides more; what is left there is small.
    """
    shortest = np.linalg.pinv(iiwa14_base.regrouping) @ iiwa14_base.base_from_full(motion.full_parameters)
    fitted = replace(motion, full_parameters=shortest)
    difference = (motion.full_parameters - shortest).reshape(7, -1)
    np.testing.assert_allclose(rigid_torque(fitted).torque, rigid_torque(motion).torque, rtol=0.0, atol=1e-9)
    for joint in range(2, 8):
        place = Place(joint=joint)
        truth = torque(motion, "bending_crosstalk", place, NO_SHIFT)[:, joint - 1]
        hidden = bending_moments(motion)[:, joint - 1, :, 1:]
        apart = truth - torque(fitted, "bending_crosstalk", place, NO_SHIFT)[:, joint - 1]
        numbers = np.linalg.lstsq(hidden.reshape(-1, 2), apart.ravel(), rcond=None)[0]
        assert numbers[0] == pytest.approx(difference[joint - 1, 3], abs=1e-9)  # MZ
        shape = {"hidden_moment": float(numbers[0]), "hidden_inertia": float(numbers[1])}
        ours = torque(fitted, "bending_crosstalk", place, shape)[:, joint - 1]
        np.testing.assert_allclose(ours, truth, rtol=0.0, atol=1e-9)


def words(values: npt.ArrayLike) -> str:
    return " ".join(repr(float(value)) for value in np.asarray(values))


def test_a_leaning_base_is_seen_as_turned_gravity(motion: Motion, links: PhysicalParameters) -> None:
    model = pinocchio_model(motion.robot, links)
    states = motion.position, motion.velocity, motion.acceleration
    leaning = model.copy()
    lean = np.array([3e-6, -2e-6, 0.0])
    leaning.gravity.linear = pinocchio.exp3(lean).T @ model.gravity.linear
    truth = pinocchio_torque(leaning, *states) - pinocchio_torque(model, *states)
    ours = torque(motion, "base_tilt", Place()) @ lean[:2]
    np.testing.assert_allclose(ours, truth, rtol=0.0, atol=1e-4 * np.abs(truth).max())


@pytest.mark.parametrize("depth", [0.0, 0.6, -0.3])
@pytest.mark.parametrize("compliance", [(2e-8, 0.0, 0.0), (0.0, 2e-8, 0.0), (2e-8, 3e-8, 1e-8)])
def test_a_base_that_yields_is_an_arm_on_two_hinges_with_springs(
    motion: Motion, links: PhysicalParameters, compliance: tuple[float, float, float], depth: float
) -> None:
    arm, samples = pinocchio_model(motion.robot, links), motion.samples
    stand = pinocchio.Model()
    hinges = (pinocchio.JointModelRX(), pinocchio.JointModelRY())
    parent = 0
    for name, hinge in zip(("x", "y"), hinges, strict=True):
        parent = stand.addJoint(parent, hinge, pinocchio.SE3.Identity(), name)
    raised = pinocchio.SE3(np.eye(3), np.array([0.0, 0.0, depth]))
    for joint in range(1, arm.njoints):
        placement = raised * arm.jointPlacements[joint] if joint == 1 else arm.jointPlacements[joint]
        parent = stand.addJoint(parent, arm.joints[joint], placement, arm.names[joint])
        stand.appendBodyToJoint(parent, arm.inertias[joint], pinocchio.SE3.Identity())
    stand.gravity = arm.gravity
    rotation = 2.0j * np.pi * np.fft.rfftfreq(samples, motion.sampling_period_s)[:, None]
    arm_states = motion.position, motion.velocity, motion.acceleration
    lean = np.zeros((samples, 2))
    for _ in range(3):  # the springs carry the moment of the arm as it leans
        lines = np.fft.rfft(lean, axis=0)
        turned = [np.fft.irfft(lines * rotation**order, n=samples, axis=0) for order in range(3)]
        states = [np.hstack([base, own]) for base, own in zip(turned, arm_states, strict=True)]
        both = pinocchio_torque(stand, *states)
        about_x, about_y, about_both = compliance
        lean = -both[:, :2] @ np.array([[about_x, about_both], [about_both, about_y]])
    truth = both[:, 2:] - pinocchio_torque(arm, *arm_states)
    ours = torque(motion, "base_elasticity", Place(), {"pivot_depth": depth}) @ np.array(compliance)
    np.testing.assert_allclose(
        ours, truth, rtol=0.0, atol=1e-3 * np.abs(truth).max()
    )  # its low pass leaves out as much


def test_a_payload_is_what_pinocchio_adds_for_a_body_on_the_last_link(
    motion: Motion, links: PhysicalParameters
) -> None:
    model = pinocchio_model(motion.robot, links)
    states = motion.position, motion.velocity, motion.acceleration
    before = pinocchio_torque(model, *states)
    load = pinocchio.Inertia(2.0, np.array([0.01, 0.02, 0.1]), np.diag([0.01, 0.02, 0.025]))
    model.inertias[7] += load
    dynamic = load.toDynamicParameters()  # m, h, then Ixx Ixy Iyy Ixz Iyz Izz about the frame's origin
    ours = torque(motion, "payload", Place(link=7)) @ dynamic[[0, 1, 2, 3, 4, 5, 7, 6, 8, 9]]
    np.testing.assert_allclose(ours, pinocchio_torque(model, *states) - before, rtol=0.0, atol=1e-9)


def test_a_shared_motor_takes_as_much_power_as_its_friction_and_inertia(motion: Motion) -> None:
    """Virtual work: Σ τ q̇ = f(ω) ω with ω = q̇_j + r q̇_i, whatever the ratio."""
    for ratio in (-1.0, 1.0, 0.4):
        columns = torque(motion, "joint_coupling", Place(joint=6, other_joint=5), {"ratio": ratio})
        omega = motion.velocity[:, 5] + ratio * motion.velocity[:, 4]
        omega_dot = motion.acceleration[:, 5] + ratio * motion.acceleration[:, 4]
        power = np.einsum("sjm,sj->sm", columns, motion.velocity)
        law = np.column_stack([np.sign(omega), omega, omega_dot])
        np.testing.assert_allclose(power, law * omega[:, None], rtol=0.0, atol=1e-12)


def test_friction_columns_are_zero_at_rest_and_odd_or_even_in_the_velocity(motion: Motion) -> None:
    still = motion.velocity.copy()
    still[10] = 0.0
    forth, back = replace(motion, velocity=still), replace(motion, velocity=-still)
    cases: tuple[tuple[str, dict[str, float], float], ...] = (
        ("stribeck_friction", {"stribeck_velocity": 0.05, "exponent": 1.3}, -1.0),
        ("load_dependent_friction", {}, -1.0),
        ("position_dependent_friction", {}, -1.0),
        ("nonlinear_viscous_friction", {"exponent": 1.6}, -1.0),
        ("asymmetric_viscous_friction", {}, 1.0),
    )
    for name, shape, parity in cases:
        first, second = (torque(way, name, Place(joint=3), shape) for way in (forth, back))
        assert not first[10].any(), name
        np.testing.assert_array_equal(first, parity * second, err_msg=name)


def test_the_laws_of_one_joint_are_what_their_equations_say(motion: Motion) -> None:
    q, v, load = motion.position[:, 3], motion.velocity[:, 3], motion.torque[:, 3]
    s = np.sign(v)
    rms = np.sqrt(np.mean(load**2))
    expected: dict[str, tuple[dict[str, float], list[FloatArray]]] = {
        "torque_offset": ({}, [np.ones_like(q)]),
        "stribeck_friction": (
            {"stribeck_velocity": 0.05, "exponent": 2.0},
            [np.exp(-((v / 0.05) ** 2)) * s],
        ),
        "asymmetric_viscous_friction": ({}, [np.abs(v)]),
        "nonlinear_viscous_friction": ({"exponent": 2.0}, [v * np.abs(v)]),
        "load_dependent_friction": ({}, [np.abs(load) * s]),
        "position_dependent_friction": ({}, [np.sin(q) * s, np.cos(q) * s]),
        "position_dependent_torque": ({"order": 3.0}, [np.sin(3.0 * q), np.cos(3.0 * q)]),
        "cable_spring": ({}, [q, np.ones_like(q)]),
        "torque_ripple": (
            {"order": 159.3, "load_share": 0.5},
            [wave(159.3 * q) * (0.5 + 0.5 * np.abs(load) / rms) for wave in (np.sin, np.cos)],
        ),
        "torque_sensor_gain": ({}, [load]),
        "rotor_inertia": ({}, [motion.acceleration[:, 3]]),
    }
    for name, (shape, columns) in expected.items():
        ours = torque(motion, name, Place(joint=4), shape)
        np.testing.assert_allclose(ours[:, 3], np.column_stack(columns), rtol=0.0, atol=1e-12, err_msg=name)
        assert not np.delete(ours, 3, axis=1).any(), name
    crosstalk = torque(motion, "joint_crosstalk", Place(joint=4, other_joint=5))
    np.testing.assert_array_equal(crosstalk[:, 3, 0], motion.torque[:, 4])


def test_effects_that_see_no_torque_are_the_same_under_any(motion: Motion) -> None:
    other = replace(motion, torque=motion.torque**2 + 1.0, full_parameters=-2.0 * motion.full_parameters)
    blind = [effect for effect in EFFECTS if effect.stage == "repeatable" and not effect.sees_torque]
    assert len(blind) > 10
    for effect in blind:
        place = effect.places(motion)[-1]
        assert effect.shape_parameters(motion, place) == effect.shape_parameters(other, place), effect.name
        shape = {item.name: item.grid[0] for item in effect.shape_parameters(motion, place)}
        first, second = (effect.columns(way, place, shape) for way in (motion, other))
        assert first is not None, effect.name
        assert second is not None, effect.name
        np.testing.assert_array_equal(first.values, second.values, err_msg=effect.name)
