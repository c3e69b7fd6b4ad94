"""Claims about the choice of a motion: free functions in a name's place, lengths, what is safe.

Truth: evidences by the full covariance of the rows, arithmetic, a motion's own kind.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from identification.excitation import iiwa_limits
from identification.investigation.assessment import _alive
from identification.investigation.choice import ALIKE, HANDED_ON, Chooser, lengths
from identification.investigation.columns import Form, Sums
from identification.investigation.experiments import PERIOD_S, Experiment, Room
from identification.investigation.forecast import APART, STANDS_OUT, Forecast, forecast
from identification.investigation.free_functions import lead
from identification.investigation.hypotheses import NOTHING, Hypothesis
from identification.investigation.separation import Layout, separations
from identification.mismatch.effects.base import Place
from identification.mismatch.settings import PRIOR_COST
from identification.mismatch.unknown.classes import CLASSES, Basis

ROOM = Room(iiwa_limits("iiwa14"), np.zeros(7))
POSITION = next(number for number, kind in enumerate(CLASSES) if kind.name == "own_position")


def log_evidence(columns: np.ndarray, variance: float, torque: np.ndarray) -> float:
    """Log p(torque) under unit noise and weights of this variance."""
    covariance = np.eye(len(torque)) + variance * columns @ columns.T
    return float(-0.5 * torque @ np.linalg.solve(covariance, torque) - 0.5 * np.linalg.slogdet(covariance)[1])


def test_a_name_leads_a_free_function_by_the_ratio_of_their_evidences() -> None:
    """Truth: the torque of the name without noise; the name's own size is known, the function's variance the best."""
    random = np.random.default_rng(3)
    functions = random.normal(size=(120, 8))
    torque = functions @ random.normal(size=8) * 0.3 + 0.2 * random.normal(size=120)
    best = max(log_evidence(functions, variance, torque) for variance in np.geomspace(1e-4, 1e3, 400))
    found = lead(float(torque @ torque), functions.T @ functions, functions.T @ torque)
    assert found == pytest.approx(-best, abs=0.3)
    assert lead(4.0, np.zeros((2, 2)), np.zeros(2)) == 2.0


class Beside:
    """One joint with one class of eight columns, which no hypothesis holds."""

    bases = ((Basis(POSITION, 0, 0, np.zeros(4), 1.0),),)

    def deviations(self, variances: Any) -> tuple[np.ndarray, ...]:
        return tuple(np.repeat(np.sqrt(own), 8) for own in variances)


def hypothesis(effect: str, log_odds: float, probability: float, beside: float = 0.0) -> Hypothesis:
    form = Form.of(effect, Place(1), {})
    return Hypothesis(
        effect, Place(1), (form,), form, np.array([0.5]), np.array([[1e-12]]), log_odds, probability,
        (np.array([beside]),),
    )  # fmt: skip


@pytest.mark.parametrize("like", [0.0, 1.0])
def test_a_name_that_a_free_function_can_stand_for_is_told_from_nothing_by_less(like: float) -> None:
    """Truth: base parameters and functions written out over the rows."""
    random = np.random.default_rng(4)
    base, functions = random.normal(size=(300, 3)), random.normal(size=(300, 8))
    column = (1.0 - like) * random.normal(size=(300, 1)) + like * functions @ random.normal(size=(8, 1)) / np.sqrt(8.0)
    both = np.hstack([base, column])
    sums = Sums(both.T @ both, 3, (functions.T @ np.hstack([functions, both]),))
    truth = hypothesis("torque_offset", 5.0, 0.9)
    nothing = replace(NOTHING, beside=(np.zeros(1),))
    layout = Layout.of([truth])
    found = separations(sums, layout, [truth, nothing], Beside())[0, 1]  # type: ignore[arg-type]
    off = np.eye(300) - base @ np.linalg.pinv(base)
    torque, left = off @ column[:, 0] * 0.5, off @ functions
    whole = float(torque @ torque)
    best = max(log_evidence(left, variance, torque) for variance in np.geomspace(1e-6, 1e3, 600))
    expected = min(whole, 2.0 * (-best + PRIOR_COST))
    assert found == pytest.approx(expected, abs=1.0)
    assert (found < 0.5 * whole) == bool(like)


def test_a_name_is_earned_by_more_over_a_name_than_over_a_class() -> None:
    """Truth: what the diagnosis asks, 10 nats over another name and 3 over a class with or without a further name."""
    sure = np.full((2, 2), 1e6)
    for rival, margin in (
        (hypothesis("joint_elasticity", 0.0, 0.1), APART),
        (replace(NOTHING, probability=0.1, beside=(np.array([0.2]),)), STANDS_OUT),
        (hypothesis("joint_elasticity", 0.0, 0.1, beside=0.2), STANDS_OUT),
    ):
        for above, told in ((0.5, 1.0), (-0.5, 0.0)):
            alive = (hypothesis("cable_spring", margin + above, 0.9), rival)
            assert forecast(alive, sure, sure).named_now == pytest.approx(told if rival.effect is None else
                                                                         0.9 * told, abs=0.11)  # fmt: skip


def test_forms_that_an_error_outweighs_stay_alive_for_the_choice_of_a_motion_and_no_others() -> None:
    """Without any the first motion drawn was driven. Truth: the odds that are given."""
    nothing = replace(NOTHING, beside=(np.array([0.2]),))
    far = [hypothesis("cable_spring", -1500.0, 0.0), hypothesis("torque_offset", -1505.0, 0.0)]
    alive = _alive([far[1], nothing, far[0], hypothesis("joint_elasticity", -1520.0, 0.0)], ())
    assert [item.effect for item in alive] == [None, "cable_spring", "torque_offset"]
    assert [item.probability for item in alive] == [1.0, 0.0, 0.0]
    near = hypothesis("joint_elasticity", -3.0, 0.0)
    assert [item.effect for item in _alive([*far, nothing, near], ())] == [None, "joint_elasticity"]
    assert [item.effect for item in _alive([*far, nothing], {("torque_offset", 1)})] == [None, "torque_offset"]


def test_beside_an_error_that_outweighs_every_form_the_motion_that_tells_most_of_a_form_is_worth_more() -> None:
    """Truth: 1500 nats are odds that no floating-point probability holds; what a motion adds is the same."""
    alive = (
        replace(NOTHING, probability=1.0, beside=(np.array([0.2]),)),
        hypothesis("cable_spring", -1500.0, 0.0),
        hypothesis("torque_offset", -1505.0, 0.0),
    )
    chooser: Any = SimpleNamespace(assessment=SimpleNamespace(alive=alive))
    values = [
        Chooser._value(chooser, Forecast(0.0, 0.0, None, gain * (1.0 - np.eye(3)))) for gain in (1.0, 10.0, 100.0)
    ]
    assert values[0] < values[1] < values[2]


def test_a_motion_that_no_form_needs_is_not_worth_its_time() -> None:
    few = np.zeros((1, 1))
    assert Forecast(0.5, 0.5, None, few, forms=0.5, named=0.9, named_now=0.2).worth_driving
    assert not Forecast(0.5, 0.5, None, few, forms=0.001, named=0.9, named_now=0.2).worth_driving
    assert not Forecast(0.5, 0.5, None, few, forms=0.5, named=0.9, named_now=0.89).worth_driving


@pytest.mark.parametrize("left", [0.0, 39.0, 40.0, 55.0, 70.0, 80.0, 120.0, 130.0, 190.0, 200.0, 640.0])
def test_no_length_leaves_time_that_nothing_can_be_done_with(left: float) -> None:
    found = lengths(left)
    assert bool(found) == (left >= 40.0)
    for count in found:
        rest = left - count * PERIOD_S
        assert rest >= 0.0
        assert count >= 4
        assert rest < PERIOD_S or rest >= 40.0


def scripted_chooser() -> Any:
    """A choice whose forecasts grow with the first joint's excursion."""

    def foretell(experiment: Experiment, periods: int) -> Forecast:
        return Forecast(min(1.0, 0.01 * periods * float(np.ptp(experiment.table[:, 0]))), 0.0, None, np.zeros((1, 1)))

    def thorough(experiment: Experiment, periods: int) -> Forecast:
        found = foretell(experiment, periods)
        return replace(found, probability=0.5 * found.probability)

    chooser = SimpleNamespace(
        foretell=foretell, separated=np.zeros((1, 1)), assessment=SimpleNamespace(alive=(NOTHING,)),
        thorough=SimpleNamespace(foretell=thorough, _enough=lambda _, possible: possible[0]),
        _joints=lambda: [0], _value=lambda found: found.probability,
    )  # fmt: skip
    chooser._promised = lambda motions, periods: Chooser._promised(chooser, motions, periods)
    return chooser


def test_what_is_promised_is_asked_of_every_shape_of_the_rivals() -> None:
    """The search asks three shapes of each: a rival whose best one is another is told apart less than that says."""
    place, grid = Place(1), np.geomspace(0.01, 1.0, 9)
    forms = tuple(Form.of("stribeck_friction", place, {"stribeck_velocity": float(point)}) for point in grid)
    rival = replace(NOTHING, effect="stribeck_friction", place=place, forms=forms, best=forms[0])
    assert set(Layout.of([rival], None).forms) == set(forms)
    assert len(Layout.of([rival]).forms) == 3
    design = Chooser.choose(scripted_chooser(), np.random.default_rng(1), ROOM, 120.0)
    for choice in design.choices:
        swing = float(np.ptp(choice.experiment.table[:, 0]))
        assert choice.forecast.probability == 0.5 * min(1.0, 0.01 * choice.periods * swing)


def test_periods_are_enough_for_the_motion_that_is_driven() -> None:
    """Every shape of the rivals may put another motion first than the search did."""
    chooser, asked = scripted_chooser(), []

    def small_is_better(experiment: Experiment, periods: int) -> Forecast:
        found = chooser.foretell(experiment, periods)
        return replace(found, probability=1.0 - found.probability)

    def enough(experiment: Experiment, possible: Sequence[int]) -> int:
        asked.append(experiment)
        return possible[-1]

    chooser.thorough = SimpleNamespace(foretell=small_is_better, _enough=enough)
    first, *others = Chooser.choose(chooser, np.random.default_rng(1), ROOM, 120.0).choices
    assert asked == [first.experiment]
    assert {choice.periods for choice in (first, *others)} == {lengths(120.0)[-1]}


def test_what_is_handed_to_the_preflight_is_not_all_alike() -> None:
    """Where the best kind of motion is not safe here, another one may be."""
    design = Chooser.choose(scripted_chooser(), np.random.default_rng(1), ROOM, 120.0)
    kinds = [(choice.experiment.kind, choice.experiment.joint) for choice in design.choices]
    assert len(kinds) == HANDED_ON
    assert max(map(kinds.count, kinds)) <= ALIKE
    chances = [choice.forecast.probability for choice in design.choices]
    assert chances == sorted(chances, reverse=True)
