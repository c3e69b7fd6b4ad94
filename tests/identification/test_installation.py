"""Claims about how a robot stands: gravity, mount and locked joints act in every torque and travel with model and log.

Truth: inverse dynamics of MuJoCo, which has the whole hand, turned gravity, and fingers held where they are told to be.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio
import pytest

from identification.errors import RecordingError, RobotError
from identification.model_file import read_model, write_model
from identification.recording_fit import FitSettings, fit_recordings
from identification.recordings import Recording, read_recording, write_recording
from identification.recordings.reader import read_inputs
from identification.robots import Installation, load_robot
from identification.robots.same_arm import difference_of_arms
from identification.validation import validate_model
from tests.identification.synthetic import fourier_motion

WALL = (9.81, 0.0, 0.0)
PERIOD_S, SAMPLES, PERIODS = 3.0, 300, 4


def link(name: str, mass: float, center: str) -> str:
    return (
        f'<link name="{name}"><inertial><origin xyz="{center}"/><mass value="{mass}"/>'
        '<inertia ixx="0.04" iyy="0.05" izz="0.03" ixy="0.002" ixz="0.001" iyz="-0.003"/></inertial></link>'
    )


def joint(name: str, kind: str, parent: str, child: str, axis: str, origin: str, more: str = "") -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/><axis xyz="{axis}"/>'
        f'<origin xyz="{origin}"/><limit lower="-3" upper="3" velocity="3" effort="200"/>{more}</joint>'
    )


ARM = "".join(
    [
        '<robot name="arm">',
        '<link name="base"/>',
        link("upper", 3.0, "0.1 0.02 0.1"),
        link("lower", 2.0, "0.2 -0.03 0.05"),
        link("hand", 1.0, "0.05 0.02 0.1"),
        link("left", 0.4, "0.02 0.05 0.03"),
        link("right", 0.3, "0.01 -0.05 0.03"),
        joint("a", "revolute", "base", "upper", "0 0 1", "0 0 0.3"),
        joint("b", "revolute", "upper", "lower", "0 1 0", "0.1 0 0.2"),
        joint("c", "revolute", "lower", "hand", "1 0 0", "0.4 0 0"),
        joint("finger", "prismatic", "hand", "left", "0 1 0", "0.1 0 0"),
        joint("thumb", "revolute", "left", "right", "0 0 1", "0 -0.1 0", '<mimic joint="finger" multiplier="-2"/>'),
        "</robot>",
    ]
)
FINGER, THUMB = 0.3, -0.6
INSTALLATION = Installation(WALL, (("finger", FINGER),))


@pytest.fixture(scope="module")
def urdf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("arm") / "arm.urdf"
    path.write_text(ARM)
    return path


def torque_of(q: Any, dq: Any, ddq: Any, gravity: tuple[float, float, float]) -> Any:
    """(S, 3) torque of the arm's three joints, fingers held, by MuJoCo."""
    model = mujoco.MjModel.from_xml_string(ARM)
    model.opt.gravity[:] = gravity
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_EQUALITY
    data = mujoco.MjData(model)
    result = np.empty_like(q)
    for row, (position, velocity, acceleration) in enumerate(zip(q, dq, ddq, strict=True)):
        data.qpos[:] = *position, FINGER, THUMB
        data.qvel[:] = *velocity, 0.0, 0.0
        data.qacc[:] = *acceleration, 0.0, 0.0
        mujoco.mj_inverse(model, data)
        result[row] = data.qfrc_inverse[:3]
    return result


@pytest.fixture(scope="module")
def recording(urdf: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of the wall-mounted arm, imported from a table that knows neither wall nor fingers."""
    q, dq, ddq = fourier_motion(3, period_s=PERIOD_S, samples=SAMPLES, seed=5, speed=1.5)
    torque = torque_of(q, dq, ddq, WALL)
    noise = np.random.default_rng(1).normal(scale=1e-3, size=(PERIODS * SAMPLES, 3))
    path = tmp_path_factory.mktemp("recording") / "a.npz"
    np.savez(
        path, t=np.arange(PERIODS * SAMPLES) * PERIOD_S / SAMPLES, q=np.tile(q, (PERIODS, 1)),
        tau=np.tile(torque, (PERIODS, 1)) + noise, period_s=PERIOD_S, robot=str(urdf),
    )  # fmt: skip
    return path


def rms_of_fit(recording: Recording, robot: Any) -> Any:
    return fit_recordings([recording], robot, FitSettings(physical=False, check_torque_sign=False)).rms.rows[0].rms_nm


@pytest.mark.parametrize("gravity", [WALL, (0.0, 0.0, 9.81), (0.0, -6.0, -7.76)])
def test_a_locked_and_turned_arm_has_the_torque_of_mujoco(urdf: Path, gravity: tuple[float, float, float]) -> None:
    robot = load_robot(urdf, Installation(gravity, (("finger", FINGER),)))
    generator = np.random.default_rng(3)
    q, dq, ddq = generator.uniform(-1.0, 1.0, (3, 20, 3))
    model = robot.pinocchio_model
    data = model.createData()
    ours = np.array([pinocchio.rnea(model, data, *state) for state in zip(q, dq, ddq, strict=True)])
    np.testing.assert_allclose(ours, torque_of(q, dq, ddq, gravity), atol=1e-9)
    assert sum(model.inertias[place + 1].mass for place in range(3)) == pytest.approx(3.0 + 2.0 + 1.0 + 0.4 + 0.3)


def test_a_fit_needs_the_wall_it_hangs_on(urdf: Path, recording: Path) -> None:
    inputs = read_inputs([recording], installation=INSTALLATION)
    assert inputs.robot.gravity.tolist() == list(WALL)
    assert rms_of_fit(inputs.recordings[0], inputs.robot).max() < 2e-3
    on_the_floor = Installation(locked_joints=(("finger", FINGER),))
    assert rms_of_fit(inputs.recordings[0], load_robot(urdf, on_the_floor)).max() > 0.1


def test_model_and_log_remember_how_the_robot_stands(tmp_path: Path, recording: Path) -> None:
    log = write_recording(read_recording(recording, installation=INSTALLATION), tmp_path / "a.mcap")
    inputs = read_inputs([log])
    assert inputs.robot.installation == INSTALLATION
    result = fit_recordings(inputs.recordings, inputs.robot, FitSettings(physical=False, check_torque_sign=False))
    file = write_model(result.to_model_json(), tmp_path / "model.json")
    model = read_model(file)
    assert model.load_robot().installation == INSTALLATION
    # The table names the robot, but neither wall nor fingers: they are the model's.
    unseen = read_inputs([recording], model_robot=model.load_robot())
    assert validate_model(model, unseen.recordings).rows[0].rms_nm.max() < 2e-3
    standing = read_recording(recording, installation=Installation(locked_joints=(("finger", FINGER),)))
    other = write_recording(standing, tmp_path / "floor.mcap")
    with pytest.raises(RecordingError, match="gravity"):
        read_inputs([other], model_robot=model.load_robot())
    with pytest.raises(RecordingError, match="another gravity"):
        read_inputs([log, other])


def test_a_stand_that_was_stated_without_a_robot_is_not_the_models(urdf: Path, recording: Path, tmp_path: Path) -> None:
    """It was forgotten, and the model compared with torques under another gravity."""
    with np.load(recording) as known:
        np.savez(tmp_path / "b.npz", **{name: known[name] for name in known.files if name != "robot"})
    for name, gravity in (("wall", WALL), ("ceiling", (0.0, 0.0, 9.81))):
        stated = read_recording(tmp_path / "b.npz", installation=Installation(gravity))
        assert stated.robot is None
        write_recording(stated, tmp_path / f"{name}.mcap")
    hangs = load_robot(urdf, INSTALLATION)
    assert read_inputs([tmp_path / "wall.mcap"], model_robot=hangs).robot.installation == INSTALLATION
    with pytest.raises(RecordingError, match=r"under gravity \(0, 0, 9.81\) m/s².*the model under \(9.81, 0, 0\)"):
        read_inputs([tmp_path / "ceiling.mcap"], model_robot=hangs)


def test_a_built_in_arm_can_hang_and_a_standing_one_says_nothing() -> None:
    hanging = load_robot("iiwa14", Installation.parse(mount="ceiling"))
    assert hanging.gravity.tolist() == [0.0, 0.0, 9.81]
    assert hanging.to_json()["installation"]["gravity_m_s2"] == [0.0, 0.0, 9.81]
    assert load_robot("iiwa14").to_json() == {"robot": "iiwa14"}
    assert difference_of_arms(load_robot("iiwa14"), hanging).startswith("gravity")
    assert difference_of_arms(load_robot("iiwa14"), load_robot("iiwa14")) == ""


def test_what_the_command_line_says_is_read_or_refused() -> None:
    assert Installation.parse() is None
    assert Installation.parse(gravity="0,0,-9.8") == Installation((0.0, 0.0, -9.8))
    assert Installation.parse(lock=["a=0.04,b=-1"]) == Installation(locked_joints=(("a", 0.04), ("b", -1.0)))
    for words in (
        {"gravity": "0,0,-1.6"}, {"gravity": "0,0"}, {"gravity": "0,0,nan"}, {"gravity": "down"},
        {"mount": "table"}, {"mount": "wall", "gravity": "0,0,9.81"}, {"lock": ["a"]}, {"lock": ["a=x"]},
        {"lock": ["a=nan"]}, {"lock": ["a=1", "a=2"]},
    ):  # fmt: skip
        with pytest.raises(RobotError):
            Installation.parse(**words)


def test_joints_that_are_not_there_are_not_locked(urdf: Path) -> None:
    with pytest.raises(RobotError, match="elbow"):
        load_robot(urdf, Installation(locked_joints=(("elbow", 0.0),)))
    with pytest.raises(RobotError, match="all of its joints"):
        load_robot("iiwa14", Installation(locked_joints=tuple((f"A{joint}", 0.0) for joint in range(1, 8))))
