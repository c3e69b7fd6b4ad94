"""The same physics on every joint is one hypothesis. Truth: what was written onto the plant that Pinocchio computes."""

from __future__ import annotations

import numpy as np

from identification.mismatch.diagnosis import diagnose
from identification.physical_parameters import PhysicalParameters
from identification.robots import RobotModel
from tests.identification.mismatch.plant import record

STRIBECK = np.array([0.4, 0.3, 0.25, 0.3, 0.2, 0.25, 0.2])


def stribeck(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
    del q, torque
    return STRIBECK * np.exp(-((dq / 0.06) ** 2)) * np.sign(dq)


def test_friction_that_every_joint_has_is_named_on_every_joint(iiwa14: RobotModel, table3: PhysicalParameters) -> None:
    """Seven members are more than may explain everything by the noise alone; as one hypothesis they are one."""
    fitted, unseen = (
        record(iiwa14, table3, stribeck, periods=periods, motion=motion, seed=seed)
        for periods, motion, seed in ((8, 9, 1), (4, 3, 2))
    )
    diagnosis = diagnose([fitted], iiwa14, heldout=[unseen])
    assert [(item.effect, item.place.joint) for item in diagnosis.findings] == [
        ("stribeck_friction", joint) for joint in range(1, 8)
    ]
    for item, truth in zip(diagnosis.findings, STRIBECK, strict=True):
        assert abs(item.parameters[0].value - truth) < 4.0 * item.parameters[0].std + 0.05 * truth
    assert diagnosis.verdict == "explained"
