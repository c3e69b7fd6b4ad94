"""Torques that a class once had no functions for. Truth: plants computed by Pinocchio with torque written here."""

from __future__ import annotations

import numpy as np
import pytest

from identification.base_parameters import BaseRegressor
from identification.mismatch.aperiodic_evidence import default_split
from identification.mismatch.diagnosis import diagnose
from identification.mismatch.prepared import prepare
from identification.mismatch.settings import DiagnosisSettings
from identification.mismatch.unknown.classes import CLASSES, TOLD_BY_NOISE
from identification.mismatch.unknown.rows import build_rows
from identification.physical_parameters import PhysicalParameters
from identification.recordings import read_recording
from identification.robots import RobotModel, load_robot
from tests.identification.mismatch.plant import PERIOD_S, Hidden, on_joint, record
from tests.reference import recording_file


def dead_zone(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """A sensor of joint 2 that misses a quarter of a Nm around no load, within a sixteenth of its largest torque."""
    del q, dq
    load = torque[:, 1]
    width = 0.06 * np.abs(load).max()
    return on_joint(2, -0.25 * np.clip(load / width, -1.0, 1.0) * np.clip(2.0 - np.abs(load) / width, 0.0, 1.0))


def first_order(values: np.ndarray, seconds: float) -> np.ndarray:
    """Values (S,) of one period behind a lag of first order."""
    omega = 2.0j * np.pi * np.fft.rfftfreq(values.size, PERIOD_S / values.size)
    return np.asarray(np.fft.irfft(np.fft.rfft(values) / (1.0 + seconds * omega), n=values.size))


def late_friction(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """What Stribeck friction of joint 3 lacks that follows the velocity with a lag of 60 ms (Hess and Soom)."""
    del q, torque
    velocity = dq[:, 2]
    friction = np.tanh(velocity / 0.05) * (1.0 + 0.5 * np.exp(-((velocity / 0.15) ** 2)))
    return on_joint(3, 0.4 * (first_order(friction, 0.06) - friction))


def soon_after(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """Coulomb friction of joint 5 that follows with a lag of 6 ms, little more than a row."""
    del q, torque
    friction = np.tanh(dq[:, 4] / 0.003)
    return on_joint(5, 0.5 * (first_order(friction, 0.006) - friction))


def lower_at_the_speed_before(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """Friction of joint 4 that turns round at once and falls with the speed of 0.2 s before (Armstrong-Hélouvry)."""
    del q, torque
    speed = first_order(np.abs(dq[:, 3]), 0.2)
    return on_joint(4, 0.2 * np.tanh(dq[:, 3] / 0.003) * np.exp(-((speed / 0.1) ** 2)))


def some_time_ago(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """Coulomb friction of joint 5 as it was 15 ms, three rows, before: a delay without any lag (Hess and Soom)."""
    del q, torque
    friction = np.tanh(dq[:, 4] / 0.003)
    return on_joint(5, 0.2 * (np.roll(friction, 3) - friction))


@pytest.mark.parametrize(
    ("hidden", "name", "joint", "motion"),
    [
        # It was "broadband": torque that repeats with the motion and depends on nothing that was asked.
        (dead_zone, "own_load", 2, 12),
        # It was pre-sliding hysteresis, a wrong name, and three classes.
        (late_friction, "own_velocity", 3, 9),
        # It followed its own torque late, too.
        (soon_after, "own_velocity", 5, 9),
        (some_time_ago, "own_velocity", 5, 9),
        # It was a function of the position and two more.
        (lower_at_the_speed_before, "own_velocity", 4, 9),
    ],
)
def test_a_narrow_function_of_the_load_and_friction_that_follows_late_are_given_their_class(
    iiwa14: RobotModel, table3: PhysicalParameters, hidden: Hidden, name: str, joint: int, motion: int
) -> None:
    first, second = record(iiwa14, table3, hidden, motion=motion), record(iiwa14, table3, hidden, periods=4, seed=2)
    found = diagnose([first], iiwa14, heldout=[second])
    assert [(item.name, item.joint) for item in found.classes] == [(name, joint)]
    assert not found.findings


def test_where_a_dead_zone_shows_little_its_class_comes_first(iiwa14: RobotModel, table3: PhysicalParameters) -> None:
    """By this motion it has a quarter of the nats, and by another noise it is said of the configuration: before
    friction that follows late had more functions, too.
    """
    found = diagnose(
        [record(iiwa14, table3, dead_zone, motion=9)],
        iiwa14,
        heldout=[record(iiwa14, table3, dead_zone, periods=4, seed=2)],
    )
    assert (found.classes[0].name, found.classes[0].joint) == ("own_load", 2)
    assert {item.joint for item in found.classes} == {2}
    assert not found.findings


def test_friction_that_follows_late_is_not_asked_where_the_noise_is_not_measured() -> None:
    """Asked there, the Panda's joint 7 changed between its own velocity and its path with whatever else was hidden."""
    robot, settings = load_robot(recording_file("ur10_mdh.csv")), DiagnosisSettings()
    recording = read_recording(recording_file("ur10.npz"))
    fitted = prepare([recording], robot, BaseRegressor(robot), settings, default_split([recording], settings))
    asked = {
        CLASSES[basis.number].groups[basis.group] for joint in build_rows(fitted, None).joints for basis in joint.bases
    }
    assert asked
    assert not asked & set(TOLD_BY_NOISE)
