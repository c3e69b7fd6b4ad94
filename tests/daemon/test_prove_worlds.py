"""Claims about the proof's other worlds: what counts as a right class, what the real background's own share is."""

from __future__ import annotations

from typing import Any

import pytest
from typer.testing import CliRunner

import daemon.cli.prove  # noqa: F401 - registers the command
from daemon.cli.app import app
from daemon.proof.classes import class_answer, excess_removed
from daemon.proof.page import aims_of, figures_of, proof_tables
from daemon.proof.prove import Source
from daemon.proof.score import CaseScore, score_case

ALIEN = {
    "effect": "alien", "family": "gms", "joint": 4, "link": None, "other_joint": None, "visible_joints": [4],
    "covered_by": [], "form": "library", "amplitude": None, "lambda": 400.0, "partial_lambda": 400.0,
    "acceptable": ["presliding_hysteresis"], "classes": ["path_memory", "own_velocity"],
}  # fmt: skip


def label(*truths: dict[str, Any], group: str = "alien", recording: str | None = None) -> dict[str, Any]:
    return {
        "group": group, "kind": "", "motions": {"A": ["paper", 0]}, "effects": list(truths), "recording": recording,
    }  # fmt: skip


def claim(name: str, joint: int, nats: float = 20.0, *alternatives: str) -> dict[str, Any]:
    return {"class": name, "joint": joint, "significance": nats, "alternatives": list(alternatives)}


def finding(effect: str, joint: int) -> dict[str, Any]:
    return {"effect": effect, "joint": joint, "link": None, "score": 50.0, "parameters": {}, "alternatives": []}


def diagnosis(*findings: dict[str, Any], **changes: Any) -> dict[str, Any]:
    return {
        "verdict": "unexplained",
        "baseline": {"detected": [True] * 7},
        "findings": list(findings),
        "heldout": {"rms_before_nm": [0.5] * 7, "rms_after_nm": [0.5] * 7, "noise_floor_nm": [0.3] * 7},
        **changes,
    }


def scored(case: dict[str, Any], answer: dict[str, Any] | None, bare: dict[str, Any] | None = None) -> CaseScore:
    return score_case(case, answer, 1.0, None if answer else "no diagnosis", bare)


@pytest.mark.parametrize(
    ("claims", "right"),
    [
        ([claim("path_memory", 4)], True),
        ([claim("own_velocity", 4)], True),
        ([claim("own_position", 4, 20.0, "own_velocity")], True),
        ([claim("own_position", 4)], False),
        ([claim("path_memory", 3)], False),
        ([claim("own_position", 4, 30.0), claim("path_memory", 4, 20.0)], False),
        ([claim("own_position", 4, 10.0), claim("path_memory", 4, 20.0)], True),
        ([], False),
    ],
)
def test_the_strongest_claim_has_to_be_on_the_joint_and_of_a_class_or_leave_one_open(
    claims: list[dict[str, Any]], right: bool
) -> None:
    assert class_answer([ALIEN], {"classes": claims}, None).right is right


def test_where_nothing_is_hidden_no_class_is_the_right_one() -> None:
    assert class_answer([], {"classes": []}, None).right is True
    answer = class_answer([], {"classes": [claim("own_load", 2)]}, None)
    assert (answer.right, answer.claims, answer.elsewhere) == (False, ("own_load J2",), 1)


def test_a_diagnosis_without_classes_is_not_judged_by_them_and_a_missing_one_is_wrong() -> None:
    assert class_answer([ALIEN], {}, None).right is None
    assert class_answer([ALIEN], None, None).right is False


def test_what_the_bare_recording_shows_as_much_of_is_no_answer() -> None:
    bare = {"classes": [claim("path_memory", 4, 50.0), claim("own_load", 2, 90.0)]}
    same = {"classes": [claim("path_memory", 4, 50.0), claim("own_load", 2, 90.0)]}
    more = {"classes": [claim("path_memory", 4, 70.0), claim("own_load", 2, 90.0)]}
    assert class_answer([ALIEN], same, bare).right is False
    assert class_answer([ALIEN], more, bare).right is True
    assert class_answer([ALIEN], more, bare).elsewhere == 0


def test_by_share_a_claim_counts_by_what_it_takes_of_its_joints_held_out_error() -> None:
    """The class of joint 4 has fewer nats, and takes half of an error of which the other one takes a hundredth."""

    def taking(gain: float, name: str, joint: int, nats: float) -> dict[str, Any]:
        return claim(name, joint, nats) | {"heldout_gain_nm": [gain] * 7}

    other, hidden = taking(0.01, "own_load", 1, 50.0), taking(1.0, "path_memory", 4, 20.0)
    answer = class_answer(
        [ALIEN], {"classes": [other, hidden], "class_model": {"heldout_after_nm": [1.0] * 7}}, {"classes": []}
    )
    assert (answer.right, answer.right_by_share) == (False, True)
    assert class_answer([ALIEN], {"classes": [hidden]}, None).right_by_share is False


def test_a_name_of_the_bare_recording_is_not_wrong_where_it_is_given_again() -> None:
    bare = diagnosis(finding("joint_coupling", 6))
    again = scored(label(ALIEN), diagnosis(finding("joint_coupling", 6)), bare)
    assert again.extras == 0
    elsewhere = scored(label(ALIEN), diagnosis(finding("joint_coupling", 5)), bare)
    assert elsewhere.extras == 1


def test_an_alien_effect_may_have_a_name_that_describes_it_and_no_other() -> None:
    right = scored(label(ALIEN), diagnosis(finding("presliding_hysteresis", 4)))
    wrong = scored(label(ALIEN), diagnosis(finding("stribeck_friction", 4)))
    assert (right.effects[0].named, right.extras) == (True, 0)
    assert (wrong.effects[0].named, wrong.extras) == (False, 1)


def test_what_was_taken_is_counted_from_the_noise_or_from_the_bare_recording() -> None:
    assert excess_removed([0.5], [0.4], [0.3]) == pytest.approx(1.0 - 0.07 / 0.16)
    assert excess_removed([0.4], [0.3], [0.3]) is None  # an excess below the floor
    half = diagnosis(class_model={"heldout_before_nm": [0.5] * 7, "heldout_after_nm": [0.4] * 7})
    assert scored(label(ALIEN), half).removed_by_classes == pytest.approx(1.0 - 0.07 / 0.16)
    bare = diagnosis(heldout={"rms_before_nm": [0.35] * 7})
    taken = 1.0 - (0.4**2 - 0.35**2) / (0.5**2 - 0.35**2)
    assert scored(label(ALIEN), half, bare).removed_by_classes == pytest.approx(taken)
    assert scored(label(ALIEN), diagnosis()).removed_by_classes is None
    assert scored(label(ALIEN), None).removed_by_classes == 0.0


def test_the_figures_of_a_world_count_wrong_names_and_right_classes_apart() -> None:
    weak = {**ALIEN, "lambda": 60.0}
    scores = [
        scored(label(ALIEN), diagnosis(classes=[claim("path_memory", 4)])),
        scored(
            label(ALIEN), diagnosis(finding("cable_spring", 4), classes=[claim("own_load", 4)], verdict="explained")
        ),
        scored(label(weak), diagnosis(classes=[])),
        scored(label(group="bare", recording="tx40"), diagnosis(finding("joint_coupling", 6))),
    ]
    figures = figures_of("alien", scores)
    assert (figures["wrong_names"].hits, figures["wrong_names"].count) == (1, 3)
    assert figures["wrong_names_called_explained"].hits == 1
    assert (figures["strong_class_right"].hits, figures["strong_class_right"].count) == (1, 2)
    met = {aim.text: aim.met for aim in aims_of("alien", figures)}
    assert met["wrong names"] is False
    assert met["right joint and class, λ ≥ 100"] is False
    assert met["held-out excess energy taken by classes, median"] is None
    for world in ("alien", "hybrid"):
        tables = proof_tables(world, scores, figures_of(world, scores))
        assert tables[0].rows[0][:3] == ("gms", "3", "1")


def test_a_source_says_world_seal_and_folder_to_the_process_that_draws() -> None:
    assert Source(7, "hybrid", True).arguments[2:] == ("--serve", "--seed", "7", "--world", "hybrid", "--sealed")


@pytest.mark.parametrize("arguments", [["--world", "martian"], ["--sealed"]])
def test_a_world_that_there_is_not_and_a_seal_on_what_everybody_knows_are_refused(arguments: list[str]) -> None:
    result = CliRunner().invoke(app, ["prove", *arguments])
    assert result.exit_code == 2
