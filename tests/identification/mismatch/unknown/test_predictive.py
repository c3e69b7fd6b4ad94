"""Classes go one at a time where a joint is predicted worse by them. Truth: errors written down here."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from identification.base_parameters import BaseRegressor
from identification.mismatch.prepared import prepare
from identification.mismatch.settings import DiagnosisSettings
from identification.mismatch.unknown.classes import CLASSES
from identification.mismatch.unknown.dependence import weighed
from identification.mismatch.unknown.left import Left, base_of
from identification.mismatch.unknown.predictive import LEAST_CHANGE, harmless, useful
from identification.mismatch.unknown.rows import build_rows
from identification.mismatch.unknown.selection import Selection
from identification.physical_parameters import PhysicalParameters
from identification.robots import RobotModel
from tests.identification.mismatch.plant import on_joint, record

FloatArray = npt.NDArray[np.float64]

ONE = np.ones(7)


def bends(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
    del torque
    return on_joint(3, 0.3 * np.tanh(q[:, 2] / 0.2) + 0.3 * np.abs(dq[:, 2]))


def held(selection: Selection, joint: int) -> set[str]:
    return {CLASSES[number].name for number in selection.families(joint, selection.states[joint])}


@pytest.fixture(scope="module")
def weighed_once(iiwa14: RobotModel, iiwa14_base: BaseRegressor, table3: PhysicalParameters) -> Selection:
    """All classes on every joint."""
    fitted = prepare([record(iiwa14, table3, bends)], iiwa14, iiwa14_base, DiagnosisSettings(), None)
    return weighed(build_rows(fitted, None))


@pytest.fixture
def all_classes(weighed_once: Selection) -> Selection:
    """The same, for a test to change."""
    return replace(weighed_once, states=list(weighed_once.states), held=list(weighed_once.held))


@pytest.fixture
def on_joint_3(all_classes: Selection) -> Selection:
    """All classes on joint 3 alone."""
    for joint in range(7):
        if joint != 2:
            state = all_classes.states[joint]
            all_classes.states[joint] = all_classes.without(joint, state, list(all_classes.classes(joint, state)))
    return all_classes


def test_only_the_class_that_spoils_a_joint_goes(all_classes: Selection) -> None:
    before = held(all_classes, 2)
    assert {"own_position", "own_velocity", "path_memory"} <= before

    def left(now: Selection) -> FloatArray:
        rise = np.full(7, -0.5)
        rise[2] = 0.2 if "path_memory" in held(now, 2) else -0.1
        return 1.0 + rise

    kept, dropped = harmless(all_classes, left, ONE, ONE)
    assert [(joint + 1, CLASSES[number].name) for joint, number in dropped] == [(3, "path_memory")]
    assert held(kept, 2) == before - {"path_memory"}


def test_a_joint_that_is_always_predicted_worse_loses_every_class_and_no_other_joint_does(
    all_classes: Selection,
) -> None:
    others = {joint: held(all_classes, joint) for joint in range(7) if joint != 2}

    def left(now: Selection) -> FloatArray:
        rise = np.full(7, -0.5)
        rise[2] = 0.5 * LEAST_CHANGE
        return 1.0 + rise

    kept, dropped = harmless(all_classes, left, ONE, ONE)
    assert not held(kept, 2)
    assert {joint for joint, _ in dropped} == {2}
    assert {joint: held(kept, joint) for joint in others} == others


def test_a_joint_without_classes_that_base_parameters_spoil_is_heard(all_classes: Selection) -> None:
    free = 6
    all_classes.states[free] = all_classes.without(
        free, all_classes.states[free], list(all_classes.classes(free, all_classes.states[free]))
    )

    def left(now: Selection) -> FloatArray:
        rise = np.full(7, -0.5)
        rise[free] = 2.0 * LEAST_CHANGE if "own_velocity" in held(now, 2) else 0.0
        return 1.0 + rise

    kept, dropped = harmless(all_classes, left, ONE, ONE)
    assert "own_velocity" not in held(kept, 2)
    joint, number = dropped[-1]
    assert (joint + 1, CLASSES[number].name) == (3, "own_velocity")


def test_of_two_classes_that_do_the_same_one_stays_and_what_does_nothing_goes(on_joint_3: Selection) -> None:
    """Asked one by one both of the two would go: each is missed only once the other is gone."""

    def left(now: Selection) -> FloatArray:
        rise = np.zeros(7)
        here = held(now, 2)
        rise[2] = -0.6 if here & {"own_position", "configuration"} else -0.1
        rise[2] -= 0.2 if "own_velocity" in here else 0.0
        return 1.0 + rise

    before = list(on_joint_3.states)
    kept = held(useful(on_joint_3, left, ONE)[0], 2)
    assert all(now is then for now, then in zip(on_joint_3.states, before, strict=True))
    assert "own_velocity" in kept
    assert len(kept) == 2
    assert kept & {"own_position", "configuration"}


def test_a_class_that_moves_base_parameters_of_another_joint_stays_where_all_together_gain(
    on_joint_3: Selection,
) -> None:
    """Its joint falls to a half; joint 7, which holds none, rises by a tenth, or to three times."""

    def kept(risen: float) -> tuple[set[str], bool]:
        def left(now: Selection) -> FloatArray:
            change = np.zeros(7)
            if "own_velocity" in held(now, 2):
                change[2], change[6] = np.log(0.5), np.log(risen)
            return np.asarray(np.exp(change))

        stays, dropped = useful(on_joint_3, left, ONE)
        return held(stays, 2), any(CLASSES[number].name == "own_velocity" for _, number in dropped)

    assert kept(1.1) == ({"own_velocity"}, False)
    assert kept(3.0) == (set(), True)


def test_losing_the_last_class_of_a_joint_is_no_gain_and_a_joint_without_one_is_held_against_the_fit(
    on_joint_3: Selection,
) -> None:
    """Joint 3 is left 0.6 Nm with classes and 1 without, where 0.7 is to be beaten and the fit leaves 1."""
    beaten = np.full(7, 0.7)

    def left(now: Selection) -> FloatArray:
        rms = ONE.copy()
        rms[2] = 0.6 if "own_velocity" in held(now, 2) else 1.0
        return rms

    assert held(useful(on_joint_3, left, beaten)[0], 2) == {"own_velocity"}
    kept, dropped = harmless(on_joint_3, left, beaten, ONE)
    assert (held(kept, 2), dropped) == (held(on_joint_3, 2), ())


def test_base_parameters_beside_classes_are_fitted_with_the_weights_of_the_fit(on_joint_3: Selection) -> None:
    """Truth: NumPy's least squares on what the classes leave. With none, the model is that of the fit."""
    problem, left = on_joint_3.rows.problem, Left.of(on_joint_3.rows)
    weight = problem.weight * np.random.default_rng(3).uniform(0.5, 2.0, (7, 1))
    for item in (on_joint_3, Selection.nominal(on_joint_3.rows, range(on_joint_3.rows.folds))):
        columns, torque = zip(*(base_of(item, joint) for joint in range(7)), strict=True)
        scale = weight * problem.noise
        stacked = np.concatenate([part * size[:, None] for part, size in zip(columns, scale, strict=True)])
        expected = np.linalg.lstsq(stacked, np.concatenate([*(scale * np.array(torque))]), rcond=None)[0]
        base = left.base_as_fitted(item, weight)
        np.testing.assert_allclose(stacked @ base, stacked @ expected, atol=1e-6 * np.abs(stacked @ expected).max())
        rows = np.array([part @ base for part in columns])
        measured = np.where(problem.weight > 0.0, (np.array(torque) - rows) * problem.noise, 0.0)
        np.testing.assert_allclose(left.of_rows(item, base)[0], measured, atol=1e-9)
