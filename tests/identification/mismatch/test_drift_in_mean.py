"""A drift that starts at zero, seen in mean and contrasts together; torque and noise are written down here."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest

from identification.base_parameters import BaseRegressor
from identification.mismatch.changes.between_periods import Change, find_between_periods
from identification.mismatch.changes.drift_in_mean import find_drift_in_mean
from identification.mismatch.effects.torque_offset import TorqueOffset
from identification.mismatch.effects.torque_sensor_drift import TorqueSensorDrift
from identification.mismatch.evidence import Evidence
from identification.mismatch.problem import build_problem
from identification.mismatch.reduction import build_evidence
from identification.mismatch.search.library import Library
from identification.mismatch.search.search import search
from identification.mismatch.settings import DiagnosisSettings
from identification.physical_parameters import PhysicalParameters
from identification.robots import RobotModel
from tests.identification.synthetic import fourier_motion, inverse_dynamics, recording_of

FloatArray = npt.NDArray[np.float64]

PERIOD_S, SAMPLES, PERIODS, NOISE_NM = 10.0, 2000, 16, 0.05
SIGMA_OF_MEAN = NOISE_NM / np.sqrt(SAMPLES * PERIODS)
SEEDS = (1, 2, 3)


@pytest.fixture(scope="module")
def evidence_with(
    iiwa14: RobotModel, iiwa14_base: BaseRegressor, table3: PhysicalParameters
) -> Callable[[FloatArray, int], Evidence]:
    """(course over the recording (rows,) Nm on joint 5, seed) → evidence."""
    q, dq, ddq = fourier_motion(7, period_s=PERIOD_S, samples=SAMPLES, seed=3)
    plain = np.tile(inverse_dynamics(iiwa14, table3, q, dq, ddq), (PERIODS, 1))

    def make(course: FloatArray, seed: int) -> Evidence:
        torque = plain + NOISE_NM * np.random.default_rng(seed).normal(size=plain.shape)
        torque[:, 4] += course
        recording = recording_of(np.tile(q, (PERIODS, 1)), torque, period_s=PERIOD_S, periods=PERIODS)
        return build_evidence(recording, iiwa14, iiwa14_base)[0]

    return make


def _found(evidence: Evidence) -> Change | None:
    settings = DiagnosisSettings()
    problem = build_problem([evidence])
    library = Library((TorqueOffset(),), (evidence,))
    result = search(problem, library, lambda _: library, settings)
    return find_drift_in_mean(problem, (evidence,), (), result, settings)


SHARE = np.arange(SAMPLES * PERIODS) / (SAMPLES * PERIODS)
"""Of the recording that is over."""


@pytest.mark.parametrize("seed", [1, 2, 4])
def test_a_drift_that_contrasts_do_not_prove_is_found_with_its_mean(
    evidence_with: Callable[[FloatArray, int], Evidence], seed: int
) -> None:
    size = 12.0 * SIGMA_OF_MEAN
    evidence = evidence_with(size * SHARE, seed)
    assert not find_between_periods([evidence], (TorqueSensorDrift(),))
    drift = _found(evidence)
    assert drift is not None
    assert drift.estimate.place.joint == 5
    (rate,) = drift.effect.parameters(drift.estimate)
    assert rate.value == pytest.approx(size * 3600.0 / (PERIOD_S * PERIODS), abs=3.0 * rate.std)
    assert drift.contribution.mean(axis=0)[0, 4] / np.sqrt(SAMPLES) == pytest.approx(
        0.5 * size, abs=3.0 * SIGMA_OF_MEAN
    )


@pytest.mark.parametrize("seed", [1, 2, 3, 4, 5, 6])
def test_beside_a_drift_no_offset_is_kept_that_it_explains_as_well(
    evidence_with: Callable[[FloatArray, int], Evidence], seed: int
) -> None:
    """λ of an even drift from 0 to a is a third of (a / σ)², a quarter of it between the periods.

    The search has an offset in its place; beside it a quarter is left of the drift, at no loss.
    """
    drift = _found(evidence_with(20.0 * SIGMA_OF_MEAN * SHARE, seed))
    assert drift is not None
    assert drift.gain == pytest.approx(400.0 / 3.0, abs=3.0 * 2.0 * np.sqrt(400.0 / 3.0))


@pytest.mark.parametrize("seed", SEEDS)
def test_one_that_settles_leaves_its_level_free(
    evidence_with: Callable[[FloatArray, int], Evidence], seed: int
) -> None:
    evidence = evidence_with(14.0 * SIGMA_OF_MEAN * np.minimum(1.0, SHARE / 0.4), seed)
    drift = _found(evidence)
    assert drift is not None
    assert drift.estimate.place.joint == 5
    level = np.zeros(evidence.torque.shape)
    level[0, 4] = 1.0
    assert np.allclose(drift.mean_columns[..., 1], level)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("size", [0.0, 9.0, 100.0])
def test_an_offset_is_no_drift(evidence_with: Callable[[FloatArray, int], Evidence], size: float, seed: int) -> None:
    assert _found(evidence_with(np.full(SHARE.size, size * SIGMA_OF_MEAN), seed)) is None
