"""The loop against a robot written out in this file: a UDP socket that follows a script, message by message.

Its time is simulated, and it says so: one send period passes from message to message.
"""

from __future__ import annotations

import math
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from fri_client.handover.motion_phase import MotionPhase
from fri_client.handover.ring import Disposition, EventCode, HandoverRecord, HandoverRing
from fri_client.loop.channel import open_channel
from fri_client.loop.loop import FriLoop
from fri_client.loop.result import LoopResult, LoopSettings
from fri_client.messages import (
    MONITORING_IDENTIFIER,
    CommandMessage,
    ConnectionInfo,
    FriVersion,
    IpoData,
    MessageHeader,
    MonitorData,
    MonitoringMessage,
    QuaternionTransformation,
    RobotInfo,
    TimeStamp,
)
from fri_client.motion.program import MotionProgram
from fri_client.wire.codec import Codec
from safety.limits import IIWA14_R820

REST = (0.1, 0.3, -0.1, -0.9, 0.2, 0.5, 0.05)
IDLE, WAIT, READY, COMMANDING_WAIT, ACTIVE = range(5)


def short_table(rows: int = 400) -> np.ndarray:
    """One period of a sine in every joint, 0.05 rad, `rows` ms."""
    angle = 2 * np.pi * np.arange(rows) / rows
    return np.array(REST) + 0.004 * np.outer(np.sin(angle), np.ones(7))


@dataclass
class Robot:
    """The robot's side: sends what it is told, takes the answers, and follows each command at once."""

    client: tuple[str, int]
    version: FriVersion = FriVersion.V1_15
    counter: int = 100
    time_ms: int = 0
    position: tuple[float, ...] = REST
    received: list[CommandMessage] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.codec = Codec(self.version)
        self.channel = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.channel.bind(("127.0.0.1", 0))
        self.channel.settimeout(60.0)

    def message(self, state: int, **changes: Any) -> MonitoringMessage:
        monitor = MonitorData(
            measured_joint_position=changes.get("measured", self.position),
            measured_torque=changes.get("torque", (0.0,) * 7),
            commanded_joint_position=self.position if self.version.major == 1 else None,
            external_torque=changes.get("external", (0.0,) * 7),
            timestamp=TimeStamp(1_700_000_000 + self.time_ms // 1000, self.time_ms % 1000 * 1_000_000),
        )
        return MonitoringMessage(
            MessageHeader(MONITORING_IDENTIFIER, self.counter, 0),
            RobotInfo(
                7,
                changes.get("safety", 0),
                changes.get("drives", (2,) * 7),
                changes.get("operation", 2),
                changes.get("control", 0),
            ),
            monitor,
            ConnectionInfo(state, changes.get("quality", 3), changes.get("period", 1), changes.get("multiplier", 1)),
            IpoData(
                joint_position=changes.get("ipo", REST) if state >= COMMANDING_WAIT else None,
                client_command_mode=changes.get("mode", 1),
            ),
            announcement="iiwa-ident fake robot, lockstep",
        )

    def send(self, state: int, **changes: Any) -> None:
        """Send the next message."""
        self.counter += 1
        self.time_ms += changes.get("elapsed_ms", changes.get("period", 1))
        self.channel.sendto(self.codec.encode_monitoring(self.message(state, **changes)), self.client)

    def take(self) -> CommandMessage:
        """Wait for one answer and follow it."""
        command = self.codec.decode_command(self.channel.recv(2048))
        self.received.append(command)
        if command.command_data is not None and command.command_data.joint_position is not None:
            self.position = command.command_data.joint_position
        return command

    def exchange(self, state: int, count: int = 1, **changes: Any) -> CommandMessage:
        """Send and take `count` times; the last answer."""
        for _ in range(count):
            self.send(state, **changes)
            command = self.take()
        return command

    def to_active(self) -> None:
        """Through the waiting states to the first command."""
        self.exchange(WAIT, 3)
        self.exchange(READY, 3)
        self.exchange(COMMANDING_WAIT, 5)

    def assert_gentle(self, after_pause: int | None = None) -> None:
        """Every position that reached this robot in command lies one small step after the one before.

        after_pause: counter of the command after which the robot paused and stood, so that the next begins at rest.
        """
        commands = [c for c in self.received if c.command_data is not None]
        stretches = [[c for c in commands if after_pause is None or c.header.sequence_counter <= after_pause]]
        if after_pause is not None:
            stretches.append(commands[len(stretches[0]) - 1 :])
            stretches[1][:0] = [stretches[1][0]] * 2
        for stretch in stretches:
            path = np.array([c.command_data.joint_position for c in stretch if c.command_data is not None])
            assert np.abs(np.diff(path, axis=0)).max() <= 1e-3
            assert np.abs(np.diff(path, n=2, axis=0)).max() <= 1e-5 * 1.5

    def until_done(self, client: Client, limit: int = 20000, **changes: Any) -> None:
        """COMMANDING_ACTIVE, one message after each answer, until the loop has ended."""
        for _ in range(limit):
            self.send(ACTIVE, **changes)
            if not self.take_if_alive(client):
                return
        raise AssertionError("the loop did not end")

    def take_if_alive(self, client: Client) -> bool:
        """Take the answer however long it needs; False where the loop has ended instead."""
        self.channel.settimeout(0.02)
        try:
            while True:
                alive = client.thread.is_alive()
                try:
                    self.take()
                except TimeoutError:
                    if not alive:
                        return False
                else:
                    return True
        finally:
            self.channel.settimeout(60.0)


class SteppedClock:
    """The loop's clock, ns: stands still but for what a test adds to it."""

    def __init__(self) -> None:
        self.now_ns = 1_000_000_000

    def __call__(self) -> int:
        return self.now_ns


class Client:
    """A loop in a thread of its own."""

    def __init__(
        self,
        version: FriVersion,
        settings: LoopSettings,
        slots: int,
        clock_ns: Callable[[], int] = time.monotonic_ns,
        **motion: Any,
    ) -> None:
        self.ring = HandoverRing.create(slots)
        channel = open_channel("127.0.0.1", 0)
        self.address = channel.address

        def make(command_period_s: float, samples_per_command: int) -> MotionProgram:
            options = {"periods": 2, "lead_in_s": 0.1, **motion}
            return MotionProgram(
                short_table(),
                IIWA14_R820,
                command_period_s=command_period_s,
                samples_per_command=samples_per_command,
                **options,
            )

        self.loop = FriLoop(channel, version, make, self.ring, settings, clock_ns)
        self.result: LoopResult | None = None
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.channel = channel
        self.thread.start()

    def _run(self) -> None:
        self.result = self.loop.run()

    def finish(self) -> LoopResult:
        self.thread.join(600.0)
        assert self.result is not None, "the loop did not end"
        return self.result

    def records(self) -> list[HandoverRecord]:
        return self.ring.read_batch(100000)

    def wait_until_heard(self, *, messages: int = 0, undecodable: int = 0) -> None:
        """Until the loop has handed over so many messages and is back in its receive."""
        wanted = (messages, undecodable)
        while (self.ring.status.received, self.ring.status.undecodable) != wanted and self.thread.is_alive():
            threading.Event().wait(0.001)


@contextmanager
def running(
    version: FriVersion = FriVersion.V1_15, settings: LoopSettings | None = None, slots: int = 16384, **motion: Any
) -> Iterator[tuple[Client, Robot]]:
    client = Client(version, settings or LoopSettings(receive_timeout_s=60.0), slots, **motion)
    robot = Robot(client.address, version)
    try:
        yield client, robot
    finally:
        client.loop.stop_from_signal(15)
        client.thread.join(600.0)
        robot.channel.close()
        client.channel.close()
        client.ring.close()


def events(records: list[HandoverRecord]) -> list[int]:
    return [record.event_code for record in records if record.event_code]


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
    assert result.sentence.startswith("Session dropped at cycle 712, ")
    for words in (" s into the motion: ", "in the last second 0 messages missing and longest turn-around "):
        assert words in result.sentence
    assert result.sentence.count(". ") == 0
    assert (result.stop_kind, EventCode.STOP_ON_PATH in events(records)) == ("path", True)
    lost = [record.event_code for record in records].index(EventCode.SESSION_DROP)
    assert {record.phase for record in records[lost:]} == {MotionPhase.LATCHED}
    robot.assert_gentle()
    error = result.error()
    assert error is not None
    assert error.last_samples is not None
    assert error.last_samples.columns["event"].count("SESSION_DROP") == 1


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
    timeouts = LoopSettings(start_timeout_s=0.5, robot_host="127.0.0.9")
    with running(settings=timeouts) as (client, robot):
        robot.send(READY)
        result = client.finish()
    assert (result.outcome, result.foreign) == ("no_robot", 1)


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
        assert client.finish().outcome == "completed"


@pytest.mark.parametrize(("operation", "outcome"), [(2, "not_started"), (0, "completed"), (None, "completed")])
def test_the_first_run_on_an_arm_begins_in_t1_alone(operation: int | None, outcome: str) -> None:
    settings = LoopSettings(receive_timeout_s=60.0, command_timeout_s=0.3, test_mode_only=True)
    with running(settings=settings) as (client, robot):
        robot.exchange(WAIT, 3, operation=operation)
        robot.exchange(COMMANDING_WAIT, 5, operation=operation)
        if outcome == "completed":
            robot.until_done(client, operation=operation)
        while client.thread.is_alive():
            robot.send(ACTIVE, operation=operation)
            robot.take_if_alive(client)
        result = client.finish()
    assert result.outcome == outcome, result.sentence
    assert ("the robot is in AUTOMATIC_MODE" in result.sentence) == (outcome == "not_started")
