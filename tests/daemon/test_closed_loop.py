"""Claims about how the proof of the closed loop is summed up. Truth: counted by hand."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import msgspec
import pytest

from daemon.investigate.account import Account, Alive, Motion, Named, Recorded, Step, Told
from daemon.proof import closed_loop
from daemon.proof.closed_loop import ARMS, Answer, LoopCase, answer_of, forecasts_of, reliability
from daemon.proof.closed_loop_table import loop_rows, loop_summary, reliability_rows
from identification.investigation.actions import Action

LABEL: dict[str, Any] = {
    "group": "confusable",
    "effects": [{"effect": "cable_spring", "joint": 2, "acceptable": ["cable_spring"]}],
}


def step(*findings: Named, leader: str | None = None, stands_out: bool = False, recordings: int = 3) -> Step:
    alive = (Alive(name="", effect=leader, joint=2 if leader else None, probability=0.9, log_odds=9.0),)
    return Step(
        recordings=recordings, verdict="explained", answer="", alive=alive, questions=(), findings=findings,
        stands_out=stands_out, remaining="",
    )  # fmt: skip


ACCOUNT = Account(robot="iiwa14", seed=1, budget_s=120.0)
SPRING = Named(effect="cable_spring", joint=2)
OPEN = Named(effect="torque_offset", joint=2, alternatives=("cable_spring",))


@pytest.mark.parametrize(
    ("known", "named", "leader_right", "wrong"),
    [
        (step(SPRING), True, True, ()),
        (step(Named(effect="cable_spring", joint=3)), False, False, ("cable_spring at joint 3",)),
        (step(OPEN, leader="cable_spring", stands_out=True), False, True, ()),
        (step(OPEN, leader="cable_spring"), False, False, ()),
        (step(SPRING, Named(effect="torque_offset", joint=2)), False, True, ("torque_offset at joint 2",)),
    ],
)
def test_an_answer_is_judged_by_the_label(known: Step, named: bool, leader_right: bool, wrong: tuple[str, ...]) -> None:
    answer = answer_of("chosen", ACCOUNT, known, LABEL, 0)
    assert (answer.named, answer.leader_right, answer.wrong) == (named, leader_right, wrong)


@pytest.mark.parametrize(
    ("findings", "chances", "apart"),
    [
        ((), {"cable_spring": 0.4, "torque_offset": 0.004}, True),
        ((), {"cable_spring": 0.4, "torque_offset": 0.005}, False),
        ((), {"cable_spring": 0.4}, True),
        ((), {}, False),
        ((), {"torque_offset": 0.9}, False),
        ((SPRING,), {}, True),
        ((OPEN,), {"cable_spring": 1.0}, False),
    ],
)
def test_a_pair_is_told_apart_where_the_other_one_is_out_with_or_without_a_name(
    findings: tuple[Named, ...], chances: dict[str, float], apart: bool
) -> None:
    alive = [Alive(name="", effect=name, joint=2, probability=share, log_odds=0.0) for name, share in chances.items()]
    elsewhere = Alive(name="", effect="torque_offset", joint=3, probability=0.5, log_odds=0.0)
    known = msgspec.structs.replace(step(*findings), alive=(*alive, elsewhere))
    label = {**LABEL, "rival": "torque_offset"}
    assert answer_of("chosen", ACCOUNT, known, label, 0).told_apart is apart
    assert answer_of("chosen", ACCOUNT, known, LABEL, 0).told_apart is None


def test_where_nothing_is_hidden_silence_is_right() -> None:
    label = {"group": "nothing", "effects": []}
    assert answer_of("chosen", ACCOUNT, step(), label, 0).leader_right
    assert not answer_of("chosen", ACCOUNT, step(SPRING), label, 0).named


@pytest.mark.parametrize(
    ("after", "came"),
    [
        (step(SPRING), True),
        (step(leader="cable_spring", stands_out=True), False),
        (step(OPEN, leader="cable_spring", stands_out=True), False),
        (step(Named(effect="cable_spring", joint=3)), False),
    ],
)
def test_a_forecast_came_true_where_the_truth_had_its_name_after_that_motion(after: Step, came: bool) -> None:
    motion = Motion(number=3, kind="x", purpose="", trajectory="", periods=4, seconds=40.0, forecast=0.9)
    account = Account(
        robot="iiwa14", seed=1, budget_s=120.0,
        recordings=(Recorded(file="a"), Recorded(file="b"), Recorded(file="c", motion=motion)),
        steps=(step(recordings=2), after),
    )  # fmt: skip
    assert forecasts_of(account, LABEL) == ((0.9, came),)


@pytest.mark.parametrize(
    ("after", "came"),
    [
        (step(SPRING, stands_out=True), True),
        (step(SPRING), False),
        (step(SPRING, leader="torque_offset", stands_out=True), False),
        (step(stands_out=True), False),
    ],
)
def test_a_forecast_after_the_name_is_of_what_is_left_which_is_nothing(after: Step, came: bool) -> None:
    """It came true whatever it had promised, as the name was there already."""
    motion = Motion(number=3, kind="x", purpose="", trajectory="", periods=4, seconds=40.0, forecast=0.02)
    account = Account(
        robot="iiwa14", seed=1, budget_s=120.0,
        recordings=(Recorded(file="a"), Recorded(file="b"), Recorded(file="c", motion=motion)),
        steps=(step(SPRING, recordings=2), after),
    )  # fmt: skip
    assert forecasts_of(account, LABEL) == ((0.02, came),)


def test_a_forecast_of_nothing_came_true_where_nothing_stood_out() -> None:
    motion = Motion(number=3, kind="x", purpose="", trajectory="", periods=4, seconds=40.0, forecast=0.9)
    account = Account(
        robot="iiwa14", seed=1, budget_s=120.0,
        recordings=(Recorded(file="a"), Recorded(file="b"), Recorded(file="c", motion=motion)),
    )  # fmt: skip
    label = {"group": "nothing", "effects": []}
    for sure in (True, False):
        known = msgspec.structs.replace(account, steps=(step(stands_out=sure),))
        assert forecasts_of(known, label) == ((0.9, sure),)


@pytest.mark.parametrize(
    ("answer", "named", "wrong"),
    [
        ("sensor_offset", True, ()),
        ("asymmetric_coulomb_friction", False, ("asymmetric_coulomb_friction for sensor_offset",)),
    ],
)
def test_what_an_action_told_is_judged_by_the_label(answer: str, named: bool, wrong: tuple[str, ...]) -> None:
    label = {
        "group": "structural", "answer": "sensor_offset", "action": "warm_up",
        "effects": [{"effect": "torque_offset", "joint": 2, "acceptable": ["torque_offset"]}],
    }  # fmt: skip
    told = Told(action=Action.WARM_UP, answer=answer, settled=True, sentence="")
    account = msgspec.structs.replace(ACCOUNT, told=(told,))
    found = answer_of("chosen", account, step(Named(effect="torque_offset", joint=2)), label, 0)
    assert (found.named, found.wrong) == (named, wrong)
    silent = answer_of("chosen", ACCOUNT, step(Named(effect="torque_offset", joint=2)), label, 0)
    assert (silent.named, silent.wrong) == (False, ())


def test_what_an_operator_did_for_one_arm_is_no_part_of_the_recordings_of_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An arm that was warmed up stays warm, so that whoever asks for it comes last; answers keep their order."""
    seal = {"salt": "s", "label": json.dumps(LABEL)}
    commitment = hashlib.sha256((seal["salt"] + seal["label"]).encode()).hexdigest()
    warm: list[bool] = []

    class Robot:
        """Plays the robot: notes whether it was warm in each recording that was asked for."""

        acted = False

        def ask(self, request: dict[str, Any]) -> dict[str, Any]:
            self.acted = self.acted or "act" in request
            if "record" in request:
                warm.append(self.acted)
            return {"commitment": commitment, "question": "", "limits_broken": 0, **(seal if "open" in request else {})}

    def arm(start: Account, driver: Any, folder: Path, _: Any) -> Account:
        driver.record(closed_loop.default_trajectory("iiwa14"), 4, folder)
        if folder.name == "chosen":
            driver.act(Action.WARM_UP)
        return msgspec.structs.replace(start, steps=(step(SPRING),))

    monkeypatch.setattr(closed_loop, "_ARMS", dict.fromkeys(ARMS, arm))
    case = closed_loop._one_case(Robot(), 1, 0, tmp_path / "case", lambda _: None)  # type: ignore[arg-type]
    assert warm == [False] * 5
    assert [answer.arm for answer in case.answers] == list(ARMS)


def test_reliability_and_rows_are_counted() -> None:
    forecasts = ((0.97, True), (0.99, True), (1.0, False), (0.6, True), (0.6, False))
    (low, high) = reliability(forecasts)
    assert low == ("50 to 80 %", 2, pytest.approx(0.6), 0.5)
    assert high[1] == 3
    assert high[3] == pytest.approx(2 / 3)
    before = Answer("chosen", False, (), False, None, 0.0, "", 0)
    answers = (
        Answer("chosen", True, (), True, True, 40.0, "settled", 0),
        Answer("random", False, ("x",), False, False, 120.0, "", 1),
    )
    summary = loop_summary([LoopCase(0, "", LABEL, before, answers, forecasts)])
    rows = {(row[0], row[1]): row[2:] for row in loop_rows(summary)}
    assert rows["confusable", "chosen"] == ("1 of 1", "1 of 1", "1 of 1", "0 of 1", "40", "0")
    assert rows["confusable", "random"] == ("0 of 1", "0 of 1", "0 of 1", "1 of 1", "120", "1")
    assert rows["all", "before"][:3] == ("0 of 1", "0 of 1", "–")
    assert len(reliability_rows(summary)) == 2
