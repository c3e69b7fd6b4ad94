"""Claims about forward simulation. Truth: closed forms of one-joint systems, conservation of energy, and MuJoCo's own
simulation of the exported arm under the same controller.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import pinocchio
import pytest
from scipy.special import ellipk

from identification.errors import SimulationError
from identification.excitation import default_trajectory
from identification.export.parameters import ModelParameters
from identification.export.write import export_model
from identification.physical_parameters import PhysicalParameters
from identification.robots import RobotModel, load_robot, robot_from_urdf
from identification.simulation.comparison import inverse_dynamics
from identification.simulation.controllers import (
    ComputedTorque,
    Controller,
    JointImpedance,
    PositionLoop,
    SetPoint,
    State,
    controller_named,
)
from identification.simulation.motor_inertia import motor_inertia_of
from identification.simulation.simulate import SimulationSettings, simulate
from tests.identification.exported import consistent, model_of

MOTORS = np.array([4.4, 4.4, 2.42, 2.42, 1.5125, 0.55, 0.55])


@dataclass(frozen=True)
class ConstantTorque:
    """A motor that gives the same torque whatever happens."""

    value: float = 0.0

    def torque(self, model: object, data: object, state: State, set_point: SetPoint) -> np.ndarray:  # noqa: ARG002
        return np.full_like(state.position, self.value)

    def sentence(self) -> str:
        return ""


@dataclass(frozen=True)
class Start:
    """A commanded motion that only says where to begin: position + velocity · t."""

    position: np.ndarray
    velocity: np.ndarray
    period_s: float = 1.0

    def evaluate(self, time_s: object) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        time = np.atleast_1d(time_s)[:, None]
        velocity = np.broadcast_to(self.velocity, (len(time), len(self.position)))
        return self.position + velocity * time, velocity, np.zeros_like(velocity)


def one_joint(axis: str, kind: str = "continuous") -> RobotModel:
    limit = '<limit lower="-9" upper="9" effort="1" velocity="1"/>'
    return robot_from_urdf(
        f"<robot name='one'><link name='a'/><link name='b'/><joint name='j' type='{kind}'><parent link='a'/>"
        f"<child link='b'/><axis xyz='{axis}'/>{limit}</joint></robot>",
        source="text",
    )


def bob(viscous: float = 0.0, coulomb: float = 0.0) -> PhysicalParameters:
    """2 kg at 0.5 m along −z, and next to no inertia of its own."""
    return PhysicalParameters(
        np.array([2.0]), np.array([[0.0, 0.0, -0.5]]), 1e-9 * np.eye(3)[None], np.array([viscous]), np.array([coulomb])
    )


def test_a_pendulum_swings_with_the_period_of_the_elliptic_integral() -> None:
    amplitude = 2.0
    period = 4.0 * np.sqrt(0.5 / 9.81) * ellipk(np.sin(amplitude / 2.0) ** 2)
    result = simulate(
        one_joint("0 1 0"), bob(), Start(np.array([amplitude]), np.zeros(1)), ConstantTorque(),
        settings=SimulationSettings(duration_s=3.0 * period),
    )  # fmt: skip
    q, v, t = result.position[:, 0], result.velocity[:, 0], result.time
    tops = [i for i in range(1, len(t)) if v[i - 1] > 0.0 >= v[i]]
    crossing = [t[i - 1] + 1e-3 * v[i - 1] / (v[i - 1] - v[i]) for i in tops]
    assert np.diff([0.0, *crossing]) == pytest.approx(period, abs=1e-6)
    assert np.abs(q).max() == pytest.approx(amplitude, abs=1e-9)


def test_the_unforced_frictionless_arm_keeps_its_energy(table3: PhysicalParameters) -> None:
    physical = consistent(table3)
    free = PhysicalParameters(physical.mass, physical.center_of_mass, physical.inertia, np.zeros(7), np.zeros(7))
    robot = load_robot("iiwa14")
    model = ModelParameters(free, 0.1 * MOTORS, np.zeros(7)).pinocchio_model(robot)
    data = model.createData()
    start = Start(np.array([0.1, 1.0, 0.2, -1.0, 0.3, 0.5, 0.1]), np.full(7, 0.3))
    drifts = []
    for step in (0.002, 0.001):
        settings = SimulationSettings(motor_inertia=0.1 * MOTORS, duration_s=1.0, step_s=step)
        result = simulate(robot, free, start, ConstantTorque(), settings=settings)
        energy = [
            pinocchio.computeKineticEnergy(model, data, q, v) + pinocchio.computePotentialEnergy(model, data, q)
            for q, v in zip(result.position, result.velocity, strict=True)
        ]
        drifts.append(np.abs(np.array(energy) - energy[0]).max())
    assert np.abs(result.velocity).max() > 1.0
    assert drifts[1] < 1e-7
    # fourth order: half the step, about a sixteenth of the error (down to rounding)
    assert drifts[1] < drifts[0] / 8.0 + 1e-12


def test_viscous_friction_alone_brakes_exponentially() -> None:
    robot, inertia = one_joint("0 0 1"), 0.3
    physical = PhysicalParameters(np.ones(1), np.zeros((1, 3)), inertia * np.eye(3)[None], np.array([0.6]), np.zeros(1))
    result = simulate(robot, physical, Start(np.zeros(1), np.array([2.0])), ConstantTorque())
    assert np.allclose(result.velocity[:, 0], 2.0 * np.exp(-0.6 / inertia * result.time), rtol=0.0, atol=1e-10)
    assert np.allclose(result.torque, 0.0, atol=1e-12)


@pytest.mark.parametrize("inertia", [0.1, 0.01, 0.001])
def test_a_controller_that_is_too_stiff_for_its_steps_is_said_to_chatter(inertia: float) -> None:
    """3000 Nm/rad on a light joint, bounded by its dry friction alone, and nothing said so. With the torque held over
    a step h, q and v go over into [[1 − h²k/2, h − h²d/2], [−hk, 1 − hd]] of them, k = K/I, d = D/I.
    """
    h, k, d = 1e-3, 3000.0 / inertia, 1.4 * np.sqrt(3000.0 / inertia)
    step = np.array([[1.0 - h**2 * k / 2.0, h - h**2 * d / 2.0], [-h * k, 1.0 - h * d]])
    dry = np.array([0.5])
    physical = PhysicalParameters(np.ones(1), np.zeros((1, 3)), inertia * np.eye(3)[None], np.zeros(1), dry)
    start, settings = Start(np.zeros(1), np.full(1, 0.1)), SimulationSettings(duration_s=0.01)
    result = simulate(one_joint("0 0 1"), physical, start, JointImpedance(3000.0), settings=settings)
    assert result.growth == pytest.approx(float(np.abs(np.linalg.eigvals(step)).max()), rel=1e-4)
    assert bool(result.chatter) == (inertia == 0.001)


@pytest.mark.parametrize("width", [0.1, 1e-4])
def test_friction_that_turns_over_gently_brakes_by_its_own_law(width: float) -> None:
    """I q̈ = −F tanh(q̇/v): sinh(q̇/v) falls exponentially. A width that no step can follow is as sharp as sign(q̇)."""
    robot, inertia, friction, speed = one_joint("0 0 1"), 0.5, 0.4, 0.37
    physical = PhysicalParameters(
        np.ones(1), np.zeros((1, 3)), inertia * np.eye(3)[None], np.zeros(1), np.array([friction])
    )
    start, settings = Start(np.zeros(1), np.array([speed])), SimulationSettings(coulomb_velocity=width)
    result = simulate(robot, physical, start, ConstantTorque(), settings=settings)
    if width < 1e-3:
        sharp = simulate(robot, physical, start, ConstantTorque())
        np.testing.assert_array_equal(result.velocity, sharp.velocity)
        return
    falling = np.sinh(speed / width) * np.exp(-friction / (inertia * width) * result.time)
    np.testing.assert_allclose(result.velocity[:, 0], width * np.arcsinh(falling), rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("kind", ["continuous", "prismatic"])
def test_dry_friction_stops_a_joint_at_the_right_time_and_place_and_holds_it(kind: str) -> None:
    robot, inertia, friction, speed = one_joint("0 0 1" if kind == "continuous" else "1 0 0", kind), 0.5, 0.4, 0.37
    physical = PhysicalParameters(
        np.array([inertia]), np.zeros((1, 3)), inertia * np.eye(3)[None], np.zeros(1), np.array([friction])
    )
    result = simulate(robot, physical, Start(np.zeros(1), np.array([speed])), ConstantTorque())
    stop, distance = speed * inertia / friction, speed**2 * inertia / (2.0 * friction)
    expected = speed - friction / inertia * result.time
    moving = result.time < stop - 1e-3
    assert np.allclose(result.velocity[moving, 0], expected[moving], rtol=0.0, atol=1e-12)
    assert np.all(result.velocity[result.time > stop + 1e-3] == 0.0)
    assert result.position[-1, 0] == pytest.approx(distance, abs=speed * 1e-3)
    assert np.ptp(result.position[result.time > stop + 1e-3]) == 0.0


def test_a_joint_sticks_until_the_torque_exceeds_its_dry_friction() -> None:
    """A pendulum held out by friction: m g l sin q = 9.81 · sin q Nm against 5 Nm."""
    robot, held = one_joint("0 1 0"), bob(coulomb=5.0)
    for angle, moves in ((0.5, False), (0.56, True)):
        assert (9.81 * np.sin(angle) > 5.0) == moves
        result = simulate(robot, held, Start(np.array([angle]), np.zeros(1)), ConstantTorque())
        assert (np.ptp(result.position) > 1e-3) == moves
    # At rest the sensor shows no motor torque, so friction carries gravity: ±F_s is not assumed.
    still = simulate(robot, held, Start(np.array([0.5]), np.zeros(1)), ConstantTorque())
    assert np.allclose(still.torque, 0.0, atol=1e-9)


def test_friction_that_the_controller_does_not_know_becomes_a_position_error() -> None:
    """Constant speed: the error is (F_v q̇ + F_s) / (M ω²), M with the motor; the sensor shows the friction alone."""
    robot, speed = one_joint("0 0 1"), 0.2
    physical = PhysicalParameters(np.ones(1), np.zeros((1, 3)), 0.5 * np.eye(3)[None], np.array([0.3]), np.array([0.2]))
    settings = SimulationSettings(motor_inertia=np.array([1.5]), duration_s=3.0)
    result = simulate(robot, physical, Start(np.zeros(1), np.array([speed])), ComputedTorque(2.0), settings=settings)
    friction = 0.3 * speed + 0.2
    error = result.reference_position[-1, 0] - result.position[-1, 0]
    assert error == pytest.approx(friction / (2.0 * (4.0 * np.pi) ** 2), rel=1e-6)
    assert result.torque[-1, 0] == pytest.approx(friction, abs=1e-6)


def test_an_effect_moves_the_arm_and_is_seen_by_the_sensor() -> None:
    """A spring k q held at q_r by impedance K: q = K q_r / (K + k); the sensor shows k q."""
    robot, k, stiffness = one_joint("0 0 1"), 20.0, 300.0
    physical = PhysicalParameters(np.ones(1), np.zeros((1, 3)), 0.5 * np.eye(3)[None], np.zeros(1), np.zeros(1))
    result = simulate(
        robot, physical, Start(np.array([0.4]), np.zeros(1)), JointImpedance(stiffness),
        extra_torque=lambda state: k * state.position, settings=SimulationSettings(duration_s=3.0),
    )  # fmt: skip
    rest = stiffness * 0.4 / (stiffness + k)
    assert result.position[-1, 0] == pytest.approx(rest, rel=1e-6)
    assert result.torque[-1, 0] == pytest.approx(k * rest, rel=1e-6)


class Later:
    """The shipped excitation from two seconds on, where joints turn around."""

    period_s = 1.0

    def evaluate(self, time_s: object) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return default_trajectory().scaled(0.5).evaluate(np.asarray(time_s) + 2.0)


def by_mujoco(file: Path, known: pinocchio.Model, controller: Controller) -> tuple[np.ndarray, np.ndarray]:
    """Positions and motor torques (1000, 7) of MuJoCo's own simulation, the controller's torque held for 1 ms."""
    model = mujoco.MjModel.from_xml_path(str(file))
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    data, known_data = mujoco.MjData(model), known.createData()
    references = list(zip(*Later().evaluate(np.arange(1000) * 1e-3), strict=True))
    data.qpos[:], data.qvel[:] = references[0][:2]
    positions, torques = np.empty((2, 1000, 7))
    for row, reference in enumerate(references):
        state = State(row * 1e-3, data.qpos.copy(), data.qvel.copy())
        data.qfrc_applied[:] = controller.torque(known, known_data, state, SetPoint(*reference))
        positions[row], torques[row] = data.qpos, data.qfrc_applied
        mujoco.mj_step(model, data)
    return positions, torques


@pytest.mark.parametrize("controller", [ComputedTorque(), PositionLoop(), JointImpedance()])
def test_mujoco_simulates_the_exported_arm_alike(
    controller: Controller, tmp_path: Path, table3: PhysicalParameters
) -> None:
    """Exactly without dry friction; with it, to a fiftieth (RMS) of what dry friction does."""
    robot, rough = load_robot("iiwa14"), consistent(table3)
    smooth = PhysicalParameters(rough.mass, rough.center_of_mass, rough.inertia, rough.viscous, np.zeros(7))
    settings = SimulationSettings(motor_inertia=MOTORS)
    known = ModelParameters(rough, MOTORS, np.zeros(7)).pinocchio_model(robot)
    ours, theirs = [], []
    for physical in (smooth, rough):
        given = model_of(tmp_path, "iiwa14", physical)
        export_model(given, tmp_path / "arm.xml", "mjcf", parameter_set="physical", motor_inertia=MOTORS)
        theirs.append(by_mujoco(tmp_path / "arm.xml", known, controller))
        result = simulate(robot, physical, Later(), controller, settings=settings)
        ours.append((result.position, result.motor_torque))
    for quantity in (0, 1):
        assert np.abs(ours[0][quantity] - theirs[0][quantity]).max() < 1e-9
        effect, difference = (
            np.sqrt(np.mean((ours[1][quantity] - other[quantity]) ** 2)) for other in (ours[0], theirs[1])
        )
        assert difference < 0.02 * effect


def test_the_sensor_behind_the_gear_does_not_see_its_motor(table3: PhysicalParameters) -> None:
    physical, robot, motion = consistent(table3), load_robot("iiwa14"), default_trajectory()
    results = [
        simulate(
            robot, physical, motion, PositionLoop(),
            settings=SimulationSettings(motor_inertia=MOTORS, motor_inertia_in_torque=seen, duration_s=0.3),
        )
        for seen in (False, True)
    ]  # fmt: skip
    assert np.array_equal(results[0].position, results[1].position)
    assert np.allclose(results[1].torque - results[0].torque, MOTORS * results[0].acceleration, atol=1e-9)
    # at the motor side the sensor shows what the controller asked for
    assert np.allclose(results[1].torque, results[1].motor_torque, atol=1e-9)


def test_gains_that_make_the_arm_run_away_are_reported_with_time_and_joint(table3: PhysicalParameters) -> None:
    with pytest.raises(SimulationError) as caught:
        simulate(
            load_robot("iiwa14"), consistent(table3), default_trajectory(), controller_named("impedance", stiffness=1e6)
        )
    assert 1 <= caught.value.joint <= 7
    assert caught.value.exit_code == 1


def test_motor_inertias_are_identified_ones_where_there_are_any_else_a_prior_that_says_so(
    table3: PhysicalParameters,
) -> None:
    robot = load_robot("iiwa14")
    values, sentence = motor_inertia_of(robot, ModelParameters(table3, np.zeros(7), np.zeros(7)))
    assert values == pytest.approx(MOTORS, abs=1e-12)
    assert "prior" in sentence
    values, sentence = motor_inertia_of(robot, ModelParameters(table3, np.full(7, 0.3), np.zeros(7)))
    assert np.all(values == 0.3)
    assert "identified" in sentence


def test_rotors_identified_on_some_joints_count_in_the_torque_of_these_joints(table3: PhysicalParameters) -> None:
    """Truth: a rotor adds I q̈ to its own joint's torque, and nothing to another's."""
    robot, some = load_robot("iiwa14"), np.array([0.3, 0.0, 0.0, 0.0, 0.2, 0.0, 0.0])
    values, sentence = motor_inertia_of(robot, ModelParameters(table3, some, np.zeros(7)))
    assert values == pytest.approx(np.where(some > 0.0, some, MOTORS), abs=1e-12)
    assert "of joints 2, 3, 4, 6, 7 are no identified numbers but a prior (4.4, 2.42, 2.42, 0.55, 0.55" in sentence
    q, dq, ddq = np.random.default_rng(5).uniform(-1.0, 1.0, (3, 4, 7))
    known = ModelParameters(consistent(table3), some, np.zeros(7))
    settings = SimulationSettings(motor_inertia=values, motor_inertia_in_torque=some > 0.0, duration_s=0.05)
    bare = inverse_dynamics(robot, known, q, dq, ddq, SimulationSettings())
    assert inverse_dynamics(robot, known, q, dq, ddq, settings) - bare == pytest.approx(some * ddq, abs=1e-12)
    result = simulate(robot, known.physical, default_trajectory(), PositionLoop(), settings=settings)
    unseen = np.where(some > 0.0, 0.0, MOTORS)
    assert result.motor_torque - result.torque == pytest.approx(unseen * result.acceleration, abs=1e-9)
