"""A smooth error of one joint alone: said as a class. Truth: a function written onto the plant here."""

from __future__ import annotations

import numpy as np

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


def test_a_smooth_error_of_one_joint_alone_is_no_background(
    iiwa14: RobotModel, iiwa14_base: BaseRegressor, table3: PhysicalParameters
) -> None:
    recordings = (
        record(iiwa14, table3, own_and_next, motion=9),
        record(iiwa14, table3, own_and_next, periods=4, motion=3, seed=2),
    )
    first, second = (prepare([item], iiwa14, iiwa14_base, DiagnosisSettings(), None) for item in recordings)
    found = find_dependence(first, second).held
    assert {item.joint for item in found if item.loss > 8.0} == {JOINT - 1}
    assert not any(CLASSES[number].background for item in found for number in (item.number, *item.alternatives))
