"""Torque that repeats many times per turn of a joint, at whatever order. Truth: waves written onto the plant."""

from __future__ import annotations

import numpy as np
import pytest

from identification.mismatch.diagnosis import diagnose
from identification.mismatch.evidence import Evidence
from identification.mismatch.problem import build_problem
from identification.mismatch.search.waves import waves_left
from identification.physical_parameters import PhysicalParameters
from identification.robots import RobotModel
from tests.identification.mismatch.plant import Hidden, on_joint, record


def wave(order: float) -> Hidden:
    """A torque of joint 1 that repeats over its position."""

    def hidden(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
        del dq, torque
        return on_joint(1, 0.04 * np.sin(order * q[:, 0] + 0.7))

    return hidden


def rubbing_teeth(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """Friction of joint 1 that changes with each of 37 teeth."""
    del torque
    return on_joint(1, 0.05 * np.sin(37.0 * q[:, 0]) * np.tanh(dq[:, 0] / 0.003))


def loaded_teeth(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """40 teeth of joint 1 that bend under their load, which turns round."""
    del dq
    return on_joint(1, 0.06 * np.sin(40.0 * q[:, 0]) * torque[:, 0] / np.abs(torque[:, 0]).max())


def test_a_ripple_of_an_order_that_no_usual_gear_has_is_named(iiwa14: RobotModel, table3: PhysicalParameters) -> None:
    """It was "broadband": orders between the usual ones were asked near the iiwa's own alone."""
    hidden = wave(103.0)
    found = diagnose(
        [record(iiwa14, table3, hidden, motion=9)], iiwa14, heldout=[record(iiwa14, table3, hidden, periods=4, seed=2)]
    )
    assert [(item.effect, item.place.joint) for item in found.findings] == [("torque_ripple", 1)]
    assert found.findings[0].shape["order"] == pytest.approx(103.0, abs=0.1)
    assert found.verdict == "explained"


@pytest.mark.parametrize(
    ("hidden", "name"),
    [
        (wave(31.0), "own_position"),
        (rubbing_teeth, "own_position_by_direction"),
        (loaded_teeth, "own_load_by_position"),
    ],
)
def test_teeth_of_any_number_have_their_class_first(
    iiwa14: RobotModel, table3: PhysicalParameters, hidden: Hidden, name: str
) -> None:
    """The first was a function of the load, the second "broadband", the third a function of the configuration."""
    found = diagnose(
        [record(iiwa14, table3, hidden, motion=9)], iiwa14, heldout=[record(iiwa14, table3, hidden, periods=4, seed=2)]
    )
    assert (found.classes[0].name, found.classes[0].joint) == (name, 1)
    assert {item.joint for item in found.classes} == {1}
    assert not found.findings


def test_the_orders_that_are_asked_hold_those_of_what_is_left(clean_evidence: Evidence) -> None:
    place = clean_evidence.motion.position[:, 3]
    wave = np.zeros_like(clean_evidence.motion.position)
    wave[:, 3] = 0.3 * np.sin(23.0 * place) + 0.3 * np.sin(110.0 * place + 1.0)
    problem = build_problem([clean_evidence], [clean_evidence.torque + clean_evidence.project(wave)])
    orders = np.array(waves_left(problem, [clean_evidence])[4])
    assert np.abs(orders - 23.0).min() < 0.5
    assert np.abs(orders - 110.0).min() < 0.5
    assert np.floor(np.log2(orders * np.ptp(place) / (2.0 * np.pi))).tolist() == list(range(orders.size))
