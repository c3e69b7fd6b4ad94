"""A robot that follows a script, message by message, over a UDP socket, and the loop that answers it in a thread.

Its time is simulated, and it says so: one send period passes from message to message.
"""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fri_client.handover.motion_phase import MotionPhase
from fri_client.handover.ring import HandoverRecord, HandoverRing
from fri_client.loop.channel import UdpChannel
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
        self.channel.settimeout(600.0)

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
                overlay_type=changes.get("overlay", 1),
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
                    if client.ring.status.phase == MotionPhase.LATCHED:
                        self.send(IDLE)  # a robot that is answered no more ends the session
                else:
                    return True
        finally:
            self.channel.settimeout(600.0)


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
        channel = UdpChannel()
        channel.bind("127.0.0.1", 0)
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
