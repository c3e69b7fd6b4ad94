"""The loop against a scripted robot whose session is lost, closed, never opened, or of another version."""

from __future__ import annotations

import math
import threading
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from fri_client.handover.motion_phase import MotionPhase
from fri_client.handover.ring import EventCode
from fri_client.loop.result import LoopSettings
from fri_client.messages import (
    FriVersion,
    QuaternionTransformation,
)

from .scripted_robot import (
    ACTIVE,
    COMMANDING_WAIT,
    IDLE,
    READY,
    REST,
    WAIT,
    Robot,
    SteppedClock,
    events,
    running,
    short_table,
)


def test_a_drop_is_told_in_one_sentence_with_the_numbers_of_the_link() -> None:
    with running() as (client, robot):
        robot.to_active()
        robot.exchange(ACTIVE, 300)
        robot.exchange(ACTIVE, 40, quality=2)
        robot.counter += 9
        robot.time_ms += 9
        robot.exchange(ACTIVE, 1, quality=1)
        for _ in range(5):
            robot.send(READY, quality=1)
        robot.until_done(client)
        result = client.finish()
        records = client.records()
    assert (result.outcome, result.reason) == ("dropped", "QUALITY"), result.sentence
    told = result.sentence.split(" The stop is NOT confirmed")[0]
    for words in (
        "at cycle 352, ",
        " s into the motion: the connection quality fell to FAIR, below GOOD (still in COMMANDING_ACTIVE; ",
        "in the last second 9 messages missing and longest turn-around ",
        "quality EXCELLENT -> GOOD ",
        " s before -> FAIR 0.00 s before); no command follows by itself.",
    ):
        assert words in told, told
    assert told.count(". ") == 0
    assert told.count("FAIR 0.00 s before") == 1  # it was told twice
    codes = events(records)
    assert codes.index(EventCode.SESSION_DROP) < codes.index(EventCode.STOP_ON_PATH)


@pytest.mark.parametrize("left", [IDLE, WAIT, READY, COMMANDING_WAIT])
@pytest.mark.parametrize("back_at", [REST, None])
def test_a_session_that_left_gets_no_position_any_more_even_if_the_robot_commands_again(
    left: int, back_at: tuple[float, ...] | None
) -> None:
    with running() as (client, robot):
        robot.to_active()
        robot.exchange(ACTIVE, 700)
        positions = len([command for command in robot.received if command.command_data is not None])
        for _ in range(14):  # longer than a robot bridges, so it stands
            robot.send(left)
        if left in (WAIT, READY):
            robot.exchange(left, 3)
        if back_at is not None:
            robot.position = back_at
        for state in (COMMANDING_WAIT, ACTIVE):
            for _ in range(50):
                robot.send(state, ipo=robot.position)
        robot.until_done(client, ipo=robot.position)
        result = client.finish()
        records = client.records()
    assert result.outcome == "dropped", result.sentence
    assert result.reason == ("SESSION_CLOSED" if left == IDLE else "LEFT_COMMANDING_ACTIVE")
    assert EventCode.SESSION_DROP in events(records)
    assert len([command for command in robot.received if command.command_data is not None]) == positions
    bare = [command for command in robot.received if command.command_data is None]
    assert bool(bare) == (left in (WAIT, READY))  # a monitoring state is answered on, by a header alone
    after = [record for record in records if record.phase == MotionPhase.LATCHED]
    assert after
    assert all((record.period, record.sample_in_period) == (-1, -1) for record in after)


@pytest.mark.parametrize("claimed", [IDLE, WAIT, READY, COMMANDING_WAIT, 9])
def test_one_message_that_claims_another_state_ends_the_motion_by_its_ramp(claimed: int) -> None:
    """Before, the next message in COMMANDING_ACTIVE was answered with the raw IPO position: 0.5 rad in 1 ms."""
    with running() as (client, robot):
        robot.to_active()
        robot.exchange(ACTIVE, 700)
        robot.send(claimed)
        robot.until_done(client)
        result = client.finish()
    assert (result.outcome, result.standstill_confirmed, result.stop_kind) == ("dropped", True, "path")
    robot.assert_gentle()


def test_a_safety_stop_seen_before_the_state_changes_is_followed_by_a_ramp_not_by_a_jump() -> None:
    with running() as (client, robot):
        robot.to_active()
        robot.exchange(ACTIVE, 700)
        robot.until_done(client, safety=2)
        result = client.finish()
    assert (result.outcome, result.reason, result.standstill_confirmed) == ("dropped", "SAFETY_STOP", True)
    robot.assert_gentle()


@pytest.mark.parametrize(
    ("reason", "changes"),
    [
        ("QUALITY", {"quality": 1}),
        ("QUALITY", {"quality": 0}),
        ("SAFETY_STOP", {"safety": 1}),
        ("DRIVES_OFF", {"drives": (2, 2, 2, 2, 2, 0, 2)}),
        ("OPERATION_MODE", {"operation": 1}),
        ("CONTROL_MODE", {"control": 2}),
        ("COMMAND_MODE", {"mode": 3}),
        ("OVERLAY_TYPE", {"overlay": 2}),
        ("PERIOD_CHANGE", {"period": 2}),
    ],
)
def test_every_way_a_session_is_lost_in_command_latches_slows_on_the_path_and_tells_the_numbers(
    reason: str, changes: dict[str, Any]
) -> None:
    with running() as (client, robot):
        robot.to_active()
        robot.exchange(ACTIVE, 700)
        robot.exchange(ACTIVE, 1, **changes)
        robot.until_done(client)  # all is as before again, and nothing resumes
        result = client.finish()
        records = client.records()
    assert (result.outcome, result.reason, result.standstill_confirmed) == ("dropped", reason, True), result.sentence
    # The robot's time is simulated: 701 of its cycles after the motion began, however long they took here.
    assert result.sentence.startswith("Session dropped at cycle 712, 0.70 s into the motion: ")
    assert "in the last second 0 messages missing and longest turn-around " in result.sentence
    assert result.sentence.count(". ") == 0
    assert (result.stop_kind, EventCode.STOP_ON_PATH in events(records)) == ("path", True)
    lost = [record.event_code for record in records].index(EventCode.SESSION_DROP)
    assert {record.phase for record in records[lost:]} == {MotionPhase.LATCHED}
    robot.assert_gentle()
    assert result.last_samples is not None
    assert result.last_samples.columns["event"].count("SESSION_DROP") == 1


def test_a_new_run_begins_at_the_ipo_position_of_its_own_session() -> None:
    with running() as (client, robot):
        robot.to_active()
        robot.exchange(ACTIVE, 700)
        for _ in range(20):
            robot.send(READY)
        robot.until_done(client)
        assert client.finish().outcome == "dropped"
        counter, moved = robot.counter, tuple(value + 0.05 for value in REST)
    with running() as (client, robot):
        robot.counter, robot.position = counter, moved
        robot.exchange(READY, 3)
        robot.exchange(COMMANDING_WAIT, 5, ipo=moved)
        first = robot.exchange(ACTIVE, 1, ipo=moved)
        robot.exchange(ACTIVE, 50, ipo=moved)
        client.loop.stop_from_signal(15)
        robot.until_done(client, ipo=moved)
        assert client.finish().outcome == "stopped"
    assert first.command_data is not None
    assert first.command_data.joint_position == pytest.approx(moved, abs=1e-12)
    robot.assert_gentle()


def test_silence_while_moving_latches_and_the_stop_is_reported_as_not_confirmed() -> None:
    clock = SteppedClock()
    with running(settings=LoopSettings(receive_timeout_s=0.2), clock_ns=clock) as (client, robot):
        robot.to_active()
        robot.exchange(ACTIVE, 700)
        client.wait_until_heard(messages=711)
        clock.now_ns += 300_000_000
        while client.ring.status.stop_reason == 0:
            threading.Event().wait(0.001)
        clock.now_ns += 2_000_000_000
        result = client.finish()
        records = client.records()
    assert (result.outcome, result.reason, result.standstill_confirmed) == ("dropped", "SILENCE", False)
    assert "NOT confirmed" in result.sentence
    # No command could be sent, so nobody is told how the arm comes to rest.
    assert not {EventCode.STOP_ON_PATH, EventCode.STOP_IN_JOINT_SPACE} & set(events(records))
    assert result.stop_kind is None


def test_a_robot_in_simulated_time_that_waits_for_an_answer_after_the_drop_is_waited_for() -> None:
    clock = SteppedClock()
    with running(settings=LoopSettings(receive_timeout_s=0.5), clock_ns=clock) as (client, robot):
        robot.to_active()
        robot.exchange(ACTIVE, 700)
        robot.send(ACTIVE, quality=1)  # the session is dropped, and this message gets no answer
        while client.ring.status.stop_reason == 0:
            threading.Event().wait(0.001)
        clock.now_ns += 3_000_000_000  # the wait of the fake robot for an answer (docs/fake-robot.md): 2 s
        while client.ring.status.time_ns < clock.now_ns:  # a loop that gives up does so in this very pass
            threading.Event().wait(0.001)
        for _ in range(1000):  # 1 s of an arm that stands
            robot.send(READY)
        result = client.finish()
    assert (result.outcome, result.reason, result.standstill_confirmed) == ("dropped", "QUALITY", True)
    assert "NOT confirmed" not in result.sentence


def test_a_counter_that_begins_anew_while_the_robot_commands_is_answered_by_a_ramp() -> None:
    with running() as (client, robot):
        robot.to_active()
        robot.exchange(ACTIVE, 700)
        count = len(robot.received)
        robot.counter = 5
        for _ in range(9):
            robot.send(ACTIVE)
        robot.until_done(client)
        result = client.finish()
        after = [command.command_data for command in robot.received[count - 1 :]]
    assert (result.outcome, result.reason, result.standstill_confirmed) == ("dropped", "COUNTER_RESTART", True)
    largest = np.abs(np.diff(short_table(), axis=0)).max()
    positions = np.array([data.joint_position for data in after if data is not None])
    assert np.abs(np.diff(positions, axis=0)).max() <= largest * 1.01


def test_a_robot_of_another_version_is_recognised_by_its_bytes() -> None:
    with running(FriVersion.V1_15, LoopSettings(start_timeout_s=0.5)) as (client, _):
        other = Robot(client.address, FriVersion.V2_7)
        other.send(WAIT)
        result = client.finish()
        other.channel.close()
    assert result.outcome == "version_mismatch"
    assert "speaks FRI 2.7" in result.sentence


def test_no_robot_and_a_robot_that_gives_no_command_end_with_different_sentences() -> None:
    with running(settings=LoopSettings(start_timeout_s=0.2)) as (client, _):
        assert client.finish().outcome == "no_robot"
    # The clock of the machine stands still: a robot in lockstep is given up by its own time.
    with running(settings=LoopSettings(command_timeout_s=0.3), clock_ns=SteppedClock()) as (client, robot):
        while client.thread.is_alive():
            robot.send(READY)
            robot.take_if_alive(client)
        assert client.loop.session.counts.fresh == 301
        result = client.finish()
    assert result.outcome == "not_started"
    assert "MONITORING_READY" in result.sentence


def test_a_robot_whose_every_message_is_refused_is_not_called_silent() -> None:
    """The operator was told to start an application that was running."""
    with running(settings=LoopSettings(start_timeout_s=0.2)) as (client, robot):
        while client.thread.is_alive():
            robot.send(WAIT, measured=(*REST[:2], math.nan, *REST[3:]))
            threading.Event().wait(0.001)
        result = client.finish()
    assert result.outcome == "no_robot"
    assert "No FRI message arrived" not in result.sentence
    assert "because the measured joint position of joint 3 is nan, which is impossible" in result.sentence


def test_a_session_closed_before_a_motion_says_where_it_was_and_how_good_it_was() -> None:
    with running(settings=LoopSettings(command_timeout_s=0.3)) as (client, robot):
        robot.exchange(READY, 3)
        robot.exchange(COMMANDING_WAIT, 3)
        robot.exchange(WAIT, 2, quality=1)
        while client.thread.is_alive():
            robot.send(IDLE, quality=0)
            threading.Event().wait(0.001)
        result = client.finish()
    assert result.outcome == "not_started"
    left = "the robot left COMMANDING_WAIT for MONITORING_WAIT at quality FAIR, before a motion began"
    assert f"the session stands in IDLE; {left}" in result.sentence


@pytest.mark.parametrize(("robots", "told"), [(FriVersion.V2_5, FriVersion.V1_15), (FriVersion.V1_15, FriVersion.V2_5)])
def test_a_robot_of_the_other_major_version_is_noticed_by_what_it_sends(robots: FriVersion, told: FriVersion) -> None:
    with running(told) as (client, _):
        robot = Robot(client.address, robots)
        for _ in range(20):
            robot.counter += 1
            robot.time_ms += 1
            message = robot.message(READY)
            if robots == FriVersion.V2_5:
                assert message.monitor_data is not None
                pose = QuaternionTransformation("", (0.0,) * 3 + (1.0, 0.0, 0.0, 0.0), None)
                message = replace(message, monitor_data=replace(message.monitor_data, measured_cartesian_pose=pose))
            robot.channel.sendto(robot.codec.encode_monitoring(message), robot.client)
            robot.take()
        client.loop.stop_from_signal(15)
        result = client.finish()
        robot.channel.close()
    assert f"only FRI {robots} sends, but this run was told FRI {told}" in result.sentence
