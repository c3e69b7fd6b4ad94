"""The form of what stays, and its size beside other joints. Truth: the torque that was hidden, and closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from identification.base_parameters import BaseRegressor
from identification.estimators.physical import PhysicalParameters
from identification.mismatch.effects import effect_named
from identification.mismatch.effects.base import Place
from identification.mismatch.evidence import Evidence, build_evidence
from identification.mismatch.form import left_in_other_form
from identification.mismatch.heldout import Residuals
from identification.mismatch.library import Library
from identification.mismatch.local_torque import local_torques
from identification.mismatch.problem import Problem, build_problem
from identification.mismatch.refinement import Member, score_of
from identification.mismatch.settings import DiagnosisSettings
from identification.mismatch.verdict import contrast, contrast_by_band
from identification.robots import RobotModel
from tests.identification.mismatch.plant import on_joint, record

PROBABILITY = 1e-5
CABLE = effect_named("cable_spring")


def _best_local(problem: Problem, library: Library, joint: int) -> float:
    return max(score for score, _ in local_torques(problem, library, joint))


def test_noise_has_no_form_on_any_joint(clean_evidence: Evidence) -> None:
    problem = build_problem([clean_evidence])
    assert [left_in_other_form(problem, [clean_evidence], joint, PROBABILITY) for joint in range(7)] == [0.0] * 7


def test_a_torque_at_one_place_of_the_range_is_seen_on_its_joint_at_its_size(
    iiwa14: RobotModel, iiwa14_base: BaseRegressor, table3: PhysicalParameters
) -> None:
    def notch(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
        del dq, torque
        return on_joint(5, 0.03 * np.exp(-(((q[:, 4] - np.median(q[:, 4])) / 0.3) ** 2)))

    (evidence,) = build_evidence(record(iiwa14, table3, notch), iiwa14, iiwa14_base)
    problem = build_problem([evidence])
    left = [left_in_other_form(problem, [evidence], joint, PROBABILITY) for joint in range(7)]
    hidden = evidence.project(notch(evidence.motion.position, evidence.motion.velocity, evidence.motion.position))
    whitened = (hidden.T * problem.weight).ravel()
    strength = float(np.sum((whitened - problem.basis @ (problem.basis.T @ whitened)) ** 2))
    assert int(np.argmax(left)) == 4
    assert 0.5 * strength < left[4] < 1.5 * strength


def test_a_stop_is_explained_best_by_what_acts_in_a_part_of_the_range_and_a_spring_is_not(
    iiwa14: RobotModel, iiwa14_base: BaseRegressor, table3: PhysicalParameters
) -> None:
    def stop(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
        return on_joint(6, 0.5 * np.maximum(q[:, 5] - np.quantile(q[:, 5], 0.7), 0.0) ** 3)

    def spring(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
        return on_joint(6, 0.05 * q[:, 5])

    for hidden, is_local in ((stop, True), (spring, False)):
        (evidence,) = build_evidence(record(iiwa14, table3, hidden), iiwa14, iiwa14_base)
        problem = build_problem([evidence])
        library = Library((CABLE,), [evidence])
        rows = library.rows(CABLE, Place(joint=6), ())
        assert rows is not None
        named, local = score_of(problem, Member(rows, (0, 1))), _best_local(problem, library, 5)
        assert named > 20.0
        assert (local > named) == is_local


def test_noise_alone_has_no_local_torque(clean_evidence: Evidence) -> None:
    problem = build_problem([clean_evidence])
    library = Library((), [clean_evidence])
    assert max(_best_local(problem, library, joint) for joint in range(7)) < 8.0


def _residuals(rows: np.ndarray) -> Residuals:
    """Rows (3, 100) in units of the noise."""
    one = np.ones((3, 100))
    return Residuals(
        rows=rows, noise=one, sensor_noise=one, used=one > 0.0, samples=100, scatter=np.zeros((*rows.shape, 0))
    )


def test_contrast_is_what_goes_on_the_joint_over_what_stays_elsewhere() -> None:
    def of(squares: list[float]) -> Residuals:
        return _residuals(np.sqrt(np.array(squares))[:, None] * np.ones((3, 100)) / 10.0)

    without, with_it = of([900.0, 200.0, 150.0]), of([100.0, 200.0, 150.0])
    assert contrast(without, with_it, [0]) == pytest.approx(800.0 / 100.0)


def test_band_by_band_only_the_bands_that_another_joint_leaves_alone_count() -> None:
    """Joint 2 keeps 100 times the noise in the low band and the noise itself in the high one."""
    band = np.repeat([0, 1], 50)
    left = np.ones((3, 100))
    left[1, :50] = 10.0
    low, high = left.copy(), left.copy()
    low[0, :50] = high[0, 50:] = 10.0
    now, settings = _residuals(left), DiagnosisSettings(contrast_to_background=4.0)
    seen = contrast_by_band(_residuals(high), now, [0], band, settings)
    assert seen == pytest.approx(25.0 * np.log(104.0 / 5.0))
    assert contrast_by_band(_residuals(low), now, [0], band, settings) == pytest.approx(25.0 * np.log(500.0 / 401.0))
