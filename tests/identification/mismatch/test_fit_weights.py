"""Weights of rows against those of `fit`, whose own path goes from the samples to the parameters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from identification.mismatch.fit_weights import with_periods, without_periods
from identification.mismatch.nominal import nominal_fit
from identification.mismatch.prepared import prepare
from identification.mismatch.problem import build_problem
from identification.mismatch.search.extension import extend
from identification.mismatch.settings import DiagnosisSettings
from identification.physical_parameters import PhysicalParameters
from identification.robots import RobotModel
from tests.identification.mismatch.plant import on_joint, record


def _friction(drag: float) -> Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
    """Friction with the square of speed on joint 4."""

    def hidden(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
        del q, torque
        return on_joint(4, drag * dq[:, 3] * np.abs(dq[:, 3]))

    return hidden


@pytest.mark.parametrize("drag", [0.0, 0.1, 2.0])
def test_base_parameters_are_those_of_fit_however_much_one_joint_is_misfitted(
    iiwa14: RobotModel, table3: PhysicalParameters, drag: float
) -> None:
    """Weighted by the noise alone, the misfit of joint 4 bends every other joint's rows."""
    recording, settings = record(iiwa14, table3, _friction(drag), motion=2), DiagnosisSettings()
    fit = nominal_fit([recording], iiwa14, settings)
    assert fit is not None
    problem = build_problem(prepare([recording], iiwa14, fit.regressor, settings, None).evidences)
    ours, plain = (np.abs(extend(item, ()).base - fit.values) / fit.std for item in (with_periods(problem), problem))
    assert ours.max() < 1.0
    assert drag < 1.0 or plain.max() > 10.0


def test_without_periods_a_joint_counts_by_what_it_is_left_and_the_parameters_are_those_of_fit(
    iiwa14: RobotModel, table3: PhysicalParameters
) -> None:
    """By hand: a joint's noise is a tenth of the deviation of its own rows, less those that parameters take up, and a
    millionth of its torque.
    """
    periodic = record(iiwa14, table3, _friction(2.0), motion=2, periods=2)
    recording = replace(periodic, period_s=None, period_index=None, sample_in_period=None)
    settings = DiagnosisSettings()
    fit = nominal_fit([recording], iiwa14, settings)
    assert fit is not None
    prepared = prepare([recording], iiwa14, fit.regressor, settings, None)
    problem = without_periods(prepared.problem(), prepared, ())
    used = problem.weight > 0.0
    left = problem.residual.reshape(used.shape)
    freedom = used.sum(axis=1) - (problem.basis**2).sum(axis=1).reshape(used.shape).sum(axis=1)
    level = np.sqrt(((left * problem.noise) ** 2).sum(axis=1) / freedom)
    torque = np.sqrt(np.mean(prepared.evidences[0].torque ** 2, axis=0))
    assert np.allclose(problem.noise[:, 0], 0.1 * level + 1e-6 * torque, rtol=1e-3)
    ours, by_band = (np.abs(extend(item, ()).base - fit.values) / fit.std for item in (problem, prepared.problem()))
    assert ours.max() < 0.2
    assert by_band.max() > 3.0
