"""What a recording is besides what it states. The damage is done here, to real recordings and to the closed form."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, sosfilt, sosfiltfilt

from identification.audit.held_out import Asked
from identification.audit.otherwise import may_be_read_otherwise, other_reading
from identification.audit.rows import rows_of
from identification.fitting.settings import FitSettings
from identification.mismatch.set_up import set_up_checks
from identification.physical_parameters import PhysicalParameters
from identification.recording_fit import fit_recordings
from identification.recordings import Recording, read_recording
from identification.robots import RobotModel, load_robot
from tests.identification.synthetic import fourier_motion, inverse_dynamics, recording_of
from tests.reference import ARM_OF, recording_file

RATE_HZ = 100.0


def with_torque(recording: Recording, change: Callable[[np.ndarray], np.ndarray]) -> Recording:
    return replace(recording, torque=change(recording.torque.copy()))


def low_pass(hz: float, order: int, there_and_back: bool) -> Callable[[np.ndarray], np.ndarray]:
    sections = butter(order, hz, fs=RATE_HZ, output="sos")
    return lambda torque: sosfiltfilt(sections, torque, axis=0) if there_and_back else sosfilt(sections, torque, axis=0)


def of_joint(joint: int, change: Callable[[np.ndarray], np.ndarray]) -> Callable[[np.ndarray], np.ndarray]:
    def changed(torque: np.ndarray) -> np.ndarray:
        torque[:, joint - 1] = change(torque[:, joint - 1])
        return torque

    return changed


@pytest.fixture(scope="module")
def arm() -> RobotModel:
    return load_robot("iiwa14")


@pytest.fixture(scope="module")
def states() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return fourier_motion(7, period_s=30.0, samples=3000, seed=2)


@pytest.fixture(scope="module")
def sound(arm: RobotModel, table3: PhysicalParameters, states: tuple[np.ndarray, ...]) -> Recording:
    """Half a minute with 20 mNm of noise; nobody knows of a period."""
    torque = inverse_dynamics(arm, table3, *states)
    torque += 0.02 * np.random.default_rng(1).normal(size=torque.shape)
    made = recording_of(states[0], torque, period_s=30.0)
    return replace(made, period_index=None, sample_in_period=None, period_s=None, samples_per_period=None)


@pytest.mark.parametrize("name", ARM_OF)
def test_real_recordings_are_what_they_state(name: str) -> None:
    robot = load_robot(recording_file(ARM_OF[name]))
    assert other_reading(read_recording(recording_file(f"{name}.npz"), robot=robot.spec), robot) is None


def test_a_sound_recording_is_what_it_states(sound: Recording, arm: RobotModel) -> None:
    assert other_reading(sound, arm) is None


def test_a_reading_is_asked_no_further_than_it_may_still_be_as_likely_as_another(
    sound: Recording, arm: RobotModel
) -> None:
    """Truth: the whole score. What the fold that ends it leaves is less likely already, and every fold leaves more."""
    asked = Asked.of(rows_of([sound]), arm)
    stated = asked.of_reading(asked.columns)
    for joint in range(7):
        torque = of_joint(joint + 1, lambda values: -values)(asked.rows.torque.copy())
        whole, short = (asked.of_reading(asked.columns, torque, least=least) for least in (-np.inf, stated.nats))
        assert whole.nats <= short.nats < stated.nats
        assert np.all(short.square <= whole.square)
        same = asked.of_reading(asked.columns, torque, least=whole.nats)
        assert same.nats == whole.nats


@pytest.mark.parametrize(
    ("hz", "order", "there_and_back", "said"),
    [
        (1.0, 2, True, "at 1 Hz (forwards and backwards)"),
        (1.5, 4, True, "at 1.5 Hz (forwards and backwards)"),
        (2.0, 1, False, "at 2 Hz (so that they"),
    ],
)
def test_torques_that_alone_were_filtered_are_said_with_the_corner(
    sound: Recording, arm: RobotModel, hz: float, order: int, there_and_back: bool, said: str
) -> None:
    """Twice through a Butterworth filter of `scipy`. Parameters were up to 26 % off, without a word."""
    found = other_reading(with_torque(sound, low_pass(hz, order, there_and_back)), arm)
    assert found is not None
    assert found.kind == "filtered"
    assert said in found.sentence


def test_a_torque_that_is_late_is_no_filter(sound: Recording, arm: RobotModel) -> None:
    found = other_reading(with_torque(sound, lambda torque: np.roll(torque, 10, axis=0)), arm)
    assert found is not None
    assert "100 ms later than the positions" in found.sentence


def test_a_zero_that_is_off_is_said_with_what_to_add(sound: Recording, arm: RobotModel) -> None:
    position = sound.position.copy()
    position[:, 3] += 0.3
    found = other_reading(replace(sound, position=position), arm)
    assert found is not None
    assert "zero of joint 4 is off: add -0.3 rad to the position of joint 4" in found.sentence


def test_absolute_values_of_a_torque_are_said(sound: Recording, arm: RobotModel) -> None:
    found = other_reading(with_torque(sound, of_joint(2, np.abs)), arm)
    assert found is not None
    assert "torque of joint 2 has lost its sign" in found.sentence


def test_torques_before_gears_of_several_ratios_are_said(sound: Recording, arm: RobotModel) -> None:
    ratios = np.array([160.0, 160.0, 160.0, 160.0, 100.0, 160.0, 160.0])
    found = other_reading(with_torque(sound, lambda torque: torque / ratios), arm)
    assert found is not None
    said = re.search(r"different scales, joints 1 to 7 as ([^:]*):", found.sentence)
    assert said is not None
    scales = [float(value) for value in said[1].split(", ")]
    assert scales == pytest.approx(ratios.min() / ratios, abs=0.01)


def test_a_clock_twice_too_fast_is_said(sound: Recording, arm: RobotModel) -> None:
    fast = replace(sound, time=0.5 * sound.time, sampling_period_s=0.5 * sound.sampling_period_s)
    found = other_reading(fast, arm)
    assert found is not None
    assert "a true rate of 0.5 times the stated one" in found.sentence


def test_torques_of_another_arm_from_the_middle_on_are_said(
    sound: Recording, arm: RobotModel, table3: PhysicalParameters, states: tuple[np.ndarray, ...]
) -> None:
    other = inverse_dynamics(arm, replace(table3, mass=1.3 * table3.mass[::-1]), *states)
    half = np.arange(sound.samples) < sound.samples // 2
    found = other_reading(with_torque(sound, lambda torque: np.where(half[:, None], torque, other)), arm)
    assert found is not None
    assert found.sentence.startswith("From t = 15 ± 1.9 s on the torques are those of another arm")


def test_fit_and_doctor_say_it(sound: Recording, arm: RobotModel) -> None:
    filtered = with_torque(sound, low_pass(1.0, 2, True))
    for recording, said in ((sound, False), (filtered, True)):
        notes = fit_recordings([recording], arm, FitSettings(physical=False)).notes
        assert any(note.startswith("WARNING") and "low-passed before" in note for note in notes) == said
        checks = {check.name: check for check in set_up_checks([recording], arm, [])}
        assert checks["one body"].status == ("failed" if said else "ok")


def test_one_of_several_recordings_whose_joints_are_exchanged_is_named(
    sound: Recording, arm: RobotModel, table3: PhysicalParameters
) -> None:
    """All together no order was likelier: `fit` only said that they do not go together, and of the wrong one."""
    exchanged = [0, 2, 1, 3, 4, 5, 6]
    logs = []
    for seed in (3, 4, 5):
        motion = fourier_motion(7, period_s=30.0, samples=3000, seed=seed)
        torque = inverse_dynamics(arm, table3, *motion) + 0.02 * np.random.default_rng(seed).normal(size=(3000, 7))
        order = exchanged if seed == 4 else list(range(7))
        source = replace(sound.source, path=f"day{seed}.npz", sha256=f"{seed:064d}")
        logs.append(replace(sound, position=motion[0][:, order], torque=torque[:, order], source=source))
    notes = fit_recordings(logs, arm, FitSettings(physical=False)).notes
    (said,) = (note for note in notes if "stand in another order" in note)
    assert said.startswith("WARNING, day4.npz: Positions and torques")
    assert "joint 2 under joint 3, joint 3 under joint 2" in said


def test_a_misfit_that_is_small_beside_the_noise_is_no_other_reading() -> None:
    """Of n joints with so much noise nothing leaves an eighth: the sum of squares has to be 8.3 times the noise's."""
    assert not may_be_read_otherwise(np.full(7, 2.6))
    assert may_be_read_otherwise(np.full(7, 2.8))
    assert may_be_read_otherwise(np.array([7.5, *[0.0] * 6]))
    assert may_be_read_otherwise(np.full(7, np.nan))
