"""Weights of rows against those of `fit`, whose own path goes from the samples to the parameters."""

from __future__ import annotations

import numpy as np
import pytest

from identification.mismatch.fit_weights import with_periods
from identification.mismatch.nominal import nominal_fit
from identification.mismatch.prepared import prepare
from identification.mismatch.problem import build_problem
from identification.mismatch.search.extension import extend
from identification.mismatch.settings import DiagnosisSettings
from identification.physical_parameters import PhysicalParameters
from identification.robots import RobotModel
from tests.identification.mismatch.plant import on_joint, record


@pytest.mark.parametrize("drag", [0.0, 0.1, 2.0])
def test_base_parameters_are_those_of_fit_however_much_one_joint_is_misfitted(
    iiwa14: RobotModel, table3: PhysicalParameters, drag: float
) -> None:
    """Friction with the square of speed on joint 4. Weighted by the noise alone, it bends every other joint's rows."""

    def hidden(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
        del q, torque
        return on_joint(4, drag * dq[:, 3] * np.abs(dq[:, 3]))

    recording, settings = record(iiwa14, table3, hidden, motion=2), DiagnosisSettings()
    fit = nominal_fit([recording], iiwa14, settings)
    assert fit is not None
    problem = build_problem(prepare([recording], iiwa14, fit.regressor, settings, None).evidences)
    ours, plain = (np.abs(extend(item, ()).base - fit.values) / fit.std for item in (with_periods(problem), problem))
    assert ours.max() < 1.0
    assert drag < 1.0 or plain.max() > 10.0
