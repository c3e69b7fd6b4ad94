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
from tests.identification.mismatch.plant import Hidden, on_joint, record


def slow_wrist(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """A torque of joint 4 while joint 6 moves slowly."""
    del q, torque
    return on_joint(4, 0.15 * np.exp(-((dq[:, 5] / 0.15) ** 2)))


def loaded_shoulder(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """A torque of joint 4 while joint 2 carries about the usual torque."""
    del q, dq
    load = torque[:, 1]
    return on_joint(4, 0.15 * np.exp(-(((load - np.median(load)) / (0.15 * np.abs(load).max())) ** 2)))


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
