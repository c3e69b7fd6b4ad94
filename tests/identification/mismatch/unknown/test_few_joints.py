"""A smooth error of a few joints: said as classes. Truth: functions written onto the plant here."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from identification.base_parameters import BaseRegressor
from identification.mismatch.prepared import prepare
from identification.mismatch.settings import DiagnosisSettings
from identification.mismatch.unknown.classes import CLASSES
from identification.mismatch.unknown.dependence import find_dependence
from identification.physical_parameters import PhysicalParameters
from identification.robots import RobotModel
from tests.identification.mismatch.plant import on_joint, record

JOINT = 5


def own_and_next(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """A smooth function of the joint's state and the next joint's position."""
    del torque
    return on_joint(JOINT, 0.3 * np.sin(1.5 * q[:, JOINT - 1] + dq[:, JOINT - 1] + 1.2 * q[:, JOINT]))


def hose_over_two_joints(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """A hose along joints 5 and 6 that hardens with what both are turned together."""
    del torque, dq
    pull = -0.5 * (q[:, 4] + q[:, 5]) ** 3
    return on_joint(5, pull) + on_joint(6, pull)


@pytest.mark.parametrize(("error", "joints"), [(own_and_next, {5}), (hose_over_two_joints, {5, 6})])
def test_a_smooth_error_of_few_joints_is_no_background(
    error: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray],
    joints: set[int],
    iiwa14: RobotModel,
    iiwa14_base: BaseRegressor,
    table3: PhysicalParameters,
) -> None:
    recordings = (
        record(iiwa14, table3, error, motion=9),
        record(iiwa14, table3, error, periods=4, motion=3, seed=2),
    )
    first, second = (prepare([item], iiwa14, iiwa14_base, DiagnosisSettings(), None) for item in recordings)
    found = find_dependence(first, second).held
    assert {item.joint for item in found if item.loss > 8.0} == {joint - 1 for joint in joints}
    assert not any(CLASSES[number].background for item in found for number in (item.number, *item.alternatives))
