"""A bad wire makes no wrong command: judged by the robot, which refuses jumps, limits and what is no number.

Every cell is run in simulated time, where its outcome is that of the rules; one of each trouble also with processes and
sockets as they are, where the machine adds troubles of its own and only what holds whatever happens is asked for.
"""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from fixtures.fake_robot.rules import SessionRules
from fixtures.fake_robot.server import FakeRobot, Options
from fixtures.physics.settings import PhysicsSettings
from fri_client.handover.ring import HandoverRing
from fri_client.loop.loop import FriLoop
from fri_client.loop.result import LoopResult, LoopSettings
from fri_client.messages import FriVersion
from fri_client.motion.program import MotionProgram
from safety.limits import IIWA14_R820
from tests.end_to_end.fault_account import matches
from tests.end_to_end.fault_case import FaultCase
from tests.end_to_end.fault_check import REST_RAD_S
from tests.end_to_end.fault_runner import LEAD_IN_S, robot_settings, run_case, short_motion
from tests.end_to_end.simulated_wire import SimulatedWire
from tests.end_to_end.wire_cases import REAL, TOLERANT, WIRE_CASES
from tests.end_to_end.wire_proxy import Direction

WHY = {
    "completed": "period was driven",
    "stopped": "The arm was stopped by ramp",
    "dropped": "Session dropped at cycle [0-9]+",
    "not_started": "let no motion begin within .*: ",
    "no_robot": "No FRI message",
    "refused": "nothing was moved",
}


def run_in_simulated_time(
    case: FaultCase, held_up: tuple[int, int] | None = None
) -> tuple[LoopResult, dict[str, Any], int]:
    """What the loop says, the robot's summary, and how many of the records that the loop handed over were answers."""
    assert case.wire is not None
    wire = SimulatedWire(*case.wire, seed=11, held_up=held_up)
    table = short_motion().table(1000.0)
    settings = robot_settings(case, table)
    robot = FakeRobot(
        Options(send_period_ms=5, seed=7),
        PhysicsSettings.from_mapping({"initial_position_rad": settings["initial_position_rad"]}),
        SessionRules.from_mapping(settings["session"]),
        link=wire.link,
    )

    def make_motion(command_period_s: float, samples_per_command: int) -> MotionProgram:
        return MotionProgram(
            table, IIWA14_R820, command_period_s=command_period_s, samples_per_command=samples_per_command,
            periods=case.request["periods"], lead_in_s=LEAD_IN_S,
        )  # fmt: skip

    timeouts = {name: value for name, value in case.request.items() if name.endswith("timeout_s")}
    ring = HandoverRing.create(4096)
    answered = 0

    def record() -> None:
        nonlocal answered
        answered += sum(record.send_ns > 0 for record in ring.read_batch())
        ring.release()

    wire.beside = record
    try:
        loop = FriLoop(wire, FriVersion.V1_15, make_motion, ring, LoopSettings(**timeouts, fake_robot_only=True), wire)
        with wire.robot(robot) as summary:
            result = loop.run()
        record()
    finally:
        ring.close()
    return result, summary, answered


@pytest.mark.parametrize("case", WIRE_CASES, ids=lambda case: case.name)
def test_a_bad_wire_makes_no_wrong_command(case: FaultCase) -> None:
    result, robot, answered = run_in_simulated_time(case)
    assert matches(result.sentence, WHY[result.outcome]), result.sentence
    if case.outcome is not None:
        assert result.outcome == case.outcome, result.sentence
    assert robot["rejections"] == []
    if TOLERANT.items() <= case.session.items():
        # The robot holds still while answers are lost, and what comes after them comes at once: that is its own.
        assert robot["judgement"]["percent"]["velocity"] <= 100.0
    else:
        assert robot["judgement"]["passed"], robot["judgement"]["excesses"]
    assert robot["arm_speed_at_end_rad_s"] < REST_RAD_S
    assert answered >= robot["counts"]["answered"] > 0


@pytest.mark.parametrize("held_up_ms", [7, 13, 53, 400])
def test_the_arm_stands_while_the_process_of_the_robot_is_held_up(held_up_ms: int) -> None:
    """It counted one cycle where 53 ms had passed: the re-entry from rest, which was right, was judged as a jump."""
    case = next(case for case in WIRE_CASES if case.name == "jitter-20%")
    quiet = replace(case, wire=(case.wire[0], 0.0)) if case.wire else case
    result, robot, _ = run_in_simulated_time(quiet, (67, held_up_ms * 1_000_000))
    assert result.outcome == "completed", result.sentence
    assert (robot["counts"]["own_overruns"] > 3) == (held_up_ms > 10)
    assert robot["judgement"]["passed"], robot["judgement"]["excesses"]
    assert robot["simulated_time_s"] == pytest.approx(robot["wall_time_s"], abs=held_up_ms * 1e-3 + 0.02)


def test_simulated_time_gives_the_same_run_again() -> None:
    case = next(case for case in WIRE_CASES if case.name == "jitter-20%")
    once, again = (run_in_simulated_time(case)[1] for _ in range(2))
    assert once == again
    assert once["counts"]["late"] > 0


@pytest.mark.parametrize("case", [case for case in WIRE_CASES if case.name in REAL], ids=lambda case: case.name)
def test_nor_does_it_between_real_processes(case: FaultCase, tmp_path: Path) -> None:
    result = run_case(case, tmp_path)
    assert result.rejections == ()
    assert result.peaks[0] <= 1.0
    assert result.speed_at_end < REST_RAD_S
    told = json.loads((tmp_path / "run" / "run.json").read_text())
    assert (told["outcome"], told["exit_code"]) == (result.outcome, result.exit_code), result.transcript
    # A flipped byte of the robot's own description may make the motion impossible, for as many reasons as there are.
    why = told["sentences"][0]
    assert told["outcome"] == "refused" or matches(why, WHY[told["outcome"]]), why
    assert matches(result.transcript, re.escape(why)), result.transcript
    assert result.answered_samples >= result.robot_answered
    assert "Traceback" not in result.transcript
    assert result.left_running == ()


def test_there_is_a_real_run_of_each_trouble() -> None:
    assert {case.wire[0] for case in WIRE_CASES if case.name in REAL and case.wire} == {
        case.wire[0] for case in WIRE_CASES if case.wire
    }


@pytest.mark.parametrize("share", [0.01, 0.05, 0.2])
def test_the_proxy_does_to_the_share_of_datagrams_what_it_is_told(share: float) -> None:
    sent = [number.to_bytes(4, "big") * 10 for number in range(20_000)]
    came = {}
    for trouble in ("loss", "delay", "duplicate", "reorder", "garbage"):
        direction = Direction(trouble, share, (1, 0), to_client=True)
        came[trouble] = []
        for number, datagram in enumerate(sent):
            direction.take(datagram, number * 0.005)
            came[trouble] += direction.due(number * 0.005)
        came[trouble] += direction.due(1e9)
    expected = pytest.approx(share * len(sent), rel=0.2)
    assert len(sent) - len(came["loss"]) == expected
    assert len(came["duplicate"]) - len(sent) == expected
    assert sum(spoiled != datagram for spoiled, datagram in zip(came["garbage"], sent, strict=True)) == expected
    assert came["delay"] == sent
    assert sorted(came["reorder"]) == sent[: len(came["reorder"])] != came["reorder"]
