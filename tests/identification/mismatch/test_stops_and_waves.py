"""Torque that the library does not hold and one of its curves fits well. Truth: what was written onto the plant."""

from __future__ import annotations

import numpy as np
import pytest

from identification.mismatch.diagnosis import diagnose
from identification.physical_parameters import PhysicalParameters
from identification.robots import RobotModel
from tests.identification.mismatch.plant import on_joint, record


@pytest.mark.parametrize("size", [1.5, 6.0])
def test_a_stop_that_a_spring_fits_on_one_motion_is_no_spring(
    iiwa14: RobotModel, table3: PhysicalParameters, size: float
) -> None:
    """Where the held-out motion goes elsewhere, the spring goes on and the stop does not."""

    def stop(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
        return on_joint(2, size * np.maximum(q[:, 1] + 0.4, 0.0) ** 3)

    diagnosis = diagnose(
        [record(iiwa14, table3, stop)], iiwa14, heldout=[record(iiwa14, table3, stop, periods=4, motion=9, seed=2)]
    )
    assert diagnosis.verdict == "unexplained"
    assert not diagnosis.findings
    assert "joint 2" in diagnosis.remaining.lower()


@pytest.mark.parametrize(("drift", "names"), [(0.0, ["position_dependent_torque"]), (0.9, [])])
def test_a_wave_whose_order_drifts_with_the_angle_is_no_eccentricity(
    iiwa14: RobotModel, table3: PhysicalParameters, drift: float, names: list[str]
) -> None:
    """Truth: a wave of order 6, and one of order 6.4 that drifts."""

    def wave(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
        order = 6.4 if drift else 6.0
        return on_joint(5, 0.3 * np.sin(order * q[:, 4] + drift * q[:, 4] ** 2))

    diagnosis = diagnose(
        [record(iiwa14, table3, wave)], iiwa14, heldout=[record(iiwa14, table3, wave, periods=4, motion=9, seed=2)]
    )
    assert [item.effect for item in diagnosis.findings] == names
