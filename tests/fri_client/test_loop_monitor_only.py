"""The loop against a scripted robot when it only monitors: it gives back what the robot says and commands nothing."""

from __future__ import annotations

import pytest

from fri_client.handover.motion_phase import MotionPhase
from fri_client.handover.ring import Disposition, EventCode
from fri_client.loop.result import LoopResult, LoopSettings
from fri_client.messages import FriVersion

from .scripted_robot import (
    ACTIVE,
    COMMANDING_WAIT,
    IDLE,
    READY,
    REST,
    WAIT,
    Client,
    Robot,
    SteppedClock,
    running,
)


def driven_in_mode(client: Client, robot: Robot, operation: int | None, outcome: str) -> LoopResult:
    """What the loop says of a motion that the robot offers in an operation mode. outcome: what is expected of it."""
    robot.exchange(WAIT, 3, operation=operation)
    robot.exchange(COMMANDING_WAIT, 5, operation=operation)
    if outcome == "completed":
        robot.until_done(client, operation=operation)
    while client.thread.is_alive():
        robot.send(ACTIVE, operation=operation)
        robot.take_if_alive(client)
    return client.finish()


@pytest.mark.parametrize("version", [FriVersion.V1_15, FriVersion.V2_5])
def test_a_run_that_only_monitors_gives_back_what_the_robot_says_and_lasts_until_the_robot_leaves(
    version: FriVersion,
) -> None:
    with running(version, LoopSettings(receive_timeout_s=60.0, monitor_only=True, command_timeout_s=0.001)) as (
        client,
        robot,
    ):
        robot.exchange(WAIT, 3)
        for step in range(300):  # somebody leads the arm
            robot.position = tuple(angle + 1e-3 * step for angle in REST)
            answer = robot.exchange(READY)
            data = answer.command_data
            assert (data is None) == (version.major == 2)  # PROTOCOL section 8
            assert data is None or data.joint_position == robot.position
        robot.position = REST
        for state in [COMMANDING_WAIT] * 60 + [ACTIVE] * 300:
            data = robot.exchange(state).command_data
            assert data is not None
            assert data.joint_position == REST
        robot.exchange(READY, 20)
        robot.send(IDLE)
        result, records = client.finish(), client.records()
    assert (result.outcome, result.reason) == ("completed", "completed"), result.sentence
    assert "The robot ended its session" in result.sentence
    assert "no motion was commanded" in result.sentence
    assert len([each for each in records if each.disposition == Disposition.FRESH and each.monitoring]) == 684
    assert {each.phase for each in records} == {MotionPhase.WAITING}
    assert {each.period for each in records} == {-1}


@pytest.mark.parametrize(
    ("code", "outcome"), [(EventCode.OPERATOR_STOP, "completed"), (EventCode.RECORDER_LOST, "stopped")]
)
def test_a_run_that_only_monitors_ends_well_when_somebody_ends_it(code: EventCode, outcome: str) -> None:
    with running(settings=LoopSettings(receive_timeout_s=60.0, monitor_only=True)) as (client, robot):
        robot.exchange(READY, 50)
        client.ring.request_stop(code)
        result = client.finish()
    assert (result.outcome, result.reason) == (outcome, code.name)
    assert "moved" not in result.sentence  # who knows what moved the arm


def test_a_run_that_only_monitors_ends_when_the_robot_falls_silent_and_waits_for_it_before() -> None:
    clock, settings = SteppedClock(), LoopSettings(receive_timeout_s=0.2, monitor_only=True)
    with running(settings=settings, clock_ns=clock) as (client, robot):
        clock.now_ns += 400_000_000
        robot.exchange(READY, 5)
        client.wait_until_heard(messages=5)
        assert client.thread.is_alive()
        clock.now_ns += 400_000_000
        result = client.finish()
    assert result.outcome == "completed"
    # Nobody saw it end its session: it may be there, with messages that cannot be used, or behind a broken line.
    assert result.sentence.startswith("No message that can be used came from the robot any more. 5 messages came")


@pytest.mark.parametrize("kind", ["position", "torque", "undecodable"])
def test_a_run_that_only_monitors_does_not_end_well_where_messages_still_come_and_none_can_be_used(kind: str) -> None:
    clock, settings = SteppedClock(), LoopSettings(receive_timeout_s=0.2, monitor_only=True)
    with running(settings=settings, clock_ns=clock) as (client, robot):
        robot.exchange(READY, 5)
        clock.now_ns += 100_000_000
        impossible = (float("nan"), *REST[1:])
        if kind == "position":
            robot.send(READY, measured=impossible)
        elif kind == "torque":
            robot.exchange(READY, torque=impossible)
        else:
            robot.channel.sendto(b"no message of FRI", robot.client)
        client.wait_until_heard(messages=5 + (kind != "undecodable"), undecodable=kind == "undecodable")
        clock.now_ns += 400_000_000
        result = client.finish()
    assert result.outcome == "dropped"  # exit code 1: the answer is no, and what was recorded is kept
    assert result.sentence.startswith("No message that can be used came from the robot any more.")
    assert "no motion was commanded" in result.sentence


@pytest.mark.parametrize(("operation", "outcome"), [(2, "not_started"), (0, "completed"), (None, "completed")])
def test_the_first_run_on_an_arm_begins_in_t1_alone(operation: int | None, outcome: str) -> None:
    settings = LoopSettings(receive_timeout_s=60.0, command_timeout_s=0.3, test_mode_only=True)
    with running(settings=settings) as (client, robot):
        result = driven_in_mode(client, robot, operation, outcome)
    assert result.outcome == outcome, result.sentence
    assert ("the robot is in AUTOMATIC_MODE" in result.sentence) == (outcome == "not_started")


@pytest.mark.parametrize(("operation", "outcome"), [(0, "completed"), (2, "dropped")])
def test_a_first_run_is_held_to_t1_too_where_the_robot_says_its_mode_only_in_the_motion(
    operation: int, outcome: str
) -> None:
    with running(settings=LoopSettings(receive_timeout_s=60.0, test_mode_only=True)) as (client, robot):
        robot.exchange(WAIT, 3, operation=None)
        robot.exchange(COMMANDING_WAIT, 5, operation=None)
        robot.exchange(ACTIVE, 700, operation=None)
        robot.until_done(client, operation=operation)
        result = client.finish()
    assert result.outcome == outcome, result.sentence
    assert result.standstill_confirmed
    robot.assert_gentle()


@pytest.mark.parametrize(("operation", "outcome"), [(0, "not_started"), (1, "completed"), (2, "completed")])
def test_a_motion_too_fast_for_t1_does_not_begin_in_it(operation: int, outcome: str) -> None:
    """The cabinet would stop it on the way; before, the question to the operator said so, and it was driven."""
    clause = "the end-effector would reach 0.632 m/s"
    settings = LoopSettings(receive_timeout_s=60.0, command_timeout_s=0.3, too_fast_for_t1=clause)
    with running(settings=settings) as (client, robot):
        result = driven_in_mode(client, robot, operation, outcome)
    assert result.outcome == outcome, result.sentence
    assert (clause in result.sentence) == (outcome == "not_started")


def test_a_motion_too_fast_for_t1_ends_where_the_robot_says_its_mode_only_then() -> None:
    settings = LoopSettings(receive_timeout_s=60.0, too_fast_for_t1="it is too fast")
    with running(settings=settings) as (client, robot):
        robot.exchange(WAIT, 3, operation=None)
        robot.exchange(COMMANDING_WAIT, 5, operation=None)
        robot.exchange(ACTIVE, 700, operation=None)
        robot.until_done(client, operation=0)
        result = client.finish()
    assert result.outcome == "dropped", result.sentence
    assert result.standstill_confirmed
    robot.assert_gentle()


def test_who_ends_the_wait_for_a_motion_is_told_what_it_waited_for() -> None:
    with running(settings=LoopSettings(test_mode_only=True)) as (client, robot):
        robot.exchange(WAIT, 3)
        robot.exchange(COMMANDING_WAIT, 5)
        robot.exchange(ACTIVE, 30)
        client.wait_until_heard(messages=38)
        assert client.ring.hindrance.endswith("the robot is in AUTOMATIC_MODE")
        client.ring.request_stop(EventCode.OPERATOR_STOP)
        robot.send(ACTIVE)
        result = client.finish()
    assert result.outcome == "stopped"
    assert "Nothing had moved: the first run" in result.sentence
    assert "the robot is in AUTOMATIC_MODE" in result.sentence
