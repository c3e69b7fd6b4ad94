"""What the tests of the diagnosis share: evidences of concealed plants, made once."""

from __future__ import annotations

import numpy as np
import pytest

from identification.base_parameters import BaseRegressor
from identification.mismatch.diagnosis import diagnose
from identification.mismatch.evidence import Evidence
from identification.mismatch.findings import Diagnosis
from identification.mismatch.reduction import build_evidence
from identification.physical_parameters import PhysicalParameters
from identification.robots import RobotModel
from tests.identification.mismatch.plant import on_joint, record


def spring_and_stribeck(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """A cable spring on joint 6 and Stribeck friction on joint 1."""
    del torque
    stribeck = 0.3 * np.exp(-((dq[:, 0] / 0.05) ** 2)) * np.sign(dq[:, 0])
    return on_joint(6, 0.4 * (q[:, 5] - 0.3)) + on_joint(1, stribeck)


@pytest.fixture(scope="session")
def clean_evidence(iiwa14: RobotModel, iiwa14_base: BaseRegressor, table3: PhysicalParameters) -> Evidence:
    """Nothing hidden, noise of 0.05 Nm."""
    (evidence,) = build_evidence(record(iiwa14, table3), iiwa14, iiwa14_base)
    return evidence


@pytest.fixture(scope="session")
def clean_diagnosis(iiwa14: RobotModel, table3: PhysicalParameters) -> Diagnosis:
    """Nothing hidden; the measured position carries feedback noise of 5 microradian."""
    return diagnose([record(iiwa14, table3, position_noise=5e-6)], iiwa14)


@pytest.fixture(scope="session")
def pair_diagnosis(iiwa14: RobotModel, table3: PhysicalParameters) -> Diagnosis:
    """A spring on joint 6 and Stribeck friction on joint 1, checked on another motion."""
    fitted = record(iiwa14, table3, spring_and_stribeck)
    unseen = record(iiwa14, table3, spring_and_stribeck, periods=4, motion=9, seed=2)
    return diagnose([fitted], iiwa14, heldout=[unseen])
