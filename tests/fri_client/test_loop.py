"""The loop against a scripted robot: whole runs, stops of every kind, faults of its own, multipliers."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import pytest

from fri_client.handover.motion_phase import MotionPhase
from fri_client.handover.ring import EventCode
from fri_client.loop.result import LoopSettings
from fri_client.messages import FriVersion
from fri_client.wire.codec import Codec

from .scripted_robot import (
    ACTIVE,
    COMMANDING_WAIT,
    READY,
    REST,
    WAIT,
    Client,
    events,
    running,
    short_table,
)


@pytest.mark.parametrize("version", [FriVersion.V1_15, FriVersion.V2_5, FriVersion.V2_7])
def test_a_whole_run_drives_every_sample_of_every_period_once_and_confirms_standstill(version: FriVersion) -> None:
    with running(version) as (client, robot):
        robot.to_active()
        robot.until_done(client)
        result = client.finish()
        records = client.records()
    assert (result.outcome, result.standstill_confirmed) == ("completed", True), result.sentence
    labels = [(r.period, r.sample_in_period) for r in records if r.phase == MotionPhase.EXCITATION]
    assert labels == [(period, sample) for period in range(2) for sample in range(400)]
    # What reached the robot under a label is the row of the table of that number.
    codec, table = Codec(version), short_table()
    for record in records:
        if record.phase == MotionPhase.EXCITATION:
            assert record.command is not None
            data = codec.decode_command(record.command).command_data
            assert data is not None
            assert data.joint_position == tuple(table[record.sample_in_period])
    assert [command.header.sequence_counter for command in robot.received] == list(range(len(robot.received)))
    assert [r.index for r in records] == list(range(len(records)))


def test_a_stop_request_of_the_supervisor_is_a_ramp_that_the_robot_can_follow() -> None:
    with running() as (client, robot):
        robot.to_active()
        robot.exchange(ACTIVE, 700)
        client.ring.request_stop(EventCode.DISK_FULL)
        robot.until_done(client)
        result = client.finish()
        records = client.records()
    assert (result.outcome, result.reason) == ("stopped", "DISK_FULL"), result.sentence
    assert result.standstill_confirmed
    assert EventCode.DISK_FULL in events(records)
    robot.assert_gentle()


@pytest.mark.parametrize(
    ("provoke", "reason"),
    [
        (lambda client: client.loop.stop_from_signal(15), "SIGNAL_STOP"),
        (lambda client: client.ring.request_stop(), "OPERATOR_STOP"),
        (lambda client: client.ring.request_stop(9999), "OPERATOR_STOP"),
        (lambda client: client.ring.beat(1), "SUPERVISOR_LOST"),
    ],
)
def test_every_request_from_outside_stops_by_ramp_and_is_named(provoke: Callable[[Client], None], reason: str) -> None:
    with running() as (client, robot):
        robot.to_active()
        robot.exchange(ACTIVE, 700)
        provoke(client)
        robot.until_done(client)
        result = client.finish()
    assert (result.outcome, result.reason, result.standstill_confirmed) == ("stopped", reason, True)
    robot.assert_gentle()


def test_a_recorder_that_falls_behind_stops_the_motion_before_a_sample_is_lost() -> None:
    with running(slots=2048, periods=8) as (client, robot):
        robot.to_active()
        robot.until_done(client)  # nobody reads the ring
        result = client.finish()
        assert client.ring.lost == 0
    assert (result.outcome, result.reason) == ("stopped", "RECORDER_LOST"), result.sentence


def test_external_torque_beyond_its_limit_stops_the_motion() -> None:
    with running(external_torque_limit=(30.0,) * 7) as (client, robot):
        robot.to_active()
        robot.exchange(ACTIVE, 700)
        robot.exchange(ACTIVE, external=(0.0, -31.5, 0.0, 0.0, 0.0, 0.0, 0.0))
        robot.until_done(client)
        result = client.finish()
    assert (result.reason, result.joint, result.value, result.limit) == ("EXTERNAL_TORQUE", 2, -31.5, 30.0)
    robot.assert_gentle()


def test_an_internal_error_stops_the_arm_by_ramp_and_is_reported_as_a_fault() -> None:
    with running() as (client, robot):
        robot.to_active()
        robot.exchange(ACTIVE, 700)
        foresee = client.loop.motion.foresee

        def broken() -> Any:
            client.loop.motion.foresee = foresee  # type: ignore[method-assign]
            raise ZeroDivisionError("in the middle of a motion")

        client.loop.motion.foresee = broken  # type: ignore[method-assign]
        robot.exchange(ACTIVE)
        robot.until_done(client)
        result = client.finish()
    assert (result.outcome, result.reason, result.standstill_confirmed) == ("fault", "FAULT", True)
    assert "ZeroDivisionError" in result.sentence
    robot.assert_gentle()


@pytest.mark.parametrize(("limit", "begins"), [((30.0,) * 7, False), (None, True)])
def test_where_external_torque_is_watched_a_robot_that_sends_none_is_not_moved(
    limit: tuple[float, ...] | None, begins: bool
) -> None:
    settings = LoopSettings(command_timeout_s=0.4)
    with running(settings=settings, external_torque_limit=limit) as (client, robot):
        robot.to_active()
        robot.until_done(client, external=None)
        result = client.finish()
    assert (result.outcome == "completed") is begins
    assert ("sends no external torque" in result.sentence) is not begins


def test_a_robot_that_stops_to_send_the_watched_external_torque_is_stopped_by_ramp() -> None:
    with running(external_torque_limit=(30.0,) * 7) as (client, robot):
        robot.to_active()
        robot.exchange(ACTIVE, 700)
        robot.until_done(client, external=None)
        result = client.finish()
    assert (result.outcome, result.reason, result.standstill_confirmed) == ("stopped", "EXTERNAL_TORQUE", True)
    assert "sends no external torque any more" in result.sentence
    assert result.stop_kind == "path"
    robot.assert_gentle()


def test_an_arm_far_from_its_ipo_position_is_not_moved() -> None:
    with running(settings=LoopSettings(command_timeout_s=0.4)) as (client, robot):
        robot.exchange(WAIT)
        away = (*REST[:4], REST[4] + 0.3, *REST[5:])
        while client.thread.is_alive():
            robot.send(ACTIVE, measured=away)
            threading.Event().wait(0.001)
        result = client.finish()
    assert result.outcome == "not_started"
    assert "joint 5 is 0.300 rad from its IPO position" in result.sentence


def test_a_table_that_does_not_fit_the_robots_period_ends_before_anything_moves() -> None:
    with running() as (client, robot):
        robot.send(WAIT, multiplier=3)
        robot.send(WAIT, multiplier=3)
        robot.send(WAIT, multiplier=3)
        result = client.finish()
    assert result.outcome == "refused"
    assert "no whole number of command periods of 3 ms" in result.sentence
    assert client.loop.refusal_exit_code == 65


def test_a_receive_multiplier_is_honoured_in_a_whole_run() -> None:
    with running() as (client, robot):
        for state, count in ((WAIT, 4), (READY, 4), (COMMANDING_WAIT, 4), (ACTIVE, 20000)):
            for _ in range(count):
                robot.send(state, multiplier=2)
                robot.send(state, multiplier=2)
                if not robot.take_if_alive(client):
                    break
        result = client.finish()
        records = client.records()
    assert result.outcome == "completed", result.sentence
    labels = [(r.period, r.sample_in_period) for r in records if r.period >= 0]
    assert labels == [(period, sample) for period in range(2) for sample in range(400)]


def test_between_two_commands_a_lost_or_refused_message_shifts_no_label() -> None:
    # The truth is the robot's counter: a sample lies so many messages behind the one whose answer began its row.
    lost, no_number = {7: (2,), 11: (1, 3)}, (float("nan"),) * 7
    with running() as (client, robot):
        for state, groups in ((WAIT, 2), (READY, 2), (COMMANDING_WAIT, 6), (ACTIVE, 4000)):
            for group in range(groups):
                for place in range(1, 6):
                    if state == ACTIVE and place in lost.get(group % 13, ()):
                        robot.counter += 1
                        robot.time_ms += 1
                    else:
                        bad = state == ACTIVE and (group % 13, place) == (3, 2)
                        robot.send(state, multiplier=5, **({"torque": no_number} if bad else {}))
                if not robot.take_if_alive(client):
                    break
        result = client.finish()
        records = client.records()
    assert result.outcome == "completed", result.sentence
    codec, table = Codec(FriVersion.V1_15), short_table()
    seen, answered_at, row = set(), 0, -1
    for record in records:
        if record.period < 0:
            continue
        counter = codec.decode_monitoring(record.monitoring).header.sequence_counter
        if record.command is not None:
            data = codec.decode_command(record.command).command_data
            assert data is not None
            assert data.joint_position == tuple(table[record.sample_in_period])
            answered_at, row = counter, record.sample_in_period
        assert record.sample_in_period == row + counter - answered_at
        seen.add((record.period, record.sample_in_period))
    assert 740 < len(seen) < 800
