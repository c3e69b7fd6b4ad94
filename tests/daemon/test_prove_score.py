"""Claims about the score of a proof: what counts as right, and what the tables of many cases say."""

from __future__ import annotations

import copy
import math
from typing import Any

import numpy as np
import pytest

from daemon.proof.score import CaseScore, score_case
from daemon.proof.table import Rate, confusion, negatives, summary, targets, visibility_for, wrong_answers


def truth(effect: str = "load_dependent_friction", joint: int | None = 2, **changes: Any) -> dict[str, Any]:
    return {
        "effect": effect,
        "family": "loadf",
        "joint": joint,
        "link": None,
        "other_joint": None,
        "visible_joints": [] if joint is None else [joint],
        "covered_by": [],
        "form": "library",
        "amplitude": {"name": "friction_per_load", "value": 0.02, "unit": "1"},
        "lambda": 2000.0,
        "partial_lambda": 2000.0,
        "acceptable": [effect],
        **changes,
    }


def label(*truths: dict[str, Any], group: str = "single", kind: str = "") -> dict[str, Any]:
    return {"group": group, "kind": kind, "motions": {"A": ["paper", 0]}, "effects": list(truths)}


def finding(effect: str = "load_dependent_friction", joint: int | None = 2, **changes: Any) -> dict[str, Any]:
    return {
        "effect": effect,
        "joint": joint,
        "link": None,
        "score": 50.0,
        "parameters": {"friction_per_load": {"value": 2.02, "std": 0.02, "unit": "%"}},
        "alternatives": [],
        "separating_experiment": "Repeat with a payload.",
        **changes,
    }


def diagnosis(*findings: dict[str, Any], **changes: Any) -> dict[str, Any]:
    return {
        "baseline": {"detected": [bool(findings)] * 7},
        "findings": list(findings),
        "not_identifiable_here": [],
        "heldout": {"rms_before_nm": [0.4, 0.5], "rms_after_nm": [0.4, 0.3], "noise_floor_nm": [0.3, 0.3]},
        **changes,
    }


def scored(case: dict[str, Any], answer: dict[str, Any] | None) -> CaseScore:
    return score_case(case, answer, 1.0)


def test_a_perfect_answer_is_named_measured_and_without_extras() -> None:
    score = scored(label(truth()), diagnosis(finding()))
    (effect,) = score.effects
    assert (effect.named, effect.in_set, effect.placed, score.extras) == (True, True, True, 0)
    assert effect.amplitude_error == pytest.approx(0.01)
    assert effect.covered is True
    assert score.removed == pytest.approx(1.0)


def test_removed_is_what_went_of_the_excess_where_the_effect_is_and_stands_out() -> None:
    def removed(**rms: list[float]) -> float | None:
        return scored(label(truth(joint=2)), diagnosis(heldout={"noise_floor_nm": [0.3, 0.3], **rms})).removed

    half = removed(rms_before_nm=[9.0, 0.5], rms_after_nm=[9.0, math.sqrt(0.17)])
    assert half == pytest.approx(0.5)  # (0.25 - 0.17) / (0.25 - 0.09), whatever joint 1 has
    assert removed(rms_before_nm=[9.0, 0.41], rms_after_nm=[9.0, 0.3]) is None
    assert score_case(label(truth()), None, 0.0, "error").removed == 0.0
    drift = truth("torque_sensor_drift", 2, amplitude=None)
    assert scored(label(drift), diagnosis()).removed is None


def test_a_parameter_in_another_unit_than_its_truth_is_no_number_to_compare() -> None:
    wrong = finding(parameters={"friction_per_load": {"value": 2.0, "std": 0.1, "unit": "Nm"}})
    with pytest.raises(ValueError, match="in Nm, its truth in 1"):
        scored(label(truth()), diagnosis(wrong))


def test_an_empty_answer_names_nothing_and_is_no_false_name() -> None:
    score = scored(label(truth()), diagnosis())
    assert not score.effects[0].in_set
    assert not score.detected
    assert score.extras == 0


@pytest.mark.parametrize("answer", [finding("stribeck_friction", 2), finding(joint=3)])
def test_a_wrong_name_or_joint_is_wrong_but_stands_for_the_effect_it_missed(answer: dict[str, Any]) -> None:
    score = scored(label(truth()), diagnosis(answer))
    assert not score.effects[0].named
    assert score.effects[0].placed == (answer["joint"] == 2)
    assert (score.extras, score.misnamed) == (1, 1)


def test_an_extra_beside_the_right_answer_is_spurious() -> None:
    score = scored(label(truth()), diagnosis(finding(), finding("torque_offset", 5, score=1.0)))
    assert score.effects[0].named
    assert (score.extras, score.misnamed) == (1, 0)


def test_a_set_that_holds_the_truth_counts_as_a_set_only() -> None:
    alternatives = [{"effect": "load_dependent_friction", "joint": 2}]
    score = scored(label(truth()), diagnosis(finding("position_dependent_friction", 2, alternatives=alternatives)))
    assert (score.effects[0].named, score.effects[0].in_set, score.extras) == (False, True, 0)


def test_one_finding_answers_one_of_two_equal_effects() -> None:
    score = scored(label(truth(), truth(joint=3), group="pair"), diagnosis(finding()))
    assert [effect.named for effect in score.effects] == [True, False]


def test_a_spring_whose_rest_torque_covers_an_offset_answers_both() -> None:
    offset = truth("torque_offset", acceptable=["torque_offset"], covered_by=["cable_spring"])
    spring = truth("cable_spring", acceptable=["cable_spring"])
    score = scored(label(offset, spring), diagnosis(finding("cable_spring")))
    assert [effect.named for effect in score.effects] == [True, True]
    assert score.extras == 0


def test_bending_and_crosstalk_are_one_torque_where_the_axes_cross() -> None:
    crosstalk = truth("joint_crosstalk", 1, family="xadj", other_joint=2, amplitude=None)
    assert scored(label(crosstalk), diagnosis(finding("bending_crosstalk", 1))).effects[0].named
    elsewhere = truth("joint_crosstalk", 2, family="xadj", other_joint=3, amplitude=None)
    assert not scored(label(elsewhere), diagnosis(finding("bending_crosstalk", 2))).effects[0].named


def test_a_force_may_sit_before_joints_that_do_not_show_it_but_not_behind_its_link() -> None:
    force = truth("external_contact", None, family="contact", link=6, visible_joints=[1, 2, 4], amplitude=None)
    for link, right in ((3, False), (4, True), (6, True), (7, False)):
        score = scored(label(force), diagnosis(finding("external_contact", None, link=link)))
        assert score.effects[0].named == right


def test_outside_effects_may_be_called_what_they_are_or_nothing() -> None:
    backlash = truth("backlash", 3, family="backlash", amplitude=None)
    bump = truth("torque_bump", 3, family="bump", amplitude=None, acceptable=[])
    assert scored(label(backlash, group="outside"), diagnosis(finding("backlash", 3))).extras == 0
    assert scored(label(bump, group="outside"), diagnosis()).extras == 0
    assert scored(label(bump, group="outside"), diagnosis(finding("torque_offset", 3))).extras == 1


def test_structural_cases_want_the_set_with_its_experiment_or_the_word_that_it_cannot_be_seen() -> None:
    crosstalk = label(
        truth("joint_crosstalk", 1, other_joint=2, amplitude=None), group="structural", kind="bend_crosstalk"
    )
    set_answer = finding("joint_crosstalk", 1, alternatives=[{"effect": "bending_crosstalk", "joint": 1}])
    assert scored(crosstalk, diagnosis(set_answer)).right
    assert not scored(crosstalk, diagnosis(finding("joint_crosstalk", 1))).right
    assert not scored(crosstalk, diagnosis({**set_answer, "separating_experiment": None})).right

    zero = label(truth("joint_zero_offset", 7, amplitude=None), group="structural", kind="zero_last")
    unseen = [{"effect": "joint_zero_offset", "joint": 7, "reason": "absorbed"}]
    assert scored(zero, diagnosis(not_identifiable_here=unseen)).right
    assert not scored(zero, diagnosis()).right
    assert not scored(zero, diagnosis(finding("joint_zero_offset", 7), not_identifiable_here=unseen)).right


def test_a_common_lag_is_a_delay_of_all_joints_and_nothing_else() -> None:
    lag = label(truth("torque_delay", None, family="delayall", amplitude=None), group="decoy", kind="common_lag")
    assert scored(lag, diagnosis(finding("torque_delay", None))).right
    assert not scored(lag, diagnosis(finding("torque_delay", 4))).right
    assert not scored(lag, diagnosis(finding("torque_delay", None), finding("torque_delay", 4))).right


def test_a_case_without_a_diagnosis_is_counted_as_failed() -> None:
    score = score_case(label(truth()), None, 0.0, "RecordingError: empty")
    assert score.failed is not None
    assert summary([score])["failed"] == 1
    nothing = score_case(label(group="negative"), None, 0.0, "RecordingError: empty")
    figures = summary([score, nothing])
    assert (figures["singles_named"], figures["singles_joint"], figures["false_names"]) == (
        Rate(0, 1),
        Rate(0, 1),
        Rate(1, 1),
    )
    assert wrong_answers([(4, score)]) == ["case 4 single  [paper]: loadf λ 2e+03 → RecordingError: empty"]


def test_rates_carry_the_upper_bound_of_clopper_and_pearson() -> None:
    assert Rate(0, 44).upper_bound_95 == pytest.approx(1.0 - 0.05 ** (1 / 44))  # closed form for no hit
    assert Rate(3, 3).upper_bound_95 == 1.0


def test_visibility_at_which_names_come_right_is_found_on_a_known_curve() -> None:
    random = np.random.default_rng(3)
    visibility = np.exp(random.uniform(np.log(3.0), np.log(1000.0), 4000))
    chance = 1.0 / (1.0 + np.exp(-4.0 * (np.log(visibility) - np.log(30.0))))
    pairs = list(zip(visibility.tolist(), (random.random(4000) < chance).tolist(), strict=True))
    assert visibility_for(pairs, 0.5) == pytest.approx(30.0, rel=0.05)
    assert visibility_for(pairs, 0.9) == pytest.approx(30.0 * math.exp(math.log(9.0) / 4.0), rel=0.08)
    assert visibility_for([(10.0, True), (20.0, True)], 0.9) is None


@pytest.mark.parametrize(("first_named", "met"), [(30.0, True), (200.0, False), (1e9, False)])
def test_the_visibility_of_names_is_judged_on_enough_singles(first_named: float, met: bool) -> None:
    scores = [
        scored(label(truth(**{"lambda": visibility})), diagnosis(*([finding()] if visibility > first_named else [])))
        for visibility in np.geomspace(5.0, 5e4, 60)
    ]
    (target,) = (item for item in targets(summary(scores)) if item.text == "λ at which 90 % are named")
    assert target.met is met


def test_a_few_lapses_at_great_visibility_do_not_move_where_names_come_right() -> None:
    random = np.random.default_rng(4)
    visibility = np.exp(random.uniform(np.log(3.0), np.log(1e5), 400))
    named = visibility > 40.0
    named[np.flatnonzero(visibility > 3000.0)[::40]] = False
    found = visibility_for(list(zip(visibility.tolist(), named.tolist(), strict=True)), 0.9)
    assert found == pytest.approx(40.0, rel=0.25)
    never = [(float(value), bool(index % 2)) for index, value in enumerate(np.sort(visibility))]
    assert visibility_for(never, 0.9) is None


def test_tables_tell_met_from_not_met_and_from_nothing_to_judge_by() -> None:
    right = scored(label(truth()), diagnosis(finding()))
    quiet = scored(label(group="negative"), diagnosis())
    loud = scored(label(group="decoy", kind="hum"), diagnosis(finding()))
    figures = summary([right, quiet, loud])
    met = {target.text: target.met for target in targets(figures)}
    assert met["singles, λ ≥ 100: family and joint right"] is True
    assert met["false names, clean and decoys"] is False
    assert met["pairs, both visible: both named"] is None
    assert met["λ at which 90 % are named"] is None
    assert negatives([quiet, loud]) == {"decoy: hum": Rate(1, 1), "negative": Rate(0, 1)}
    assert confusion([right, scored(label(truth()), diagnosis())]) == {"loadf": {"right": 1, "no name": 1}}


def test_scores_do_not_depend_on_the_order_of_findings() -> None:
    first = diagnosis(finding(), finding("torque_offset", 5, score=1.0))
    second = copy.deepcopy(first)
    second["findings"].reverse()
    assert scored(label(truth()), first) == scored(label(truth()), second)
