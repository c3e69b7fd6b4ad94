"""Torques that become others within a recording. The damage is done here, to real recordings and to the closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from identification.audit.otherwise import other_reading
from identification.audit.partly import changed_torques
from identification.fitting.settings import FitSettings
from identification.mismatch.nominal import nominal_fit, nominal_of
from identification.mismatch.set_up import examine_set_up, set_up_checks
from identification.mismatch.settings import DiagnosisSettings
from identification.physical_parameters import PhysicalParameters
from identification.recording_fit import fit_recordings
from identification.recordings import Recording, read_recording
from identification.robots import RobotModel, load_robot
from tests.identification.synthetic import fourier_motion, inverse_dynamics, recording_of
from tests.reference import ARM_OF, recording_file


def real(name: str) -> tuple[Recording, RobotModel]:
    robot = load_robot(recording_file(ARM_OF[name]))
    return read_recording(recording_file(f"{name}.npz"), robot=robot.spec), robot


def changed(recording: Recording, joint: int, share: float, scale: float, offset_nm: float = 0.0) -> Recording:
    """The torque of a joint, from 1, another from a share of the rows on."""
    torque = recording.torque.copy()
    after = slice(int(share * recording.samples), None), joint - 1
    torque[after] = scale * torque[after] + offset_nm
    return replace(recording, torque=torque)


@pytest.mark.parametrize("name", ARM_OF)
def test_no_torque_of_a_real_recording_changes(name: str) -> None:
    recording, robot = real(name)
    assert changed_torques(recording, robot) == ()


@pytest.mark.parametrize(
    ("name", "joint", "share", "scale", "offset_nm"),
    [
        ("ur10", 1, 0.5, -1.0, 0.0),
        ("ur10", 4, 0.37, 0.5, 0.0),
        ("ur10", 4, 0.6, 1.0, 6.0),
        ("tx40_excitation", 4, 0.5, -1.0, 0.0),
        ("tx40_excitation", 1, 0.37, 0.5, 0.0),
        ("emps_a", 1, 0.6, 1.0, 50.0),
    ],
)
def test_a_torque_that_becomes_another_one_is_named_with_its_time(
    name: str, joint: int, share: float, scale: float, offset_nm: float
) -> None:
    """`doctor --log` said ok, `fit` nothing, and `diagnose` that something is unexplained."""
    recording, robot = real(name)
    (found,) = changed_torques(changed(recording, joint, share, scale, offset_nm), robot)
    assert found.joint == joint
    assert found.since_s == pytest.approx(recording.time[int(share * recording.samples)], abs=found.within_s)
    assert found.form == ("offset" if offset_nm else "scale")
    assert found.value == pytest.approx(offset_nm or scale, rel=0.1)


@pytest.mark.parametrize("name", ["ur10", "tx40_excitation", "lbrmed7", "kr300_a"])
@pytest.mark.parametrize("scale", [-1.0, 0.3])
def test_a_torque_that_is_misread_throughout_does_not_change(name: str, scale: float) -> None:
    """The other sign explains nearly all of it from any early moment on."""
    recording, robot = real(name)
    for joint in range(1, recording.n + 1):
        assert changed_torques(changed(recording, joint, 0.0, scale), robot) == ()


@pytest.fixture(scope="module")
def states() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return fourier_motion(7, period_s=10.0, samples=1000, seed=2)


def halves(robot: RobotModel, states: tuple[np.ndarray, ...], *arms: PhysicalParameters) -> Recording:
    """One period by each arm, 50 mNm of noise."""
    torque = np.concatenate([inverse_dynamics(robot, arm, *states) for arm in arms])
    torque += 0.05 * np.random.default_rng(1).normal(size=torque.shape)
    return recording_of(np.tile(states[0], (len(arms), 1)), torque, period_s=10.0, periods=len(arms))


def test_a_load_that_is_picked_up_is_no_sensor_s_fault_and_friction_is_none_either(
    iiwa14: RobotModel, table3: PhysicalParameters, states: tuple[np.ndarray, ...]
) -> None:
    mass, center = table3.mass.copy(), table3.center_of_mass.copy()
    center[6] = (mass[6] * center[6] + 2.5 * np.array([0.0, 0.0, 0.15])) / (mass[6] + 2.5)
    mass[6] += 2.5
    loaded = replace(table3, mass=mass, center_of_mass=center)
    reading = other_reading(halves(iiwa14, states, table3, loaded), iiwa14)
    assert reading is not None
    assert "a load was picked up or put down" in reading.sentence
    rough = replace(table3, coulomb=np.where(np.arange(7) == 3, 3.0, 1.0) * table3.coulomb)
    assert other_reading(halves(iiwa14, states, table3, rough), iiwa14) is None


def test_a_sign_that_turns_within_a_recording_is_not_called_wrong_throughout() -> None:
    """With all of the torque turned, as it was advised, the other part would be wrong."""
    recording, robot = real("ur10")
    checks = {check.name: check for check in examine_set_up([changed(recording, 4, 0.5, -1.0)], robot)}
    assert checks["constancy"].status == "failed"
    assert checks["torque signs"].status == "warning"
    assert "becomes another one" in checks["torque signs"].sentence


def test_fit_and_doctor_say_it(iiwa14: RobotModel, table3: PhysicalParameters, states: tuple[np.ndarray, ...]) -> None:
    sound = halves(iiwa14, states, table3, table3)
    half = changed(sound, 4, 0.5, 0.5)
    for recording, said in ((sound, False), (half, True)):
        notes = fit_recordings([recording], iiwa14, FitSettings(physical=False)).notes
        assert any(note.startswith("WARNING") and "torque of joint 4 is 0.5 times" in note for note in notes) == said
        checks = {check.name: check for check in set_up_checks([recording], iiwa14, [])}
        assert checks["constancy"].status == ("failed" if said else "ok")


def test_a_diagnosis_says_it_beside_what_it_names(
    iiwa14: RobotModel, table3: PhysicalParameters, states: tuple[np.ndarray, ...]
) -> None:
    """What the fit warned of did not reach the reader of the diagnosis, who saw classes of a torque cut in two."""
    half = changed(halves(iiwa14, states, table3, table3), 4, 0.5, 0.5)
    fit = nominal_fit([half], iiwa14, DiagnosisSettings())
    assert fit is not None
    assert "torque of joint 4 is 0.5 times" in nominal_of(fit, fit.regressor, ()).notes[0]
