"""What another form of an effect may leave, and what it cannot. Truth: forms written here that the library lacks."""

from __future__ import annotations

import numpy as np
import pytest

from identification.base_parameters import BaseRegressor
from identification.estimators.physical import PhysicalParameters
from identification.mismatch.effects import effect_named
from identification.mismatch.effects.base import Effect, Place
from identification.mismatch.evidence import Evidence, build_evidence
from identification.mismatch.form_directions import form_directions
from identification.mismatch.library import Library
from identification.mismatch.problem import build_problem, extended, off, spread
from identification.mismatch.refinement import Member, refine
from identification.robots import RobotModel
from tests.identification.mismatch.plant import on_joint, record

JOINT = 3


def fade(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """Stribeck friction that fades with the inverse of the speed's cube."""
    return on_joint(JOINT, np.sign(dq[:, 2]) / (1.0 + (np.abs(dq[:, 2]) / 0.05) ** 3))


def stiffening(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """A spring whose force grows with the cube of the angle."""
    return on_joint(JOINT, q[:, 2] + 0.3 * q[:, 2] ** 3)


def share_along_forms(evidence: Evidence, effect: Effect, values: np.ndarray) -> float:
    """Share of a torque, off the base parameters and the effect as it is fitted, along the effect's other forms."""
    problem = build_problem([evidence])
    library = Library((effect,), [evidence])
    place = Place(joint=JOINT)
    rows = library.rows(effect, place, library.grid(effect, place)[0])
    assert rows is not None
    member = refine(problem, library, Member(rows, tuple(range(rows.coefficients))))
    beside = extended(problem, off(problem.basis, spread(problem, member.rows.joints, member.used_rows())))
    directions = form_directions(library, member, np.ones(member.rows.coefficients))
    wider = extended(beside, off(beside.basis, spread(beside, member.rows.joints, directions)))
    clean = off(beside.basis, (evidence.project(values).T * problem.weight).ravel())
    return 1.0 - float(np.sum(off(wider.basis, clean) ** 2) / np.sum(clean**2))


@pytest.mark.parametrize(("hidden", "name"), [(fade, "stribeck_friction"), (stiffening, "cable_spring")])
def test_what_another_form_leaves_lies_along_its_directions_and_crosstalk_does_not(
    iiwa14: RobotModel, iiwa14_base: BaseRegressor, table3: PhysicalParameters, hidden, name: str
) -> None:
    (evidence,) = build_evidence(record(iiwa14, table3, hidden), iiwa14, iiwa14_base)
    motion, effect = evidence.motion, effect_named(name)
    own = hidden(motion.position, motion.velocity, motion.torque)
    assert share_along_forms(evidence, effect, own) > 0.9
    assert share_along_forms(evidence, effect, on_joint(JOINT, motion.torque[:, 3])) < 0.5


def test_a_constant_has_no_other_form(clean_evidence: Evidence) -> None:
    library = Library((effect_named("torque_offset"),), [clean_evidence])
    rows = library.rows(library.effects[0], Place(joint=JOINT), ())
    assert rows is not None
    assert form_directions(library, Member(rows, (0,)), np.ones(1)).shape[2] == 0
