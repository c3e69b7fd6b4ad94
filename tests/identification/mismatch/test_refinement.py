"""Refinement of nonlinear parameters. Truth: the shapes and sizes that made the recording."""

from __future__ import annotations

import numpy as np
import pinocchio
import pytest

from identification.base_parameters import BaseRegressor
from identification.mismatch.effects import EFFECTS, effect_named
from identification.mismatch.effects.base import Place
from identification.mismatch.problem import build_problem
from identification.mismatch.reduction import build_evidence
from identification.mismatch.search.library import Library
from identification.mismatch.search.refinement import Member, estimate_of, refine, score_of
from identification.physical_parameters import PhysicalParameters
from identification.robots import RobotModel
from tests.identification.mismatch.plant import on_joint, record


def start(library: Library, name: str, place: Place, shape: dict[str, float]) -> Member:
    rows = library.rows(effect_named(name), place, tuple(shape.items()))
    assert rows is not None
    return Member(rows)


def test_a_stribeck_curve_of_another_exponent_is_found_with_its_amplitude(
    iiwa14: RobotModel, iiwa14_base: BaseRegressor, table3: PhysicalParameters
) -> None:
    def hidden(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
        speed = dq[:, 1]
        return on_joint(2, 0.4 * np.exp(-np.abs(speed) / 0.06) * np.sign(speed))

    (evidence,) = build_evidence(record(iiwa14, table3, hidden), iiwa14, iiwa14_base)
    problem, library = build_problem([evidence]), Library(EFFECTS, [evidence])
    place = Place(joint=2)
    textbook = start(library, "stribeck_friction", place, {"stribeck_velocity": 0.06, "exponent": 2.0})
    true = start(library, "stribeck_friction", place, {"stribeck_velocity": 0.06, "exponent": 1.0})
    refined = refine(problem, library, textbook)
    assert score_of(problem, refined) >= score_of(problem, true) - 0.1
    assert refined.shape["exponent"] == pytest.approx(1.0, abs=0.2)
    assert estimate_of(problem, refined)[0][0] == pytest.approx(0.4, rel=0.1)


def test_bending_crosstalk_is_found_through_the_parameters_that_no_torque_shows(
    iiwa14: RobotModel, iiwa14_base: BaseRegressor, table3: PhysicalParameters
) -> None:
    """Moments by Pinocchio from the true links; the fit behind the columns knows base parameters alone."""
    model = iiwa14.pinocchio_model.copy()
    for link in range(7):
        model.inertias[link + 1] = pinocchio.Inertia(
            float(table3.mass[link]), table3.center_of_mass[link], table3.inertia[link]
        )
    data = model.createData()

    def hidden(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
        omega = 2.0j * np.pi * np.fft.rfftfreq(len(q), 10.0 / len(q))[:, None]
        ddq = np.fft.irfft(np.fft.rfft(dq, axis=0) * omega, n=len(q), axis=0)
        moments = np.empty((len(q), 3))
        for sample, state in enumerate(zip(q, dq, ddq, strict=True)):
            pinocchio.rnea(model, data, *state)
            moments[sample] = data.f[5].angular
        return on_joint(5, 0.03 * moments[:, 0] + 0.02 * moments[:, 1])

    (evidence,) = build_evidence(record(iiwa14, table3, hidden), iiwa14, iiwa14_base)
    problem, library = build_problem([evidence]), Library(EFFECTS, [evidence])
    shape = {"hidden_moment": -1.0, "hidden_inertia": 0.0}
    refined = refine(problem, library, start(library, "bending_crosstalk", Place(joint=5), shape))
    coefficients = estimate_of(problem, refined)[0]
    np.testing.assert_allclose(coefficients, [0.03, 0.02], rtol=0.15)
    # What is left is noise: one for each row, within five deviations of a χ² of that many.
    left = float(problem.residual @ problem.residual) - 2.0 * score_of(problem, refined)
    rows = np.count_nonzero(problem.weight)
    assert left < rows + 5.0 * np.sqrt(2.0 * rows)
