"""Recordings beside a simulator's file: rotors that it does not have, a torque that is late, a clock.

Truth: the closed form of the paper's arm, rotors, friction and noise added.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from identification.audit.audit import audit
from identification.audit.difference import Difference, Number
from identification.base_parameters import BaseRegressor, RegressorOptions
from identification.export.amend import amend
from identification.export.write import export_model
from identification.physical_parameters import PhysicalParameters
from identification.recordings import Recording
from identification.robots import RobotModel
from identification.robots.simulator_models import read_simulator_model
from tests.identification.exported import consistent, model_of
from tests.identification.synthetic import fourier_motion, inverse_dynamics, recording_of

ROTORS = np.array([0.6, 0.9, 0.5, 0.4, 0.12, 0.1, 0.08])
LATE_S = 0.015


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory, table3: PhysicalParameters) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("arm")
    model = model_of(folder, "iiwa14", consistent(table3))
    names = {"urdf": folder / "arm.urdf", "mjcf": folder / "arm.xml"}
    for form, path in names.items():
        export_model(model, path, form, parameter_set="physical")
    return names


def record(robot: RobotModel, plant: PhysicalParameters, rotors: np.ndarray, late_s: float = 0.0) -> Recording:
    q, dq, ddq = fourier_motion(7, period_s=20.0, samples=4000, seed=4)
    torque = inverse_dynamics(robot, plant, q, dq, ddq) + rotors * ddq
    turn = np.exp(-2j * np.pi * np.fft.rfftfreq(4000, 0.005)[:, None] * late_s)
    torque = np.fft.irfft(turn * np.fft.rfft(torque, axis=0), n=4000, axis=0)
    return recording_of(q, torque + 0.1 * np.random.default_rng(5).standard_normal(q.shape), period_s=20.0)


def test_rotors_that_a_file_has_no_place_for_are_one_cause_with_their_numbers(
    iiwa14: RobotModel, table3: PhysicalParameters, files: dict[str, Path]
) -> None:
    """They were told joint by joint, five of them at most, or as torque that is 39 to 69 ms early."""
    found = audit([record(iiwa14, consistent(table3), ROTORS)], iiwa14, files["urdf"])
    (one,) = found.differences
    assert (one.effect, one.joint, found.verdict) == ("rotor_inertia", None, "named")
    assert set(one.joints) >= {1, 2, 3, 4}
    for joint, number in zip(one.joints, one.numbers, strict=True):
        assert number.interval[0] <= ROTORS[joint - 1] <= number.interval[1]
    assert "arm.urdf has no rotor inertias: those of joints 1" in one.sentence


def test_beside_rotors_a_late_torque_is_late_and_without_any_none_is_named(
    iiwa14: RobotModel, table3: PhysicalParameters, files: dict[str, Path]
) -> None:
    late = audit([record(iiwa14, consistent(table3), ROTORS, LATE_S)], iiwa14, files["urdf"])
    assert {item.effect for item in late.differences} == {"rotor_inertia", "torque_delay"}
    (delay,) = (item for item in late.differences if item.effect == "torque_delay")
    assert delay.numbers[0].value == pytest.approx(LATE_S, abs=2e-3)
    assert not audit([record(iiwa14, consistent(table3), 0.0 * ROTORS)], iiwa14, files["urdf"]).differences


@pytest.mark.parametrize(("late_s", "named"), [(0.002, []), (0.008, ["torque_delay"])])
def test_a_cycle_or_two_of_a_logger_is_no_late_torque_beside_a_file(
    iiwa14: RobotModel, table3: PhysicalParameters, files: dict[str, Path], late_s: float, named: list[str]
) -> None:
    """A file does not say how its torque would be read, no more than two runs are read alike."""
    found = audit([record(iiwa14, consistent(table3), 0.0 * ROTORS, late_s)], iiwa14, files["urdf"])
    assert [item.effect for item in found.differences] == named


@pytest.mark.parametrize("with_velocity", [False, True])
def test_a_velocity_that_goes_with_the_positions_has_the_clock_right(
    iiwa14: RobotModel, table3: PhysicalParameters, files: dict[str, Path], with_velocity: bool
) -> None:
    """A clock of 4 % was told of a sound recording whose velocity said that there is none."""
    q, dq, ddq = fourier_motion(7, period_s=20.0, samples=4000, seed=4)
    torque = inverse_dynamics(iiwa14, consistent(table3), q, 0.8 * dq, 0.64 * ddq)
    torque += 0.1 * np.random.default_rng(5).standard_normal(q.shape)
    recording = recording_of(q, torque, period_s=20.0)
    found = audit([replace(recording, velocity=dq if with_velocity else None)], iiwa14, files["urdf"])
    assert ("wrong_time_base" in [item.effect for item in found.differences]) == (not with_velocity)


def test_they_are_written_into_a_file_that_has_a_place_for_them(
    iiwa14: RobotModel, files: dict[str, Path], tmp_path: Path
) -> None:
    numbers = tuple(Number(f"rotor_inertia_{joint}", ROTORS[joint - 1], 0.01, "kg m^2") for joint in (2, 5))
    found = Difference("rotor_inertia", None, None, numbers, 1.0, 99.0, "model", "Rotors.", joints=(2, 5))
    regressor = BaseRegressor(iiwa14, RegressorOptions(rotor_inertia=True))
    amended = amend(files["mjcf"], [found], iiwa14, tmp_path / "fixed.xml")
    assert amended.written == ("Rotors.",)
    before, after = (read_simulator_model(path, regressor) for path in (files["mjcf"], tmp_path / "fixed.xml"))
    _, _, acceleration = fourier_motion(7, period_s=20.0, samples=50, seed=1)
    states = fourier_motion(7, period_s=20.0, samples=50, seed=1)
    more = (regressor.matrix(*states) @ (after - before)).reshape(-1, 7)
    expected = np.where(np.isin(np.arange(7), (1, 4)), ROTORS, 0.0) * acceleration
    np.testing.assert_allclose(more, expected, atol=1e-6 * np.abs(expected).max())
