"""Claims about a simulation beside a recording. Truth: recordings computed here from known numbers and noise."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from identification.excitation import default_trajectory
from identification.export.parameters import ModelParameters
from identification.fitting.settings import FitSettings
from identification.physical_parameters import PhysicalParameters
from identification.recordings import Recording
from identification.robots import load_robot
from identification.simulation.comparison import SampledMotion, compare_with_plan, compare_with_recording
from identification.simulation.controllers import ComputedTorque, JointImpedance, PositionLoop
from identification.simulation.figure import draw_comparison, save_figure
from identification.simulation.simulate import SimulationSettings, simulate
from tests.identification.exported import consistent, random_bodies
from tests.identification.synthetic import fourier_motion, inverse_dynamics, recording_of

MOTORS = np.array([4.4, 4.4, 2.42, 2.42, 1.5125, 0.55, 0.55])
SETTINGS = SimulationSettings(motor_inertia=MOTORS)
NOISE = 0.05


@pytest.fixture(scope="module")
def recorded(table3: PhysicalParameters) -> tuple[Recording, ModelParameters]:
    """Two periods of 4 s of a perfectly tracked motion with white noise at the sensor."""
    physical, robot = consistent(table3), load_robot("iiwa14")
    motion = fourier_motion(7, period_s=4.0, samples=2000, seed=4)
    torque = np.tile(inverse_dynamics(robot, physical, *motion), (2, 1))
    torque += np.random.default_rng(1).normal(scale=NOISE, size=torque.shape)
    position = np.tile(motion[0], (2, 1))
    recording = recording_of(position, torque, period_s=4.0, periods=2)
    return replace(recording, command_position=position), ModelParameters(physical, np.zeros(7), np.zeros(7))


def test_the_true_model_leaves_noise_and_the_loop_adds_what_friction_costs(
    recorded: tuple[Recording, ModelParameters],
) -> None:
    recording, parameters = recorded
    comparison = compare_with_recording(recording, load_robot("iiwa14"), parameters, ComputedTorque(2.0), SETTINGS)
    rms = comparison.torque_rms()
    assert rms.row("measured minus inverse dynamics").rms_nm == pytest.approx(NOISE / np.sqrt(2.0), rel=0.1)
    assert comparison.noise_floor_nm == pytest.approx(NOISE / np.sqrt(2.0), rel=0.1)
    # The controller neglects friction (section 4.6 of the paper): the simulated arm fits worse than inverse dynamics.
    assert rms.row("measured minus simulated").total_nm > rms.row("measured minus inverse dynamics").total_nm
    friction = np.abs(parameters.friction(np.full(7, 0.6)))
    error = comparison.position_rms()["simulated minus commanded"]
    inertia = MOTORS * (4.0 * np.pi) ** 2
    assert np.all(error < friction / inertia * 1.5)
    assert comparison.position_rms()["measured minus commanded"].max() < 1e-12


def test_a_recording_is_read_as_the_fit_of_the_model_read_its_own(
    recorded: tuple[Recording, ModelParameters],
) -> None:
    """Sign, delay and the width of friction were left out: a right model left twice the torque."""
    recording, parameters = recorded
    width, late = 0.15, 5
    rate = np.gradient(recording.position, recording.sampling_period_s, axis=0)
    gentler = parameters.physical.coulomb * (np.tanh(rate / width) - np.sign(rate))
    given = replace(recording, torque=-np.roll(recording.torque + gentler, late, axis=0))
    comparison = compare_with_recording(
        given, load_robot("iiwa14"), parameters, ComputedTorque(2.0), replace(SETTINGS, coulomb_velocity=width),
        fitted=FitSettings(flip_torque=True), torque_shift=np.full(7, late * recording.sampling_period_s),
    )  # fmt: skip
    left = comparison.torque_rms().row("measured minus inverse dynamics")
    assert left.rms_nm == pytest.approx(NOISE / np.sqrt(2.0), rel=0.1)


def test_an_effect_changes_the_motion_as_the_controller_lets_it_and_the_torque_alike(
    table3: PhysicalParameters,
) -> None:
    """Why effects are diagnosed in torque: a hose of 0.15 Nm/rad at joint 6 under a stiff and a soft controller."""
    robot, physical, motion = load_robot("iiwa14"), consistent(table3), default_trajectory()
    hose = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.15, 0.0])
    moved, felt = [], []
    for controller in (PositionLoop(8.0), JointImpedance(300.0)):
        without, with_hose = (
            simulate(robot, physical, motion, controller, extra_torque=extra, settings=SETTINGS)
            for extra in (None, lambda state: hose * state.position)
        )
        moved.append(np.sqrt(np.mean((with_hose.position - without.position)[:, 5] ** 2)))
        felt.append(np.sqrt(np.mean((with_hose.torque - without.torque)[:, 5] ** 2)))
    assert moved[1] > 3.0 * moved[0]
    assert felt[1] == pytest.approx(felt[0], rel=0.1)


def test_an_effect_given_to_the_simulation_explains_a_recording_that_has_it(
    recorded: tuple[Recording, ModelParameters],
) -> None:
    recording, parameters = recorded
    robot = load_robot("iiwa14")
    spring = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 2.0, 0.0])
    with_effect = replace(recording, torque=recording.torque + spring * recording.position)
    sums = [
        compare_with_recording(with_effect, robot, parameters, PositionLoop(), SETTINGS, extra_torque=extra)
        .torque_rms().row("measured minus simulated").rms_nm[5]
        for extra in (None, lambda state: spring * state.position)
    ]  # fmt: skip
    assert sums[1] < 0.2 * sums[0]


def test_a_recording_without_periods_or_commands_is_followed_along_its_measured_motion() -> None:
    """A 400 Hz recording of another arm: the simulation takes whole steps of at most 1 ms between its samples."""
    robot, physical = load_robot("iiwa7"), random_bodies(7, 3)
    motion = fourier_motion(7, period_s=5.0, samples=2000, seed=9, speed=0.3)
    torque = inverse_dynamics(robot, physical, *motion)
    recording = recording_of(motion[0], torque, period_s=5.0, robot="iiwa7")
    recording = replace(
        recording,
        period_index=None,
        sample_in_period=None,
        period_s=None,
        samples_per_period=None,
        command_position=None,
    )
    parameters = ModelParameters(physical, np.zeros(7), np.zeros(7))
    comparison = compare_with_recording(recording, robot, parameters, PositionLoop(), SETTINGS)
    assert "measured motion" in comparison.sentences[0]
    assert comparison.result.time[1] == pytest.approx(0.0025 / 3.0)
    assert comparison.simulated_position.shape == comparison.measured_position.shape
    percent = comparison.torque_rms().row("measured minus inverse dynamics").percent
    assert np.all(percent < 5.0)


def test_sampled_motions_repeat_or_stand_still_beyond_their_ends() -> None:
    time = np.arange(100) * 0.01
    position, velocity = np.sin(2 * np.pi * time)[:, None], 2 * np.pi * np.cos(2 * np.pi * time)[:, None]
    periodic = SampledMotion(time, position, velocity, 1.0, True)
    q, dq, ddq = periodic.evaluate(np.array([-0.35, 7.123]))
    phase = 2 * np.pi * np.array([-0.35, 7.123])[:, None]
    assert np.allclose(q, np.sin(phase), atol=1e-6)
    assert np.allclose(dq, 2 * np.pi * np.cos(phase), atol=1e-3)
    assert np.allclose(ddq, -((2 * np.pi) ** 2) * np.sin(phase), atol=0.1)
    once = SampledMotion(time, position, velocity, time[-1], False)
    q, dq, ddq = once.evaluate(np.array([-1.0, 2.0]))
    assert np.allclose(q[:, 0], position[[0, -1], 0], atol=1e-12)
    assert not dq.any()
    assert not ddq.any()


def test_a_plan_is_compared_with_its_own_inverse_dynamics_and_drawn(tmp_path: Path, table3: PhysicalParameters) -> None:
    parameters = ModelParameters(consistent(table3), np.zeros(7), np.zeros(7))
    robot, motion = load_robot("iiwa14"), default_trajectory().scaled(0.3)
    comparison = compare_with_plan(motion, robot, parameters, PositionLoop(20.0), SETTINGS)
    expected = inverse_dynamics(robot, parameters.physical, *motion.evaluate(comparison.time))
    assert np.allclose(comparison.inverse_dynamics_torque, expected, atol=1e-9)
    assert comparison.measured_torque is None
    summary = comparison.to_json()
    assert [row["label"] for row in summary["torque_rms"]] == ["inverse dynamics minus simulated"]
    assert summary["noise_floor_nm"] == [None] * 7
    save_figure(draw_comparison(comparison, "title"), tmp_path / "figure.svg")
    text = (tmp_path / "figure.svg").read_text()
    assert text.lstrip().startswith("<?xml")
