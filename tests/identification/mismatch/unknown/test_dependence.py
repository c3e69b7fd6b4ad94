"""Which class stands for a torque of known form. Truth: closed forms of the literature, written onto the plant here."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from identification.base_parameters import BaseRegressor
from identification.estimators.physical import PhysicalParameters
from identification.mismatch.prepared import prepare
from identification.mismatch.settings import DiagnosisSettings
from identification.mismatch.unknown.classes import CLASSES
from identification.mismatch.unknown.dependence import find_dependence
from identification.mismatch.unknown.selection import Held
from identification.robots import RobotModel
from tests.identification.mismatch.plant import on_joint, record

JOINT = 5
Form = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def damped_stop(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """Contact whose damping grows with its depth (Hunt and Crossley 1975)."""
    del torque
    depth = np.maximum(q[:, JOINT - 1] - 0.2, 0.0)
    return np.asarray(-3.0 * depth**1.5 * (1.0 + 0.5 * dq[:, JOINT - 1]))


def rubbing_arc(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """Dry friction where a brake disc is bent: within a tenth of a radian."""
    del torque
    place = np.exp(-(((q[:, JOINT - 1] - 0.1) / 0.1) ** 2))
    return np.asarray(0.15 * place * np.tanh(dq[:, JOINT - 1] / 0.02))


def loaded_teeth(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """Load that a gear passes on unevenly over its angle."""
    del dq
    return np.asarray(0.3 * torque[:, JOINT - 1] * np.sin(12.0 * q[:, JOINT - 1]))


def own_and_next(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """A smooth function of the joint's state and the next joint's position."""
    del torque
    return np.asarray(0.3 * np.sin(1.5 * q[:, JOINT - 1] + dq[:, JOINT - 1] + 1.2 * q[:, JOINT]))


@pytest.fixture(scope="module")
def held(iiwa14: RobotModel, iiwa14_base: BaseRegressor, table3: PhysicalParameters) -> Callable[[Form], list[Held]]:
    def of(form: Form) -> list[Held]:
        recordings = (
            record(iiwa14, table3, lambda *state: on_joint(JOINT, form(*state)), motion=9),
            record(iiwa14, table3, lambda *state: on_joint(JOINT, form(*state)), periods=4, motion=3, seed=2),
        )
        first, second = (prepare([item], iiwa14, iiwa14_base, DiagnosisSettings(), None) for item in recordings)
        return sorted(find_dependence(first, second).together.held, key=lambda item: -item.loss)

    return of


@pytest.mark.parametrize(
    ("form", "names"),
    [
        (damped_stop, ("own_position", "own_position_by_direction")),
        (rubbing_arc, ("own_position_by_direction",)),
        (loaded_teeth, ("own_load_by_position",)),
    ],
)
def test_the_class_of_a_torque_that_depends_on_two_things_stands_first(
    held: Callable[[Form], list[Held]], form: Form, names: tuple[str, ...]
) -> None:
    first = held(form)[0]
    assert CLASSES[first.number].name in names
    assert first.joint == JOINT - 1
    assert first.loss > 8.0


def test_a_smooth_error_of_one_joint_alone_is_no_background(held: Callable[[Form], list[Held]]) -> None:
    found = held(own_and_next)
    assert {item.joint for item in found if item.loss > 8.0} == {JOINT - 1}
    assert not any(CLASSES[number].background for item in found for number in (item.number, *item.alternatives))
