"""The loop against a robot written out in this file: a UDP socket that follows a script, message by message."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
import pytest

from fri_client.codec import Codec
from fri_client.handover import HandoverRecord, HandoverRing
from fri_client.loop import FriLoop, open_socket
from fri_client.loop_result import LoopResult, LoopSettings
from fri_client.messages import (
    MONITORING_IDENTIFIER,
    CommandMessage,
    ConnectionInfo,
    FriVersion,
    IpoData,
    MessageHeader,
    MonitorData,
    MonitoringMessage,
    RobotInfo,
)
from fri_client.motion import MotionPhase, MotionProgram
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
    position: tuple[float, ...] = REST
    received: list[CommandMessage] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.codec = Codec(self.version)
        self.channel = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.channel.bind(("127.0.0.1", 0))
        self.channel.settimeout(5.0)

    def message(self, state: int, **changes: object) -> MonitoringMessage:
        monitor = MonitorData(
            measured_joint_position=changes.get("measured", self.position),
            measured_torque=(0.0,) * 7,
            commanded_joint_position=self.position if self.version.major == 1 else None,
            external_torque=changes.get("external", (0.0,) * 7),
        )
        return MonitoringMessage(
            MessageHeader(MONITORING_IDENTIFIER, self.counter, 0),
            RobotInfo(7, changes.get("safety", 0), (2,) * 7, 2, 0),
            monitor,
            ConnectionInfo(state, changes.get("quality", 3), 1, changes.get("multiplier", 1)),
            IpoData(joint_position=REST if state >= COMMANDING_WAIT else None, client_command_mode=1),
        )

    def send(self, state: int, **changes: object) -> None:
        """Send the next message."""
        self.counter += 1
        self.channel.sendto(self.codec.encode_monitoring(self.message(state, **changes)), self.client)

    def take(self) -> CommandMessage:
        """Wait for one answer and follow it."""
        command = self.codec.decode_command(self.channel.recv(2048))
        self.received.append(command)
        if command.command_data is not None and command.command_data.joint_position is not None:
            self.position = command.command_data.joint_position
        return command

    def exchange(self, state: int, count: int = 1, **changes: object) -> CommandMessage:
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

    def until_done(self, client: Client, limit: int = 20000) -> None:
        """COMMANDING_ACTIVE until the loop has ended."""
        for _ in range(limit):
            self.send(ACTIVE)
            self.channel.settimeout(0.02)
            try:
                self.take()
            except TimeoutError:
                if not client.thread.is_alive():
                    return
        raise AssertionError("the loop did not end")


class Client:
    """A loop in a thread of its own."""

    def __init__(self, version: FriVersion, settings: LoopSettings, **motion: object) -> None:
        self.ring = HandoverRing.create(16384)
        channel = open_socket("127.0.0.1", 0)
        self.address = channel.getsockname()

        def make(command_period_s: float, samples_per_command: int) -> MotionProgram:
            options = {"periods": 2, "lead_in_s": 0.1, **motion}
            return MotionProgram(
                short_table(),
                IIWA14_R820,
                command_period_s=command_period_s,
                samples_per_command=samples_per_command,
                **options,
            )

        self.loop = FriLoop(channel, version, make, self.ring, settings)
        self.result: LoopResult | None = None
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.channel = channel
        self.thread.start()

    def _run(self) -> None:
        self.result = self.loop.run()

    def finish(self) -> LoopResult:
        self.thread.join(20.0)
        assert self.result is not None, "the loop did not end"
        return self.result

    def records(self) -> list[HandoverRecord]:
        return self.ring.read_batch(100000)


@contextmanager
def running(
    version: FriVersion = FriVersion.V1_15, settings: LoopSettings | None = None, **motion: object
) -> Iterator[tuple[Client, Robot]]:
    client = Client(version, settings or LoopSettings(receive_timeout_s=2.0), **motion)
    robot = Robot(client.address, version)
    try:
        yield client, robot
    finally:
        client.loop.stop_from_signal(15)
        client.thread.join(10.0)
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
