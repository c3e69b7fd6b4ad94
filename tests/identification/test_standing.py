"""Claims about what stands while it should change. The damage is done here, to real recordings, and known exactly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from identification.base_parameters import BaseRegressor, RegressorOptions
from identification.mismatch.data_faults.faults import find_data_faults
from identification.mismatch.set_up import examine_set_up, set_up_checks
from identification.physical_parameters import PhysicalParameters
from identification.recording_fit import fit_recordings
from identification.recordings import Recording, read_recording
from identification.recordings.standing import standing_values
from identification.robots import RobotModel, load_robot
from tests.identification.synthetic import fourier_motion, inverse_dynamics, recording_of
from tests.reference import ARM_OF, recording_file


def real(name: str) -> Recording:
    return read_recording(recording_file(f"{name}.npz"), robot=recording_file(ARM_OF[name]))


def with_torque(recording: Recording, joint: int, torque: np.ndarray) -> Recording:
    return replace(recording, torque=np.where(np.arange(recording.n) == joint - 1, torque[:, None], recording.torque))


@pytest.mark.parametrize("name", ARM_OF)
def test_nothing_stands_in_real_recordings_nor_with_coarser_sensors(name: str) -> None:
    recording = real(name)
    assert standing_values(recording) == ()
    coarse = 0.1 * recording.torque.std(axis=0)
    assert standing_values(replace(recording, torque=np.round(recording.torque / coarse) * coarse)) == ()
    assert standing_values(replace(recording, position=np.round(recording.position, 3))) == ()


@pytest.mark.parametrize("joint", [1, 4])
def test_a_torque_that_is_zero_in_a_part_is_named_with_its_rows(joint: int) -> None:
    """A third of the rows, and three times twenty of them: `fit` and `doctor --log` said nothing."""
    recording = real("ur10")
    whole, parts = recording.torque[:, joint - 1].copy(), recording.torque[:, joint - 1].copy()
    whole[2300:] = 0.0
    (found,) = standing_values(with_torque(recording, joint, whole))
    assert (found.kind, found.joint, found.last_row) == ("standing_torque", joint, recording.samples)
    assert found.count == pytest.approx(recording.samples - 2300, abs=1)
    assert f"joint {joint}: the torque is exactly 0" in found.sentence
    assert "33 % of all" in found.sentence
    starts = [400, 1000, 1700]
    for start in starts:
        parts[start : start + 20] = 0.0
    (found,) = standing_values(with_torque(recording, joint, parts))
    assert found.count == pytest.approx(60, abs=3)


@pytest.mark.parametrize("name", ["kr300_a", "lbrmed7", "ur10"])
def test_a_torque_that_is_held_is_named(name: str) -> None:
    recording = real(name)
    torque = recording.torque[:, 1].copy()
    middle = recording.samples // 2
    torque[middle : middle + 30] = torque[middle]
    (found,) = standing_values(with_torque(recording, 2, torque))
    assert (found.kind, found.joint, found.count) == ("standing_torque", 2, 29)
    assert (found.first_row, found.last_row) == (middle + 2, middle + 30)


@pytest.mark.parametrize("name", ["kr300_a", "lbrmed7", "ur10", "tx40_excitation"])
def test_an_encoder_that_is_stuck_is_named_and_a_joint_that_rests_is_not(name: str) -> None:
    """It was a large misfit of that joint without a name."""
    recording = real(name)
    middle, length = recording.samples // 2, recording.samples // 10
    stuck = recording.position.copy()
    stuck[middle : middle + length, 0] = stuck[middle, 0]
    (found,) = standing_values(replace(recording, position=stuck))
    assert (found.kind, found.joint) == ("stuck_position", 1)
    assert found.count == pytest.approx(length, abs=0.01 * recording.samples)
    # At rest before and after: its own motion in between, begun and ended from a rest, as far as the joint goes.
    rests = np.interp(np.arange(recording.samples), [middle, recording.samples - 1], [0.0, np.pi])
    resting = recording.position.copy()
    resting[:, 0] = 0.5 - 0.5 * np.cos(rests)
    resting[:middle, 0] = 0.0
    assert standing_values(replace(recording, position=resting)) == ()


def test_fit_warns_of_a_torque_that_is_cut_off_and_doctor_names_it(
    iiwa14: RobotModel, table3: PhysicalParameters
) -> None:
    """Clipped for a fifth of the time, half-way between its mean and its end: the fit went on without a word."""
    q, dq, ddq = fourier_motion(7, period_s=10.0, samples=1000, seed=2)
    noise = 0.05 * np.random.default_rng(3).normal(size=(2000, 7))
    torque = np.tile(inverse_dynamics(iiwa14, table3, q, dq, ddq), (2, 1)) + noise
    limit = float(np.quantile(torque[:, 3], 0.8))
    torque[:, 3] = np.minimum(torque[:, 3], limit)
    recording = recording_of(np.tile(q, (2, 1)) + 1e-6 * noise, torque, period_s=10.0, periods=2)
    result = fit_recordings([recording], iiwa14)
    (warning,) = [note for note in result.notes if "cut off" in note]
    assert warning.startswith(
        f"WARNING, synthetic.mcap: joint 4: the torque is cut off at {limit:+.4g} Nm, in 400 rows"
    )
    assert "20 % of all" in warning


def test_no_other_clock_is_made_of_an_encoder_that_is_stuck() -> None:
    """It was said that samples were taken at 16 Hz, not at the stated 125 Hz."""
    robot, recording = load_robot(recording_file("ur10_mdh.csv")), real("ur10")
    stuck = recording.position.copy()
    stuck[1720:1920, 2] = stuck[1720, 2]
    checks = {check.name: check for check in examine_set_up([replace(recording, position=stuck)], robot)}
    assert checks["clock"].status != "failed"
    assert "joint 3: the position stands" in checks["rows"].sentence


def test_doctor_names_a_torque_that_went_to_zero() -> None:
    robot = load_robot(recording_file("ur10_mdh.csv"))
    recording = real("ur10")
    torque = recording.torque[:, 1].copy()
    torque[2300:] = 0.0
    damaged = with_torque(recording, 2, torque)
    regressor = BaseRegressor(robot, RegressorOptions(rotor_inertia=True, offset=True))
    (faults,) = find_data_faults([damaged], regressor)
    rows = next(check for check in set_up_checks([damaged], robot, faults) if check.name == "rows")
    assert rows.status == "warning"
    assert "joint 2: the torque is exactly 0" in rows.sentence
