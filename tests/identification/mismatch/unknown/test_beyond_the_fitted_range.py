"""A held-out motion that leaves the range of the fitted one. Truth: a torque written down here, on Pinocchio's arm."""

from __future__ import annotations

import numpy as np

from identification.base_parameters import BaseRegressor
from identification.mismatch.prepared import prepare
from identification.mismatch.settings import DiagnosisSettings
from identification.mismatch.unknown.classes import CLASSES
from identification.mismatch.unknown.dependence import find_dependence
from identification.mismatch.unknown.selection import Selection
from identification.physical_parameters import PhysicalParameters
from identification.robots import RobotModel
from tests.identification.mismatch.plant import on_joint, record


def brakes_harder_one_way(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
    return on_joint(3, 0.5 * np.abs(dq[:, 2]))


def test_what_grows_with_speed_is_predicted_at_speeds_that_were_not_fitted(
    iiwa14: RobotModel, iiwa14_base: BaseRegressor, table3: PhysicalParameters
) -> None:
    settings = DiagnosisSettings()
    slow, fast = (
        prepare([record(iiwa14, table3, brakes_harder_one_way, motion=motion)], iiwa14, iiwa14_base, settings, None)
        for motion in (3, 9)
    )
    speeds = [np.abs(role.evidences[0].motion.velocity[:, 2]).max() for role in (slow, fast)]
    assert speeds[1] > 1.3 * speeds[0]
    found = find_dependence(slow, fast)
    assert ("own_velocity", 2) in {(CLASSES[item.number].name, item.joint) for item in found.held}
    plain = Selection.nominal(found.alone.rows, range(found.alone.rows.folds))
    assert found.after[1][2] < 0.3 * found.left(plain)[1][2]
