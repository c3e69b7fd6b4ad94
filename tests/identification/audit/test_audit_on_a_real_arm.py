"""Claims about faults put into a recording of a real UR10, which others made (shared/recordings).

Truth: what was put in. A load's torque is Pinocchio's Newton-Euler of that body alone; the other faults are changes of
the file's own numbers. The model is fitted to the first half, the fault is put into the second.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pinocchio
import pytest

from identification.audit import Audit, audit
from identification.model_file import Model, read_model, write_model
from identification.recording_fit import FitSettings, fit_recordings
from identification.recordings import Recording, read_recording
from identification.robots import RobotModel, load_robot

FloatArray = np.ndarray


@dataclass(frozen=True)
class Bench:
    """A second half without a fault, and the model of the first."""

    robot: RobotModel
    model: Model
    recording: Recording

    def asked(self, recording: Recording) -> Audit:
        return audit([recording], self.robot, self.model)

    def with_torque(self, torque: FloatArray) -> Audit:
        return self.asked(replace(self.recording, torque=torque))


@pytest.fixture(scope="module")
def bench(shared_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Bench:
    folder = shared_folder / "recordings"
    recording = read_recording(folder / "ur10.npz", robot=folder / "ur10_mdh.csv")
    robot = load_robot(folder / "ur10_mdh.csv")
    middle = 0.5 * float(recording.time[-1])
    first, second = recording.rows(recording.time < middle), recording.rows(recording.time >= middle)
    result = fit_recordings([first], robot, FitSettings(physical=False))
    file = write_model(result.to_model_json(), tmp_path_factory.mktemp("model") / "earlier.json")
    return Bench(robot, read_model(file), replace(second, time=second.time - second.time[0]))


def torque_of_load(robot: RobotModel, recording: Recording, mass: float, center: FloatArray) -> FloatArray:
    """(S, n) Nm by Pinocchio of a body on the last link of an arm that weighs nothing else."""
    model = robot.pinocchio_model.copy()
    for joint in range(1, model.njoints):
        model.inertias[joint] = pinocchio.Inertia.Zero()
    inertia = 0.4 * mass * 0.05**2 * np.eye(3)
    model.appendBodyToJoint(robot.n, pinocchio.Inertia(mass, center, inertia), pinocchio.SE3.Identity())
    data = model.createData()
    velocity = np.gradient(recording.position, recording.sampling_period_s, axis=0)
    smooth = np.apply_along_axis(lambda values: np.convolve(values, np.ones(5) / 5.0, "same"), 0, velocity)
    acceleration = np.gradient(smooth, recording.sampling_period_s, axis=0)
    states = zip(recording.position, velocity, acceleration, strict=True)
    return np.array([pinocchio.rnea(model, data, *state) for state in states])


def names(found: Audit) -> list[tuple[str, int | None, int | None]]:
    return [(item.effect, item.joint, item.link) for item in found.differences]


def test_nothing_is_named_where_nothing_differs(bench: Bench) -> None:
    found = bench.asked(bench.recording)
    assert found.differences == ()
    assert found.verdict == "nothing"


@pytest.mark.parametrize("mass", [2.7, 6.0])
def test_a_load_on_the_flange_is_named_with_its_mass(bench: Bench, mass: float) -> None:
    center = np.array([0.01, -0.02, 0.08])
    load = torque_of_load(bench.robot, bench.recording, mass, center)
    found = bench.with_torque(bench.recording.torque + load)
    assert names(found) == [("payload", None, 6)]
    (number, *_) = found.differences[0].numbers
    low, high = number.interval
    assert number.value == pytest.approx(mass, rel=0.1)
    assert low < mass < high
    assert found.differences[0].explained > 0.5
    assert "on the flange" in found.differences[0].sentence


def test_a_load_that_was_taken_off_has_a_negative_mass(bench: Bench) -> None:
    load = torque_of_load(bench.robot, bench.recording, 4.0, np.array([0.0, 0.02, 0.06]))
    found = bench.with_torque(bench.recording.torque - load)
    assert names(found) == [("payload", None, 6)]
    assert found.differences[0].numbers[0].value == pytest.approx(-4.0, rel=0.1)
    assert "taken off" in found.differences[0].sentence


def test_torques_that_are_all_turned_round_are_named_so(bench: Bench) -> None:
    found = bench.with_torque(-bench.recording.torque)
    assert names(found) == [("inverted_torque_sign", None, None)]
    assert found.differences[0].against == "recording"


def test_one_torque_that_is_turned_round_is_named_with_its_joint(bench: Bench) -> None:
    torque = bench.recording.torque.copy()
    torque[:, 2] *= -1.0
    assert names(bench.with_torque(torque)) == [("inverted_torque_sign", 3, None)]


def test_a_common_scale_is_named_with_what_cannot_be_told_from_it(bench: Bench) -> None:
    found = bench.with_torque(1.25 * bench.recording.torque)
    assert names(found) == [("torque_sensor_gain", None, None)]
    assert found.differences[0].numbers[0].value == pytest.approx(1.25, abs=0.03)
    assert "all masses" in found.differences[0].sentence


def test_torques_under_other_joints_are_put_back_in_order(bench: Bench) -> None:
    found = bench.with_torque(bench.recording.torque[:, [0, 2, 1, 3, 4, 5]])
    assert names(found) == [("wrong_joint_order", None, None)]
    assert found.differences[0].joints == (2, 3)


def test_positions_in_degrees_are_read_so(bench: Bench) -> None:
    found = bench.asked(replace(bench.recording, position=np.degrees(bench.recording.position), velocity=None))
    assert names(found) == [("wrong_unit", None, None)]


def test_an_offset_is_named_with_its_joint(bench: Bench) -> None:
    torque = bench.recording.torque.copy()
    torque[:, 1] += 25.0
    found = bench.with_torque(torque)
    assert names(found)[0][:2] in (("torque_offset", 2), ("friction_change", 2))
    assert len(found.differences) == 1
