"""Claims about an arm of two joints that moves in one vertical plane, where gravity acts along two directions only.

Truth: Pinocchio's torque with the friction, the load or the gravity that the test puts in.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from identification.audit import audit
from identification.model_file import Model, read_model, write_model
from identification.physical_parameters import PhysicalParameters
from identification.recording_fit import FitSettings, fit_recordings
from identification.recordings import Recording, read_recording
from identification.robots import Installation, load_robot
from tests.identification.synthetic import fourier_motion, inverse_dynamics

URDF = """<robot name="plane"><link name="base"/><link name="upper"/><link name="lower"/>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" effort="200" velocity="4"/></joint>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/>
<origin xyz="0 0 0.5"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" effort="100" velocity="4"/></joint></robot>"""
LINKS = PhysicalParameters(
    np.array([4.0, 2.0]), np.array([[0.01, 0.0, 0.25], [0.0, 0.0, 0.2]]),
    np.array([np.diag([0.05, 0.05, 0.01]), np.diag([0.02, 0.02, 0.005])]), np.array([0.5, 0.3]), np.array([0.8, 0.4]),
)  # fmt: skip
LEANING_RAD = 0.1


def recorded(folder: Path, seed: int, links: PhysicalParameters = LINKS, leaning_rad: float = 0.0) -> Recording:
    (folder / "plane.urdf").write_text(URDF)
    down = (9.81 * np.sin(leaning_rad), 0.0, -9.81 * np.cos(leaning_rad))
    robot = load_robot(folder / "plane.urdf", Installation(down))
    states = fourier_motion(2, period_s=20.0, samples=2000, seed=seed, speed=0.9)
    torque = inverse_dynamics(robot, links, *states) + np.random.default_rng(seed).normal(scale=0.05, size=(2000, 2))
    file = folder / f"{seed}.npz"
    np.savez(file, t=np.arange(2000) * 0.01, q=states[0], tau=torque, robot="plane.urdf")
    return read_recording(file)


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Model:
    folder = tmp_path_factory.mktemp("plane")
    first = recorded(folder, 1)
    result = fit_recordings([first], load_robot(folder / "plane.urdf"), FitSettings(physical=False))
    return read_model(write_model(result.to_model_json(notes=False), folder / "model.json"))


def test_more_friction_is_named(model: Model, tmp_path: Path) -> None:
    found = audit([recorded(tmp_path, 2, replace(LINKS, viscous=np.array([0.5, 1.2])))], model.load_robot(), model)
    (only,) = found.differences
    assert (only.effect, only.joint) == ("friction_change", 2)
    assert only.numbers[0].value == pytest.approx(0.9, abs=0.05)


def test_a_leaning_base_is_told_in_size_though_not_from_the_zero_of_the_joint_it_turns(
    model: Model, tmp_path: Path
) -> None:
    found = audit([recorded(tmp_path, 4, leaning_rad=LEANING_RAD)], model.load_robot(), model)
    (only,) = found.differences
    assert only.effect in ("base_tilt", "joint_zero_offset")
    assert only.numbers[0].value == pytest.approx(LEANING_RAD, abs=0.01)
