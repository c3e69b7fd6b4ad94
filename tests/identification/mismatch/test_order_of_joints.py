"""The order of torques on an arm of few joints, and of positions on real ones.

Truth: torques by the closed form, two of them exchanged; columns of a recording exchanged.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from identification.audit.audit import audit
from identification.audit.mount import require_stated_stand
from identification.audit.places import misplaced_joints
from identification.audit.reading import Reading
from identification.base_parameters import BaseRegressor
from identification.errors import RecordingError
from identification.fitting.settings import FitSettings
from identification.mismatch.set_up import data_faults_of, examine_set_up
from identification.model_file import read_model, write_model
from identification.physical_parameters import PhysicalParameters
from identification.recording_fit import fit_recordings
from identification.recordings import Recording, read_recording
from identification.robots import RobotModel, load_robot
from tests.identification.exported import random_arm, random_bodies
from tests.identification.synthetic import fourier_motion, inverse_dynamics, recording_of
from tests.reference import recording_file


@pytest.mark.parametrize("seed", [0, 3, 7])
def test_two_torques_exchanged_on_an_arm_of_three_joints_are_told(seed: int, tmp_path: Path) -> None:
    """The columns of a joint take more than half of any torque here, and those of the right one all of it."""
    file = tmp_path / "arm.urdf"
    file.write_text(random_arm(3, seed))
    robot = load_robot(file)
    states = fourier_motion(3, period_s=20.0, samples=4000, seed=seed)
    torque = inverse_dynamics(robot, random_bodies(3, seed), *states)
    torque += 0.01 * np.random.default_rng(seed).standard_normal(torque.shape)
    sound = recording_of(states[0], torque, period_s=20.0)
    exchanged = replace(sound, torque=torque[:, [1, 0, 2]])
    found, right = ({item.name: item for item in examine_set_up([each], robot)} for each in (exchanged, sound))
    assert found["order of joints"].status == "failed"
    assert "that of joint 1 stands under joint 2" in found["order of joints"].sentence
    assert found["torque signs"].status != "failed"
    assert {right[name].status for name in ("order of joints", "torque signs")} == {"ok"}


def exchanged_positions(recordings: list[Recording], robot: RobotModel) -> Reading | None:
    """The reading found where it is two positions in each other's place, and nothing else."""
    found = misplaced_joints(recordings, robot)
    pair = found is not None and found.torque == tuple(range(1, robot.n + 1)) and min(found.motion) > 0
    return found if pair else None


def is_other_order(found: Reading | None) -> bool:
    """Whether positions and torques stand in another order, and alike."""
    return found is not None and found.motion == found.torque and min(found.motion) > 0


ARMS = {"ur10.npz": "ur10_mdh.csv", "tx40_excitation.npz": "tx40.urdf", "lbrmed7.npz": "med7dock.urdf"}


def measured(file: str) -> tuple[Recording, RobotModel]:
    robot = recording_file({**ARMS, "kr300_a.npz": "kr300.urdf", "kr300_b.npz": "kr300.urdf"}[file])
    return read_recording(recording_file(file), robot=robot), load_robot(robot)


def exchanged(recording: Recording, first: int, second: int, *names: str) -> Recording:
    """Columns of joints `first` and `second`, from 1, in each other's place."""
    order = np.arange(recording.n)
    order[[first - 1, second - 1]] = second - 1, first - 1
    return replace(recording, **{name: getattr(recording, name)[:, order] for name in names})


@pytest.mark.parametrize("pair", [(1, 2), (2, 3), (2, 4), (4, 6)])
@pytest.mark.parametrize("file", ARMS)
def test_two_positions_exchanged_are_told_by_the_torque(file: str, pair: tuple[int, int]) -> None:
    recording, robot = measured(file)
    found = exchanged_positions([exchanged(recording, *pair, "position")], robot)
    assert found is not None
    assert found.joints == pair


def test_beside_a_model_two_exchanged_positions_are_named_and_nothing_else_and_fit_warns_of_them(
    tmp_path: Path,
) -> None:
    """A leaning base, a scale and another link 3 were named, and `fit` said nothing of the order."""
    recording, robot = measured("ur10.npz")
    settings = FitSettings(physical=False)
    fit = fit_recordings([recording], robot, settings)
    model = read_model(write_model(fit.to_model_json(notes=False), tmp_path / "m.json"))
    assert audit([recording], robot, model).differences == ()
    # Of 1 and 4 the torques, too, seem to stand in another order.
    for pair in ((1, 2), (1, 4), (3, 4)):
        spoilt = exchanged(recording, *pair, "position")
        (said,) = audit([spoilt], robot, model).differences
        assert (said.effect, said.joints, said.against) == ("wrong_joint_order", pair, "recording")
    warned = "WARNING, The positions of joints 3 and 4 stand in each other's place"
    assert any(note.startswith(warned) for note in fit_recordings([spoilt], robot, settings).notes)


@pytest.mark.parametrize("file", [*ARMS, "kr300_a.npz", "kr300_b.npz"])
def test_no_exchange_is_seen_in_the_recording_of_a_real_arm(file: str) -> None:
    """Nor where the position of a joint has the wrong sign, or where the clock is wrong."""
    recording, robot = measured(file)
    turned = recording.position * np.where(np.arange(recording.n) == 1, -1.0, 1.0)
    slow = replace(recording, time=2.0 * recording.time, sampling_period_s=2.0 * recording.sampling_period_s)
    for each in (recording, replace(recording, position=turned), replace(slow, period_index=None, period_s=None)):
        assert exchanged_positions([each], robot) is None


@pytest.mark.parametrize("columns", [(3, 2, 1, 4, 5, 6), (2, 1, 3, 5, 4, 6), (2, 3, 1, 4, 5, 6)])
def test_joints_in_another_order_are_told_with_the_option_that_puts_them_right(
    columns: tuple[int, ...], tmp_path: Path
) -> None:
    """Positions and torques together, as in a table by the alphabet. Truth: the torques of six joints, then moved."""
    (tmp_path / "arm.urdf").write_text(random_arm(6, 5))
    robot = load_robot(tmp_path / "arm.urdf")
    states = fourier_motion(6, period_s=20.0, samples=4000, seed=5)
    torque = inverse_dynamics(robot, random_bodies(6, 5), *states)
    torque += 0.01 * np.random.default_rng(5).standard_normal(torque.shape)
    sound = recording_of(states[0], torque, period_s=20.0)
    recorded = np.argsort(np.array(columns) - 1)
    spoilt = replace(sound, position=sound.position[:, recorded], torque=torque[:, recorded])
    found = misplaced_joints([spoilt], robot)
    assert found is not None
    assert found.motion == found.torque == columns
    assert f"--joints {','.join(map(str, columns))}" in found.sentence
    assert misplaced_joints([sound], robot) is None


@pytest.mark.parametrize("file", [*ARMS, "kr300_a.npz", "kr300_b.npz"])
def test_no_other_order_is_seen_in_the_recording_of_a_real_arm(file: str) -> None:
    """Nor where a sign, two positions, or the torques alone are wrong."""
    recording, robot = measured(file)
    one = np.where(np.arange(recording.n) == 1, -1.0, 1.0)
    for each in (
        recording,
        replace(recording, torque=one * recording.torque),
        exchanged(recording, 2, 3, "position"),
        exchanged(recording, 2, 3, "torque"),
    ):
        assert not is_other_order(misplaced_joints([each], robot))


def test_real_joints_in_another_order_are_told_alone_and_beside_a_model(tmp_path: Path) -> None:
    recording, robot = measured("ur10.npz")
    settings = FitSettings(physical=False)
    fit = fit_recordings([recording], robot, settings)
    model = read_model(write_model(fit.to_model_json(notes=False), tmp_path / "m.json"))
    columns = (2, 1, 3, 5, 4, 6)
    order = np.array(columns) - 1
    spoilt = replace(recording, position=recording.position[:, order], torque=recording.torque[:, order])
    found = misplaced_joints([spoilt], robot)
    assert found is not None
    assert found.motion == found.torque == columns
    (said,) = audit([spoilt], robot, model).differences
    assert (said.effect, said.joints, said.against) == ("wrong_joint_order", found.joints, "recording")


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (("torque",), "The torques are in the order of other joints"),
        (("position", "torque"), "Positions and torques stand in another order than the robot's joints"),
    ],
)
def test_fit_warns_of_joints_in_another_order_and_the_examination_fails(names: tuple[str, ...], said: str) -> None:
    """It left more than half of a torque and said nothing, though `doctor --log` told the first."""
    recording, robot = measured("ur10.npz")
    spoilt = exchanged(recording, 2, 4, *names)
    notes = fit_recordings([spoilt], robot, FitSettings(physical=False)).notes
    assert any(note.startswith(f"WARNING, {said}") for note in notes)
    order = {each.name: each for each in examine_set_up([spoilt], robot)}["order of joints"]
    assert (order.status, order.sentence[: len(said)]) == ("failed", said)


def test_exchanged_positions_are_no_other_stand_and_the_examination_names_them(
    iiwa14: RobotModel, table3: PhysicalParameters
) -> None:
    """Of a fit that would be refused for its gravity, and of `doctor --log`."""
    states = fourier_motion(7, period_s=10.0, samples=1000, seed=7)
    torque = np.tile(inverse_dynamics(iiwa14, table3, *states), (4, 1))
    torque += 0.05 * np.random.default_rng(7).standard_normal(torque.shape)
    sound = recording_of(np.tile(states[0], (4, 1)), torque, period_s=10.0, periods=4)
    spoilt = exchanged(sound, 2, 4, "position")
    with pytest.raises(RecordingError, match="joints 2 and 4") as caught:
        require_stated_stand([spoilt], iiwa14)
    assert caught.value.field == "q"
    found, right = ({item.name: item for item in examine_set_up([each], iiwa14)} for each in (spoilt, sound))
    assert [item.name for item in found.values() if item.status == "failed"] == ["order of joints"]
    assert "joints 2 and 4" in found["order of joints"].sentence
    assert {item.status for item in right.values()} == {"ok"}


def test_signs_are_asked_under_the_gravity_that_the_recording_shows() -> None:
    """The LBR Med 7 stands level. Said to hang on a wall, two of its sensors seemed to have the wrong sign as well."""
    recording, robot = measured("lbrmed7.npz")
    on_a_wall = replace(robot, gravity=np.array([9.81, 0.0, 0.0]))
    found = {each.name: each for each in examine_set_up([recording], on_a_wall)}
    assert (found["gravity"].status, found["torque signs"].status) == ("failed", "ok")
    # With a model it is diagnosed all the same, and turned torques would go into every fit.
    assert data_faults_of([recording], on_a_wall, BaseRegressor(on_a_wall)) == ((),)
