"""The robot's side of one session, message by message, over a simulated network and clock; bytes in, bytes out.

What reaches the robot in command is judged by the judge of `fixtures`, which shares no code with the guard.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from fixtures.judge import Judge
from fri_client.handover.motion_phase import MotionPhase
from fri_client.handover.ring import HandoverRing
from fri_client.loop.loop import FriLoop
from fri_client.loop.result import LoopSettings
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
from fri_client.motion.program import MotionProgram
from fri_client.wire.codec import Codec
from safety.limits import IIWA14_R820
from tests.fri_client.simulated_channel import ROBOT, SimulatedChannel, SimulatedClock

REST: tuple[float, ...] = (0.1, 0.3, -0.1, -0.9, 0.2, 0.5, 0.05)
COMMANDED = tuple(q + 0.01 for q in REST)
IDLE, WAIT, READY, COMMANDING_WAIT, ACTIVE = range(5)
MS = 1_000_000


def moved(position: tuple[float, ...], joint: int, by: float) -> tuple[float, ...]:
    return tuple(q + by * (k == joint) for k, q in enumerate(position, start=1))


def table() -> np.ndarray:
    """One period of a sine in every joint, 400 ms."""
    angle = 2 * np.pi * np.arange(400) / 400
    return np.array(REST) + 0.004 * np.outer(np.sin(angle), np.ones(7))


class Robot:
    """One side of a session: says a message, hears what it is answered with, and judges what reaches it in command."""

    def __init__(self, version: FriVersion, **options: Any) -> None:
        self.clock = SimulatedClock()
        self.channel = SimulatedChannel(self.clock)
        self.codec = Codec(version)
        self.version = version
        self.ring = HandoverRing.create(64)
        self.loop = FriLoop(self.channel, version, self._motion, self.ring, LoopSettings(**options), self.clock)
        self.loop._journal.record = lambda *_: None  # type: ignore[method-assign]
        self.judge = Judge(MS)
        self.counter = 40
        self.ipo = self.position = REST
        self.commanded_ns: int | None = None  # when the last position came

    def _motion(self, command_period_s: float, samples_per_command: int) -> MotionProgram:
        return MotionProgram(
            table(), IIWA14_R820, command_period_s=command_period_s, samples_per_command=samples_per_command,
            periods=50, lead_in_s=0.1,
        )  # fmt: skip

    def message(self, state: int, **changes: Any) -> MonitoringMessage:
        ipo = changes.get("ipo", self.ipo if state in (COMMANDING_WAIT, ACTIVE) else None)
        return MonitoringMessage(
            MessageHeader(MONITORING_IDENTIFIER, changes.get("counter", self.counter) & 0xFFFFFFFF, 0),
            RobotInfo(7, changes.get("safety", 0), (2,) * 7, 2, 0),
            MonitorData(
                measured_joint_position=self.position,
                measured_torque=(0.0,) * 7,
                commanded_joint_position=changes.get("commanded", COMMANDED) if self.version.major == 1 else None,
                external_torque=(0.0,) * 7,
            ),
            ConnectionInfo(state, changes.get("quality", 3), 1, 1),
            IpoData(ipo, client_command_mode=1),
            announcement=changes.get("announcement"),
        )

    def say(self, state: int, after_ms: int = 1, **changes: Any) -> CommandMessage | None:
        """The message of so many cycles later; the answer to it."""
        self.counter += after_ms
        self.clock.now += after_ms * MS
        return self.hear(self.message(state, **changes))

    def hear(self, *messages: MonitoringMessage) -> CommandMessage | None:
        """The answer to messages that wait together; what it commands is the robot's set-point from now on."""
        self.channel.inbox.extend((self.codec.encode_monitoring(message), ROBOT) for message in messages)
        sent = len(self.channel.sent)
        while self.channel.inbox:
            size, address = self.channel.receive_into(self.loop._buffer)
            self.loop._receive(size, address, self.clock.now)
        assert len(self.channel.sent) - sent <= 1
        if len(self.channel.sent) == sent:
            return None
        command = self.codec.decode_command(self.channel.sent[-1][1])
        position = command.command_data and command.command_data.joint_position
        if position and self.loop.session.state >= COMMANDING_WAIT:
            self.judge.take(self.clock.now, position)
            self.position, self.commanded_ns = position, self.clock.now
        return command

    @property
    def pause_ms(self) -> float:
        return 0.0 if self.commanded_ns is None else (self.clock.now - self.commanded_ns) / MS

    def to_active(self) -> None:
        for _ in range(8):
            self.say(COMMANDING_WAIT)
        self.judge.begin(self.clock.now + MS, self.ipo)

    def to_motion(self, cycles: int = 600) -> None:
        self.to_active()
        for _ in range(cycles):
            assert position_of(self.say(ACTIVE))
        assert MotionPhase.START_RAMP <= self.loop.motion.phase <= MotionPhase.STOP_RAMP


@contextmanager
def robot(version: FriVersion = FriVersion.V1_15, **options: Any) -> Iterator[Robot]:
    robot = Robot(version, **options)
    try:
        yield robot
    finally:
        robot.ring.close()


def position_of(command: CommandMessage | None) -> tuple[float, ...] | None:
    return None if command is None or command.command_data is None else command.command_data.joint_position
