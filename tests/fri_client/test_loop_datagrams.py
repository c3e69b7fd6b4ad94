"""The loop against a scripted robot with doubled, damaged, foreign and waiting datagrams."""

from __future__ import annotations

import math
import socket
import threading
import time
from collections.abc import Callable
from typing import Any

import pytest
from msgspec.structs import replace

from fri_client.handover.ring import Disposition
from fri_client.loop.result import LoopSettings
from fri_client.messages import (
    MONITORING_IDENTIFIER,
    MessageHeader,
    MonitoringMessage,
    RobotInfo,
)

from .scripted_robot import (
    ACTIVE,
    READY,
    Robot,
    SteppedClock,
    running,
)


def test_duplicates_stale_ones_garbage_and_numbers_that_are_none_do_not_move_the_path() -> None:
    with running() as (client, robot):
        robot.to_active()
        for round_ in range(700):
            robot.exchange(ACTIVE)
            robot.counter -= 1
            robot.send(ACTIVE, elapsed_ms=0)  # a duplicate
            robot.counter -= 3
            robot.send(ACTIVE, elapsed_ms=0)  # an old one, seen before
            robot.counter += 2
            robot.channel.sendto(b"\x00garbage" * (round_ % 30), robot.client)
            robot.send(ACTIVE, measured=(math.nan,) * 7)
        robot.until_done(client)
        result = client.finish()
        records = client.records()
        counts = client.loop.session.counts
    assert result.outcome == "completed", result.sentence
    # An old counter 2 behind is a number already seen: a duplicate by the 64 counters the session remembers.
    assert (counts.duplicates, counts.stale, counts.refused, result.undecodable) == (1400, 0, 700, 700)
    assert counts.missing == 0
    by_kind = [sum(record.disposition == kind for record in records) for kind in Disposition]
    assert by_kind[Disposition.DUPLICATE] == 1400
    assert by_kind[Disposition.UNDECODABLE] == 700
    labels = [(r.period, r.sample_in_period) for r in records if r.period >= 0]
    assert labels == [(period, sample) for period in range(2) for sample in range(400)]
    robot.assert_gentle()


def test_a_torque_that_is_no_number_costs_its_samples_and_not_the_motion() -> None:
    with running() as (client, robot):
        robot.to_active()
        robot.exchange(ACTIVE, 700)
        robot.exchange(ACTIVE, 5, torque=(math.nan,) * 7)
        robot.until_done(client)
        result = client.finish()
        records = client.records()
    assert result.outcome == "completed"
    refused = [record for record in records if record.disposition == Disposition.REFUSED]
    assert [(record.sample_in_period, record.command is not None) for record in refused] == [(-1, True)] * 5
    assert len([record for record in records if record.period >= 0]) == 2 * 400 - 5
    robot.assert_gentle()


def test_torques_that_stay_no_numbers_end_in_a_ramp_and_not_in_a_cut() -> None:
    clock = SteppedClock()
    with running(settings=LoopSettings(receive_timeout_s=0.1), clock_ns=clock, periods=20) as (client, robot):
        robot.to_active()
        robot.exchange(ACTIVE, 700)
        robot.exchange(ACTIVE, torque=(math.nan,) * 7)
        client.wait_until_heard(messages=712)
        clock.now_ns += 200_000_000
        robot.until_done(client, torque=(math.nan,) * 7)
        result = client.finish()
    assert (result.outcome, result.reason, result.standstill_confirmed) == ("dropped", "SILENCE", True)
    robot.assert_gentle()


def test_a_stranger_is_neither_answered_nor_recorded() -> None:
    with running() as (client, robot):
        robot.exchange(READY, 3)
        stranger = Robot(client.address, counter=robot.counter)
        for _ in range(20):
            stranger.send(ACTIVE)
        robot.exchange(READY, 3)
        stranger.channel.settimeout(0.2)
        with pytest.raises(TimeoutError):
            stranger.take()
        stranger.channel.close()
        client.loop.stop_from_signal(15)
        result = client.finish()
        assert len([record for record in client.records() if record.monitoring]) == 6
    assert result.foreign == 20


@pytest.mark.parametrize("first", ["a header alone", "garbage", "six joints"])
def test_who_sends_no_whole_message_first_does_not_lock_the_robot_out(first: str) -> None:
    """One datagram of 11 bytes from anyone, before the robot's first, was the peer for the whole run."""
    with running() as (client, robot):
        stranger = Robot(client.address, counter=7)
        whole = stranger.codec.encode_monitoring(stranger.message(READY))
        header = MonitoringMessage(MessageHeader(MONITORING_IDENTIFIER, 7, 0))
        wrong = replace(stranger.message(READY), robot_info=RobotInfo(6))
        datagram = {
            "a header alone": stranger.codec.encode_monitoring(header),
            "garbage": whole[: len(whole) // 2],
            "six joints": stranger.codec.encode_monitoring(wrong),
        }[first]
        stranger.channel.sendto(datagram, client.address)
        is_whole = first != "garbage"
        client.wait_until_heard(messages=is_whole, undecodable=not is_whole)
        robot.exchange(READY, 3)
        client.loop.stop_from_signal(15)
        client.finish()
        stranger.channel.settimeout(0.1)
        with pytest.raises(TimeoutError):
            stranger.take()
        stranger.channel.close()
    assert len(robot.received) == 3


def test_a_robot_on_loopback_that_does_not_say_its_time_is_simulated_is_never_made_to_wait(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A cabinet relayed to loopback was dropped in motion: the loop slept 300 ms in a tick for the recorder."""
    waits: list[int] = []
    monkeypatch.setattr("fri_client.loop.stop_watch.RecorderPatience.wait", lambda _: waits.append(1))
    with running() as (client, robot):
        for _ in range(5):
            robot.counter += 1
            robot.time_ms += 1
            real = replace(robot.message(READY), announcement=None)
            robot.channel.sendto(robot.codec.encode_monitoring(real), robot.client)
            robot.take()
        assert not waits
        client.loop.stop_from_signal(15)
        client.finish()


def test_only_the_configured_robot_is_listened_to() -> None:
    settings, clock = LoopSettings(start_timeout_s=1.0, robot_host="127.0.0.9"), SteppedClock()
    with running(settings=settings, clock_ns=clock) as (client, robot):
        robot.send(READY)
        wait_for(lambda: client.loop._peer.foreign == 1)
        clock.now_ns += 2_000_000_000
        result = client.finish()
    assert (result.outcome, result.foreign) == ("no_robot", 1)


@pytest.mark.parametrize(
    ("host", "datagrams", "named"),
    [("127.0.0.2", 20, False), ("127.0.0.2", 5, False), ("127.0.0.2", 20, True), ("127.0.0.1", 20, False)],
)
def test_where_two_machines_send_no_arm_moves_before_one_is_named(host: str, datagrams: int, named: bool) -> None:
    """Two cabinets with the same address for their client: the first to be heard would be moved, whichever it is."""
    settings = LoopSettings(receive_timeout_s=60.0, command_timeout_s=0.4, robot_host="127.0.0.1" if named else None)
    with running(settings=settings) as (client, robot), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind((host, 0))
        robot.exchange(READY, 3)
        for _ in range(datagrams):
            other.sendto(robot.codec.encode_monitoring(robot.message(READY)), robot.client)
        robot.to_active()
        robot.until_done(client)
        result = client.finish()
        assert result.foreign == datagrams
        if host == "127.0.0.2" and datagrams > 10 and not named:
            assert result.outcome == "not_started"
            assert "127.0.0.2 sends to this port as well as 127.0.0.1" in result.sentence
            assert "add --robot-host 127.0.0.1 (in the configuration: robot_host)" in result.sentence
        else:
            assert result.outcome == "completed"


@pytest.mark.parametrize(
    ("in_the_silence", "after_it", "may_move"), [(0, 0, True), (1, 0, False), (0, 1, False), (12, 3, False)]
)
def test_the_doubt_goes_with_the_second_machine_and_comes_back_with_it(
    in_the_silence: int, after_it: int, may_move: bool
) -> None:
    """Datagrams of the second machine while the robot is silent, and after it; the time is the test's."""
    settings, clock = LoopSettings(receive_timeout_s=1.0), SteppedClock()
    with (
        running(settings=settings, clock_ns=clock) as (client, robot),
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other,
    ):
        other.bind(("127.0.0.2", 0))
        peer = client.loop._peer

        def send(datagrams: int) -> None:
            wanted = peer.foreign + datagrams
            for _ in range(datagrams):
                other.sendto(robot.codec.encode_monitoring(robot.message(READY)), robot.client)
            wait_for(lambda: peer.foreign == wanted)

        robot.exchange(READY, 3)
        send(20)
        robot.exchange(READY, 3)
        assert "127.0.0.2 sends to this port as well as 127.0.0.1" in peer.doubt
        send(in_the_silence)
        clock.now_ns += 2_000_000_000
        wait_for(lambda: peer.address is None)
        robot.exchange(READY)
        send(after_it)
        robot.to_active()
        if may_move:
            robot.until_done(client)
        else:
            robot.exchange(ACTIVE, 50)
            client.loop.stop_from_signal(15)
        result = client.finish()
        assert (result.outcome == "completed") is may_move
        assert client.loop.session.begun is may_move
        assert bool(peer.doubt) is not may_move


def wait_for(condition: Callable[[], bool]) -> None:
    while not condition():
        time.sleep(0.001)


@pytest.mark.parametrize("extra", ["nothing", "stray", "garbage", "duplicate"])
@pytest.mark.parametrize("waiting", [9, 20])
def test_of_a_backlog_after_a_stall_the_newest_message_alone_is_answered_by_one_step(waiting: int, extra: str) -> None:
    """Before, a datagram that was no newer message behind each made every answer an advance: 31 steps in one cycle."""
    with running() as (client, robot):
        robot.to_active()
        robot.exchange(ACTIVE, 700)
        # What a stalled client finds in its socket: many messages at once. The loop is held in its first step by a
        # ring whose push waits, which is as good as a process that does not get the processor.
        client.wait_until_heard(messages=711)
        released, held = threading.Event(), threading.Event()
        push = client.loop._journal.record

        def slow(*arguments: Any) -> None:
            held.set()
            released.wait(600.0)
            push(*arguments)

        client.loop._journal.record = slow  # type: ignore[method-assign]
        robot.send(ACTIVE)
        before = robot.take()
        held.wait(600.0)
        stranger = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        for _ in range(waiting):
            robot.send(ACTIVE)
            if extra == "stray":
                stranger.sendto(b"whatever", robot.client)
            elif extra == "garbage":
                robot.channel.sendto(b"\x00garbage", robot.client)
            elif extra == "duplicate":
                robot.counter -= 1
                robot.send(ACTIVE, elapsed_ms=0)
        client.loop._journal.record = push  # type: ignore[method-assign]
        released.set()
        answer = robot.take()
        newest = robot.counter
        robot.until_done(client)
        result = client.finish()
        stranger.close()
    assert before.command_data is not None
    assert answer.command_data is not None
    assert answer.header.reflected_sequence_counter == newest
    assert answer.header.sequence_counter == before.header.sequence_counter + 1
    assert result.late >= waiting - 1
    assert result.outcome == "completed"
    robot.assert_gentle(after_pause=before.header.sequence_counter if waiting > 10 else None)
