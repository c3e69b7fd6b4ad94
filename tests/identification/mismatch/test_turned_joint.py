"""Joints that count the other way than their model. Truth: torques by the closed form, columns turned; real arms."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from identification.audit.audit import audit
from identification.audit.mount import require_stated_stand
from identification.audit.places import misplaced_joints
from identification.audit.reading import Reading
from identification.errors import RecordingError
from identification.fitting.settings import FitSettings
from identification.mismatch.set_up import examine_set_up
from identification.model_file import Model, read_model, write_model
from identification.recording_fit import fit_recordings
from identification.recordings import Recording, read_recording
from identification.robots import RobotModel, load_robot
from tests.identification.exported import random_arm, random_bodies
from tests.identification.mismatch.test_order_of_joints import ARMS, measured
from tests.identification.synthetic import fourier_motion, inverse_dynamics, recording_of
from tests.reference import recording_file


def turned(recording: Recording, joint: int, *names: str) -> Recording:
    """Columns of one joint, from 1, with the other sign."""
    sign = np.where(np.arange(recording.n) == joint - 1, -1.0, 1.0)
    return replace(recording, **{name: getattr(recording, name) * sign for name in names})


def reading(n: int, joint: int, *, with_torque: bool) -> Reading:
    """Of n joints, one of which counts the other way, or has a position with the wrong sign."""
    stated = tuple(range(1, n + 1))
    turned = tuple(-each if each == joint else each for each in stated)
    return Reading(turned, turned if with_torque else stated)


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> tuple[Recording, RobotModel]:
    """Four joints, 20 s of motion, 10 mNm of noise."""
    file = tmp_path_factory.mktemp("arm") / "arm.urdf"
    file.write_text(random_arm(4, 2))
    robot = load_robot(file)
    states = fourier_motion(4, period_s=20.0, samples=2000, seed=2)
    torque = inverse_dynamics(robot, random_bodies(4, 2), *states)
    torque += 0.01 * np.random.default_rng(3).standard_normal(torque.shape)
    return recording_of(states[0], torque, period_s=20.0), robot


@pytest.mark.parametrize("names", [("position",), ("position", "torque")])
@pytest.mark.parametrize("joint", [1, 2, 3, 4])
def test_a_joint_that_counts_the_other_way_is_named(
    arm: tuple[Recording, RobotModel], joint: int, names: tuple[str, ...]
) -> None:
    recording, robot = arm
    found = misplaced_joints([turned(recording, joint, *names)], robot)
    assert found is not None
    assert found == reading(recording.n, joint, with_torque=len(names) == 2)


def test_fit_warns_of_the_joint_and_of_none_in_a_sound_recording(arm: tuple[Recording, RobotModel]) -> None:
    """Around the vertical first axis gravity does not betray it, so nothing was said."""
    recording, robot = arm
    for joint in (None, 1):
        damaged = recording if joint is None else turned(recording, joint, "position", "torque")
        notes = fit_recordings([damaged], robot, FitSettings(physical=False)).notes
        said = [note for note in notes if note.startswith("WARNING, Joint 1 counts the other way")]
        assert len(said) == (joint == 1)


def test_a_fit_without_a_solution_blames_the_joint_that_counts_the_other_way() -> None:
    """It ended with 70 and asked whether the bounds (10b) are too tight."""
    robot = load_robot(recording_file("panda.urdf"))
    recording = read_recording(recording_file("panda_excitation.npz"), robot=robot.spec)
    with pytest.raises(RecordingError, match="Joint 1 counts the other way") as refusal:
        fit_recordings([turned(recording, 1, "position", "torque")], robot)
    assert refusal.value.exit_code == 65


def test_of_two_joints_that_both_gain_the_likelier_is_named(tmp_path: Path) -> None:
    """Each was held against its own rival by what the one before it had gained, so the first of them was named."""
    file = tmp_path / "arm.urdf"
    file.write_text(random_arm(5, 1))
    robot = load_robot(file)
    states = fourier_motion(5, period_s=20.0, samples=2000, seed=1)
    torque = inverse_dynamics(robot, random_bodies(5, 1), *states)
    torque += 0.02 * torque.std(axis=0) * np.random.default_rng(3).standard_normal(torque.shape)
    found = misplaced_joints([turned(recording_of(states[0], torque, period_s=20.0), 2, "position")], robot)
    assert found is not None
    assert found == reading(5, 2, with_torque=False)


@pytest.mark.parametrize("joint", [None, 1, 2, 3, 4])
def test_a_torque_that_alone_has_the_wrong_sign_is_no_turned_joint(
    arm: tuple[Recording, RobotModel], joint: int | None
) -> None:
    recording, robot = arm
    assert misplaced_joints([recording if joint is None else turned(recording, joint, "torque")], robot) is None


def test_the_examination_says_so_and_no_other_stand_is_advised(arm: tuple[Recording, RobotModel]) -> None:
    """Every check was well, or --mount auto was advised, under which the fit went on with a wrong gravity."""
    recording, robot = arm
    recording = turned(recording, 2, "position", "torque")
    checks = {check.name: check for check in examine_set_up([recording], robot)}
    assert checks["order of joints"].status == "failed"
    assert checks["order of joints"].sentence.startswith("Joint 2 counts the other way than the robot's model")
    assert checks["gravity"].status == "warning"
    with pytest.raises(RecordingError, match="Joint 2 counts the other way") as caught:
        require_stated_stand([recording], robot)
    assert caught.value.field == "q"


@pytest.mark.parametrize("file", [*ARMS, "kr300_a.npz"])
def test_no_joint_of_a_real_arm_is_said_to_be_turned(file: str) -> None:
    recording, robot = measured(file)
    assert misplaced_joints([recording], robot) is None


def test_a_turned_joint_of_a_real_arm_is_named() -> None:
    recording, robot = measured("ur10.npz")
    found = misplaced_joints([turned(recording, 2, "position", "torque")], robot)
    assert found is not None
    assert found == reading(6, 2, with_torque=True)


@pytest.fixture(scope="module")
def ur10_model(tmp_path_factory: pytest.TempPathFactory) -> Model:
    recording, robot = measured("ur10.npz")
    file = tmp_path_factory.mktemp("ur10") / "model.json"
    return read_model(write_model(fit_recordings([recording], robot).to_model_json(notes=False), file))


@pytest.mark.parametrize("joint", [None, 2, 3, 4, 6])
def test_beside_a_model_of_the_arm_a_turned_joint_is_named_and_nothing_else(
    joint: int | None, ur10_model: Model
) -> None:
    """27 kg less on link 3, another body of link 3 or 5, and an offset of joint 6 were named."""
    recording, robot = measured("ur10.npz")
    found = audit([recording if joint is None else turned(recording, joint, "position", "torque")], robot, ur10_model)
    said = [(item.effect, item.joints) for item in found.differences]
    assert said == ([] if joint is None else [("wrong_joint_order", (joint,))])
    assert found.holds
