"""Pushes that come with every period, against torque that Pinocchio's Jacobian makes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pinocchio
import pytest

from identification.base_parameters import BaseRegressor
from identification.mismatch.changes.between_periods import Change
from identification.mismatch.changes.repeated_contact import (
    excess_per_row,
    explains_better,
    find_repeated_contact,
    misfit_elsewhere,
)
from identification.mismatch.evidence import Evidence
from identification.mismatch.problem import Problem, build_problem
from identification.mismatch.reduction import build_evidence
from identification.mismatch.search.library import Library
from identification.mismatch.search.search import SearchResult
from identification.mismatch.search.trial import Trial, fitted
from identification.mismatch.settings import DiagnosisSettings
from identification.physical_parameters import PhysicalParameters
from identification.robots import RobotModel
from tests.identification.mismatch.plant import PERIOD_S, SAMPLES, Hidden, no_effect, on_joint, record

FloatArray = npt.NDArray[np.float64]

SETTINGS = DiagnosisSettings()
START_S, DURATION_S = 3.1, 1.2
FORCE, POINT = np.array([0.5, -0.3, 0.4]), np.array([0.05, 0.08, -0.04])


@dataclass(frozen=True)
class Unexplained:
    """A recording as it is before anything of the library is tried."""

    problem: Problem
    evidence: Evidence
    result: SearchResult

    def push(self, misfit_elsewhere: float = 0.0) -> Change | None:
        return find_repeated_contact(self.problem, (self.evidence,), self.result, SETTINGS, lambda: misfit_elsewhere)


def _result(trial: Trial) -> SearchResult:
    return SearchResult(trial=trial, before=trial, library=None, looked_at=None)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def unexplained(iiwa14: RobotModel, iiwa14_base: BaseRegressor, table3: PhysicalParameters):
    def make(hidden: Hidden) -> Unexplained:
        (evidence,) = build_evidence(record(iiwa14, table3, hidden), iiwa14, iiwa14_base)
        problem = build_problem([evidence])
        return Unexplained(problem, evidence, _result(fitted(problem, (), SETTINGS)))

    return make


@pytest.fixture(scope="module")
def pushed(iiwa14: RobotModel) -> Hidden:
    """A force of fixed direction in the base frame on link 4 for 1.2 s of each period, half a sine."""
    model = iiwa14.pinocchio_model
    data = model.createData()
    frame = pinocchio.ReferenceFrame.LOCAL_WORLD_ALIGNED

    def torque(q: FloatArray, dq: FloatArray, measured: FloatArray) -> FloatArray:
        result = np.zeros_like(q)
        share = (np.arange(SAMPLES) * PERIOD_S / SAMPLES - START_S) / DURATION_S
        for row in np.flatnonzero((share > 0.0) & (share < 1.0)):
            pinocchio.computeJointJacobians(model, data, q[row])
            jacobian = pinocchio.getJointJacobian(model, data, 4, frame)
            lever = data.oMi[4].rotation @ POINT
            wrench = np.concatenate([FORCE, np.cross(lever, FORCE)])
            result[row] = -np.sin(np.pi * share[row]) * (jacobian.T @ wrench)
        return result

    return torque


def test_a_push_in_every_period_is_found_with_its_link_window_and_force(unexplained, pushed: Hidden) -> None:
    hidden = unexplained(pushed)
    assert not hidden.result.trial.complete
    push = hidden.push()
    assert push is not None
    assert push.estimate.place.link == 4
    assert push.estimate.shape["start_s"] == pytest.approx(START_S, abs=0.1)
    assert push.estimate.shape["duration_s"] == pytest.approx(DURATION_S, abs=0.2)
    assert push.estimate.shape["period_s"] == PERIOD_S
    size = push.effect.parameters(push.estimate)[0]
    assert abs(size.value - np.linalg.norm(FORCE)) < 3.0 * size.std
    assert "every period" in push.effect.sentence(push.estimate)

    left = hidden.evidence.torque - push.contribution.mean(axis=0)
    beside = build_problem((hidden.evidence,), [left], [(0, push.mean_columns)])
    assert explains_better(hidden.problem, push, _result(fitted(beside, (), SETTINGS)), hidden.result, SETTINGS)


def test_a_spring_across_two_joints_is_no_push_as_another_motion_shows_it_too(
    unexplained,
    iiwa14: RobotModel,
    iiwa14_base: BaseRegressor,
    table3: PhysicalParameters,
    pushed: Hidden,
) -> None:
    def spring(q: FloatArray, dq: FloatArray, measured: FloatArray) -> FloatArray:
        stretch = 0.4 * q[:, 5] * q[:, 6]
        return on_joint(6, stretch * q[:, 6]) + on_joint(7, stretch * q[:, 5])

    def wrong_elsewhere(hidden: Hidden, there: Hidden) -> bool:
        case = unexplained(hidden)
        push = case.push()
        assert push is not None
        elsewhere = build_evidence(record(iiwa14, table3, there, periods=4, motion=9, seed=2), iiwa14, iiwa14_base)
        left = case.evidence.torque - push.contribution.mean(axis=0)
        beside = build_problem((case.evidence,), [left], [(0, push.mean_columns)])
        library = Library((), elsewhere)
        return misfit_elsewhere(push, beside, (), library, [item.torque for item in elsewhere], SETTINGS)

    assert not wrong_elsewhere(pushed, no_effect)
    assert wrong_elsewhere(spring, spring)


def test_no_push_is_looked_for_where_another_motion_shows_as_much_misfit(unexplained, pushed: Hidden) -> None:
    hidden = unexplained(pushed)
    assert hidden.push(excess_per_row(hidden.problem)) is None


def test_what_the_effect_says_it_is_is_what_was_taken_off(unexplained, pushed: Hidden) -> None:
    hidden = unexplained(pushed)
    push = hidden.push()
    assert push is not None
    motion = hidden.evidence.motion
    columns = push.effect.columns(motion, push.estimate.place, push.estimate.shape)
    assert columns is not None
    rows = hidden.evidence.project(columns.values @ push.estimate.coefficients)
    taken = push.contribution[0][:, list(columns.joints)]
    assert np.abs(rows - taken).max() < 1e-6 * np.abs(taken).max()


def test_torque_at_one_angle_of_one_joint_is_no_push(unexplained) -> None:
    def bump(q: FloatArray, dq: FloatArray, measured: FloatArray) -> FloatArray:
        return on_joint(4, 0.5 * np.exp(-(((q[:, 3] - np.median(q[:, 3])) / 0.1) ** 2)))

    hidden = unexplained(bump)
    assert not hidden.result.trial.complete
    assert hidden.push() is None


def test_nothing_is_found_where_nothing_is_hidden(unexplained) -> None:
    hidden = unexplained(no_effect)
    assert hidden.result.trial.complete
    assert hidden.push() is None
