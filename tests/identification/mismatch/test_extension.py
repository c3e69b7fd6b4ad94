"""Intervals: what the noise's own uncertainty adds, and what directions that the motion leaves open come to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest

from identification.mismatch.effects.base import Columns, Effect, Estimate, Parameter, Place, ShapeParameter
from identification.mismatch.effects.torque_delay import TorqueDelay
from identification.mismatch.evidence import Evidence
from identification.mismatch.motion import Motion
from identification.mismatch.problem import Problem, build_problem, off, spread
from identification.mismatch.search.extension import extend, uncertainties
from identification.mismatch.search.library import Library
from identification.mismatch.search.refinement import Member

BOUNDS = (1.0, 3.0)


class Power(Effect):
    """c times |v|^a on joint 1; `useless` has a nonlinear parameter that changes nothing."""

    name = "power"
    code = "power"
    equation = source = plausible = separating_experiment = ""
    units = ("Nm",)
    useless = False

    def places(self, motion: Motion) -> Sequence[Place]:
        del motion
        return (Place(joint=1),)

    def shape_parameters(self, motion: Motion, place: Place) -> tuple[ShapeParameter, ...]:
        del motion, place
        return (ShapeParameter("exponent", "1", (2.0,), *BOUNDS, logarithmic=False),)

    def columns(self, motion: Motion, place: Place, shape: Mapping[str, float]) -> Columns:
        del place
        speed = np.abs(motion.velocity[:, :1])
        return Columns((0,), (speed ** (2.0 if self.useless else shape["exponent"]))[..., None])

    def parameters(self, estimate: Estimate) -> tuple[Parameter, ...]:
        del estimate
        return ()

    def sentence(self, estimate: Estimate) -> str:
        del estimate
        return ""


class Textbook(Power):
    """The same, the exponent 2 being what books say."""

    def shape_parameters(self, motion: Motion, place: Place) -> tuple[ShapeParameter, ...]:
        return tuple(replace(item, textbook=2.0) for item in super().shape_parameters(motion, place))


class Useless(Power):
    """The same with the exponent fixed at 2."""

    useless = True


def member_of(effect: Effect, evidence: Evidence) -> tuple[Library, Member]:
    library = Library((effect,), (evidence,))
    rows = library.rows(effect, Place(joint=1), (("exponent", 2.0),))
    assert rows is not None
    return library, Member(rows)


@pytest.fixture(scope="module")
def problem(clean_evidence: Evidence) -> Problem:
    """As if the noise were known exactly."""
    nominal = build_problem([clean_evidence])
    return replace(nominal, freedom=np.full_like(nominal.freedom, 1e9))


def test_a_coefficient_shares_what_the_data_say_with_the_exponent_beside_it(
    clean_evidence: Evidence, problem: Problem
) -> None:
    """Against the inverse of the full information matrix, with the derivative |v|^a ln|v| in closed form."""
    library, member = member_of(Power(), clean_evidence)
    extension = replace(extend(problem, [member]), coefficients=(np.array([0.7]),))
    (found,) = uncertainties(problem, extension, problem.residual, library, coloured=False)
    speed = np.abs(clean_evidence.motion.velocity[:, :1])
    slope = 0.7 * speed**2 * np.log(np.maximum(speed, 1e-300))
    rows = np.stack([clean_evidence.project(values) for values in (speed**2, slope)], axis=2).transpose(1, 0, 2)
    tangents = off(problem.basis, spread(problem, [0], rows))
    information = tangents.T @ tangents + np.diag([0.0, 12.0 / (BOUNDS[1] - BOUNDS[0]) ** 2])
    expected = np.sqrt(np.diag(np.linalg.inv(information)))
    assert np.sqrt(found.covariance[0, 0]) == pytest.approx(expected[0], rel=1e-2)
    assert found.shape_std["exponent"] == pytest.approx(expected[1], rel=1e-2)


@pytest.mark.parametrize("coloured", [False, True])
def test_what_the_data_say_nothing_about_is_as_wide_as_its_bounds(
    clean_evidence: Evidence, problem: Problem, coloured: bool
) -> None:
    """Beside coloured noise it had no deviation at all: not a number."""
    library, member = member_of(Useless(), clean_evidence)
    (found,) = uncertainties(problem, extend(problem, [member]), problem.residual, library, coloured=coloured)
    assert found.shape_std["exponent"] == pytest.approx((BOUNDS[1] - BOUNDS[0]) / np.sqrt(12.0))
    assert found.covariance[0, 0] > 0.0


def test_noise_known_from_few_differences_widens_the_interval_as_students_t_does(
    clean_evidence: Evidence, problem: Problem
) -> None:
    library, member = member_of(Useless(), clean_evidence)
    extension = extend(problem, [member])
    (known,) = uncertainties(problem, extension, problem.residual, library, coloured=False)
    guessed = replace(problem, freedom=np.full_like(problem.freedom, 16.0))
    (wider,) = uncertainties(guessed, extension, problem.residual, library, coloured=False)
    assert wider.covariance[0, 0] / known.covariance[0, 0] == pytest.approx(16.0 / 14.0)


def test_a_nonlinear_parameter_that_was_left_at_the_textbooks_value_widens_nothing(
    clean_evidence: Evidence, problem: Problem
) -> None:
    found = []
    for effect in (Power(), Textbook()):
        library, member = member_of(effect, clean_evidence)
        extension = replace(extend(problem, [member]), coefficients=(np.array([0.7]),))
        found.append(uncertainties(problem, extension, problem.residual, library, coloured=False)[0])
    estimated, given = found
    column = off(problem.basis, spread(problem, member.rows.joints, member.rows.rows))
    assert given.covariance[0, 0] == pytest.approx(1.0 / float((column**2).sum()), rel=1e-6)
    assert given.shape_std == {}
    assert estimated.covariance[0, 0] > 1.5 * given.covariance[0, 0]


@pytest.mark.parametrize("delay", [0.002, 0.005])
def test_a_short_delay_is_as_sure_as_if_its_share_were_known(
    clean_evidence: Evidence, problem: Problem, delay: float
) -> None:
    """Share c and delay d trade, and what is stated is c d. Truth: the Cramér–Rao bound of d alone with c = 1, by the
    slope of its torque. Without what the two have in common the interval was seven to seventeen times as wide.
    """
    effect, place = TorqueDelay(), Place(joint=2)
    library = Library((effect,), (clean_evidence,))
    here, later = (library.rows(effect, place, (("delay", d), ("lag", 0.0))) for d in (delay, 1.001 * delay))
    assert here is not None
    assert later is not None
    member = Member(here)
    extension = replace(extend(problem, [member]), coefficients=(np.ones(1),))
    (found,) = uncertainties(problem, extension, problem.residual, library, coloured=False)
    slope = off(problem.basis, spread(problem, here.joints, later.rows - here.rows))[:, 0] / (1e-3 * delay)
    stated = effect.parameters(found.estimate(member, np.ones(1)))[0].std
    assert stated == pytest.approx(1e3 / np.linalg.norm(slope), rel=0.1)
