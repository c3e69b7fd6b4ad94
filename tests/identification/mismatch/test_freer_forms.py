"""The same physics off its textbook form: found where it is there, left alone where it is not.

Truth: closed forms of the measured state, added to Pinocchio's torque.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pytest

from identification.base_parameters import BaseRegressor
from identification.mismatch.effects import EFFECTS, effect_named
from identification.mismatch.effects.base import Place
from identification.mismatch.evidence import fit_parameters, with_parameters
from identification.mismatch.problem import Problem, build_problem
from identification.mismatch.reduction import build_evidence
from identification.mismatch.search.library import Library
from identification.mismatch.search.refinement import Member, estimate_of, gram_of, refine, score_of
from identification.mismatch.search.screening import group_gain
from identification.mismatch.search.trial import fitted
from identification.mismatch.settings import ALTERNATIVE, DiagnosisSettings
from identification.physical_parameters import PhysicalParameters
from identification.robots import RobotModel
from tests.identification.mismatch.plant import no_effect, on_joint, record

FloatArray = npt.NDArray[np.float64]


class State(NamedTuple):
    q: FloatArray
    dq: FloatArray
    torque: FloatArray


Law = Callable[[State], FloatArray]


def wave(angle: FloatArray, share: float) -> FloatArray:
    return np.sin(angle) + share * np.sin(2.0 * angle + 0.5)


def spring(stretch: FloatArray, hardening: float) -> FloatArray:
    return stretch + hardening * stretch**3


# Name, joint, size (norm of the coefficients but for the spring's constant), law without the freedom and with it.
FORMS: tuple[tuple[str, int, float, Law, Law], ...] = (
    (
        "position_dependent_torque", 3, 0.6,
        lambda at: 0.6 * wave(3.0 * at.q[:, 2] + 0.7, 0.0),
        lambda at: 0.6 * wave(3.0 * at.q[:, 2] + 0.7, 0.25),
    ),
    (
        "position_dependent_friction", 5, 0.4,
        lambda at: 0.4 * wave(at.q[:, 4] + 0.7, 0.0) * np.sign(at.dq[:, 4]),
        lambda at: 0.4 * wave(at.q[:, 4] + 0.7, 0.3) * np.sign(at.dq[:, 4]),
    ),
    (
        "torque_sensor_gain", 6, 0.3,
        lambda at: 0.3 * at.torque[:, 5],
        lambda at: 0.3 * at.torque[:, 5] * (1.0 + 0.4 * np.sin(at.q[:, 5] + 1.0)),
    ),
    (
        "cable_spring", 6, 1.5,
        lambda at: 1.5 * spring(at.q[:, 5] - 0.4, 0.0),
        lambda at: 1.5 * spring(at.q[:, 5] - 0.4, 0.3),
    ),
    (
        "load_dependent_friction", 4, 0.05,
        lambda at: 0.05 * np.abs(at.torque[:, 3]) * np.sign(at.dq[:, 3]),
        lambda at: 0.05 * 10.0 * np.abs(at.torque[:, 3] / 10.0) ** 1.4 * np.sign(at.dq[:, 3]),
    ),
)  # fmt: skip


def seen(
    robot: RobotModel, regressor: BaseRegressor, links: PhysicalParameters, joint: int, law: Law
) -> tuple[Problem, Library]:
    """The torque that gains and loads act on is that of the plant without its law: the search comes to it in turns."""
    plain, bent = (
        build_evidence(record(robot, links, hidden, periods=6), robot, regressor)[0]
        for hidden in (no_effect, lambda *state: on_joint(joint, law(State(*state))))
    )
    return build_problem([bent]), Library(EFFECTS, [with_parameters(bent, regressor, fit_parameters([plain]))])


def textbook(library: Library, name: str, joint: int) -> dict[str, float]:
    parameters = effect_named(name).shape_parameters(library.evidences[0].motion, Place(joint=joint))
    return {item.name: item.grid[0] if item.textbook is None else item.textbook for item in parameters}


def refined(problem: Problem, library: Library, name: str, joint: int) -> Member:
    shape = textbook(library, name, joint) | ({"order": 3.0} if name == "position_dependent_torque" else {})
    rows = library.rows(effect_named(name), Place(joint=joint), tuple(shape.items()))
    assert rows is not None
    return refine(problem, library, Member(rows))


@pytest.mark.parametrize(("name", "joint", "size", "plain", "free"), FORMS, ids=[item[0] for item in FORMS])
def test_a_freer_form_is_found_where_it_is_there_and_the_textbook_kept_where_it_is(
    iiwa14: RobotModel, iiwa14_base: BaseRegressor, table3: PhysicalParameters,
    name: str, joint: int, size: float, plain: Law, free: Law,
) -> None:  # fmt: skip
    problem, library = seen(iiwa14, iiwa14_base, table3, joint, plain)
    form = textbook(library, name, joint)
    kept = refined(problem, library, name, joint)
    held = [
        item.name
        for item in kept.effect.shape_parameters(library.evidences[0].motion, kept.place)
        if item.textbook is not None
    ]
    assert held
    assert {key: kept.shape[key] for key in held} == {key: form[key] for key in held}

    problem, library = seen(iiwa14, iiwa14_base, table3, joint, free)
    freed = refined(problem, library, name, joint)
    assert any(freed.shape[key] != form[key] for key in held)
    coefficients = estimate_of(problem, freed)[0]
    found = abs(coefficients[0]) if name == "cable_spring" else float(np.linalg.norm(coefficients))
    assert found == pytest.approx(size, rel=0.15)
    # What is left is noise: one for each row, within five deviations of a χ² of that many.
    cost = freed.rows.cost + ALTERNATIVE * (coefficients.size - 1)
    left = float(problem.residual @ problem.residual) - 2.0 * (score_of(problem, freed) + cost)
    rows = np.count_nonzero(problem.weight)
    assert left < rows + 5.0 * np.sqrt(2.0 * rows)


def test_a_freedom_costs_as_much_as_a_further_coefficient(
    iiwa14: RobotModel, iiwa14_base: BaseRegressor, table3: PhysicalParameters
) -> None:
    (evidence,) = build_evidence(record(iiwa14, table3, periods=2), iiwa14, iiwa14_base)
    library, effect, place = Library(EFFECTS, [evidence]), effect_named("stribeck_friction"), Place(joint=2)
    costs = []
    for exponent in (2.0, 1.0):
        rows = library.rows(effect, place, (("stribeck_velocity", 0.06), ("exponent", exponent)))
        assert rows is not None
        costs.append(rows.cost)
    assert costs[1] - costs[0] == pytest.approx(ALTERNATIVE)


def test_the_second_of_two_columns_costs_a_further_coefficient(
    iiwa14: RobotModel, iiwa14_base: BaseRegressor, table3: PhysicalParameters
) -> None:
    (evidence,) = build_evidence(record(iiwa14, table3, periods=2), iiwa14, iiwa14_base)
    problem, library = build_problem([evidence]), Library(EFFECTS, [evidence])
    shape = textbook(library, "position_dependent_friction", 4)
    rows = library.rows(effect_named("position_dependent_friction"), Place(joint=4), tuple(shape.items()))
    assert rows is not None
    member = Member(rows)
    gain = group_gain(*gram_of(problem, member))[0]
    assert score_of(problem, member) == pytest.approx(0.5 * gain - ALTERNATIVE)
    assert fitted(problem, [member], DiagnosisSettings()).cost == pytest.approx(ALTERNATIVE)
