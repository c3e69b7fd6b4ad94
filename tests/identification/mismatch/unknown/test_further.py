"""Functions of one other joint, as nobody wrote them down. Truth: plants computed by Pinocchio, torque written here."""

from __future__ import annotations

import numpy as np
import pytest

from identification.base_parameters import BaseRegressor
from identification.mismatch.prepared import prepare
from identification.mismatch.settings import DiagnosisSettings
from identification.mismatch.unknown.classes import CLASSES
from identification.mismatch.unknown.dependence import find_dependence
from identification.physical_parameters import PhysicalParameters
from identification.robots import RobotModel
from tests.identification.mismatch.plant import PERIOD_S, Hidden, on_joint, record


def slow_wrist(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """A torque of joint 4 while joint 6 moves slowly."""
    del q, torque
    return on_joint(4, 0.15 * np.exp(-((dq[:, 5] / 0.15) ** 2)))


def loaded_shoulder(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """A torque of joint 4 while joint 2 carries about the usual torque."""
    del q, dq
    load = torque[:, 1]
    return on_joint(4, 0.15 * np.exp(-(((load - np.median(load)) / (0.15 * np.abs(load).max())) ** 2)))


def pressed_hose(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """Friction of joint 4 that the pose of joint 3 makes larger or smaller."""
    del torque
    return on_joint(4, 0.06 * np.tanh(dq[:, 3] / 0.003) * np.sin(1.7 * q[:, 2] + 1.0))


def bevel_teeth(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """Teeth that joints 5 and 6 turn together."""
    del dq, torque
    return on_joint(6, 0.06 * np.sin(11.0 * (q[:, 5] - q[:, 4])))


def warm_oil(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """Friction of joint 7 that falls with its own losses of the last three seconds."""
    del q, torque
    loss = np.fft.rfft(np.abs(dq[:, 6]))
    warm = np.fft.irfft(loss / (1.0 + 2j * np.pi * np.arange(loss.size) * 3.0 / PERIOD_S), len(dq))
    return on_joint(7, -0.2 * np.tanh(dq[:, 6] / 0.003) * warm / warm.mean())


@pytest.mark.parametrize(
    ("hidden", "name", "joint"),
    [(pressed_hose, "configuration", 4), (bevel_teeth, "configuration", 6), (warm_oil, "own_velocity", 7)],
)
def test_friction_as_large_as_something_else_and_teeth_of_two_joints_have_their_class_first(
    iiwa14: RobotModel,
    iiwa14_base: BaseRegressor,
    table3: PhysicalParameters,
    hidden: Hidden,
    name: str,
    joint: int,
) -> None:
    """They were its own position by direction of motion, or nothing that was asked."""
    recordings = record(iiwa14, table3, hidden, motion=9), record(iiwa14, table3, hidden, periods=4, motion=29, seed=2)
    settings = DiagnosisSettings()
    found = find_dependence(*(prepare([item], iiwa14, iiwa14_base, settings, None) for item in recordings))
    first = max(found.held, key=lambda item: item.loss)
    assert (CLASSES[first.number].name, first.joint + 1) == (name, joint)


@pytest.mark.parametrize(("hidden", "name"), [(slow_wrist, "other_motion"), (loaded_shoulder, "other_torques")])
def test_a_function_of_one_other_joint_has_its_class_first(
    iiwa14: RobotModel, iiwa14_base: BaseRegressor, table3: PhysicalParameters, hidden: Hidden, name: str
) -> None:
    """The first was called broadband and the second a function of the joint's own load."""
    settings = DiagnosisSettings()
    recordings = record(iiwa14, table3, hidden, motion=9), record(iiwa14, table3, hidden, periods=4, seed=2)
    fitted, unseen = (prepare([recording], iiwa14, iiwa14_base, settings, None) for recording in recordings)
    found = find_dependence(fitted, unseen)
    first = max(found.held, key=lambda item: item.loss)
    assert (CLASSES[first.number].name, first.joint + 1) == (name, 4)
    assert all(len(set(groups)) == len(groups) for groups in found.chosen)


def test_a_function_of_another_joint_whose_mean_is_most_of_it_is_no_constant(
    iiwa14: RobotModel, iiwa14_base: BaseRegressor, table3: PhysicalParameters
) -> None:
    """A torque of joint 3 that grows with the speed of joint 5, either way: its waves were taken for slow noise."""

    def hidden(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
        del q, torque
        return on_joint(3, 0.03 * np.abs(dq[:, 4]) ** 1.2)

    recordings = record(iiwa14, table3, hidden, motion=4), record(iiwa14, table3, hidden, periods=4, motion=24, seed=2)
    settings = DiagnosisSettings()
    found = find_dependence(*(prepare([item], iiwa14, iiwa14_base, settings, None) for item in recordings))
    first = max(found.held, key=lambda item: item.loss)
    assert (CLASSES[first.number].name, first.joint + 1) == ("other_motion", 3)
