"""Two loops that hear the same datagrams: one as it is, the other without any answer made ready, as the oracle.

What was sent is moreover held against the datagrams themselves: counters, and seven finite positions.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from fri_client.handover.ring import HandoverRing
from fri_client.loop.answer_ahead import AnswerAhead
from fri_client.loop.channel import Address
from fri_client.loop.loop import FriLoop
from fri_client.loop.result import LoopSettings
from fri_client.messages import (
    MONITORING_IDENTIFIER,
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
from tests.fri_client.simulated_channel import ROBOT, SimulatedChannel, SimulatedClock

REST = (0.1, 0.3, -0.1, -0.9, 0.2, 0.5, 0.05)
COMMANDING_WAIT, ACTIVE = 3, 4
PERIOD_NS = 1_000_000


def table() -> np.ndarray:
    """One period of a sine in every joint, 400 ms."""
    angle = 2 * np.pi * np.arange(400) / 400
    return np.array(REST) + 0.004 * np.outer(np.sin(angle), np.ones(7))


class NothingReady(AnswerAhead):
    """Never has an answer."""

    def command_for(self, _: bytes) -> bytes | None:
        return None


class Bench:
    """Two loops: `ahead` as it is, `plain` without any answer made ready."""

    def __init__(self, version: FriVersion) -> None:
        self.clock = SimulatedClock()
        self.codec = Codec(version)
        self.version = version
        self.channels = [SimulatedChannel(self.clock), SimulatedChannel(self.clock)]
        self.loops = [self._loop(channel) for channel in self.channels]
        self.ahead, self.plain = self.loops
        self.plain._ahead = NothingReady(self.plain._codec)
        self.used = 0
        answer_ahead = self.ahead._answer_ahead

        def counted(*arguments: Any) -> bool:
            used = answer_ahead(*arguments)
            self.used += used
            return used

        self.ahead._answer_ahead = counted  # type: ignore[method-assign]
        self.counter, self.position, self.state, self.quality = 120, REST, ACTIVE, 3
        self.answers = 0
        self.outcomes: list[str | None] = [None, None]

    def _loop(self, channel: SimulatedChannel) -> FriLoop:
        def make(command_period_s: float, samples_per_command: int) -> MotionProgram:
            return MotionProgram(
                table(), IIWA14_R820, command_period_s=command_period_s, samples_per_command=samples_per_command,
                periods=2, lead_in_s=0.1, external_torque_limit=(30.0,) * 7,
            )  # fmt: skip

        ring = HandoverRing.create(64)
        loop = FriLoop(channel, self.version, make, ring, LoopSettings(receive_timeout_s=0.5), self.clock)
        loop._journal.record = lambda *_: None  # type: ignore[method-assign]
        return loop

    def message(self, **changes: Any) -> MonitoringMessage:
        first = self.version.major == 1
        return MonitoringMessage(
            MessageHeader(MONITORING_IDENTIFIER, self.counter, changes.get("reflected", self.answers)),
            RobotInfo(7, changes.get("safety", 0), changes.get("drives", (2,) * 7), 2, changes.get("control", 0)),
            MonitorData(
                changes.get("measured", self.position), changes.get("torque", (0.1,) * 7),
                changes.get("commanded", self.position) if first else None, (0.0,) * 7,
                changes.get("external", (0.0,) * 7),
                timestamp=TimeStamp(self.clock.now // 10**9, self.clock.now % 10**9),
            ),
            ConnectionInfo(self.state, self.quality, changes.get("period", 1), 1),
            IpoData(changes.get("ipo", REST) if self.state >= COMMANDING_WAIT else None, client_command_mode=1),
        )  # fmt: skip

    def next_datagram(self, **changes: Any) -> bytes:
        self.counter = self.counter + 1 & 0xFFFFFFFF
        return self.codec.encode_monitoring(self.message(**changes))

    def deliver(self, *datagrams: bytes, sender: Address = ROBOT) -> list[tuple[bytes, ...]]:
        """All datagrams wait for both loops before either looks; the answers of each loop, in order."""
        self.clock.now += PERIOD_NS
        answers: list[tuple[bytes, ...]] = []
        for index, (loop, channel) in enumerate(zip(self.loops, self.channels, strict=True)):
            for datagram in datagrams:
                # The loop rehearses on the message before; on the very next one, or on garbage, it must not matter.
                loop._ahead.rehearse(datagram)
                channel.inbox.append((datagram, sender))
            while channel.inbox:
                size, address = channel.receive_into(loop._buffer)
                try:
                    loop._receive(size, address, self.clock.now)
                except Exception as error:
                    loop._survive(error)
            assert all(address == ROBOT for _, _, address in channel.sent)
            answers.append(tuple(data for _, data, _ in channel.sent))
            channel.sent.clear()
            self.outcomes[index] = loop._ending.outcome(
                self.clock.now, 0, loop._faults, silent=loop._silence_told, unusable=False
            )
        assert answers[0] == answers[1]
        assert self.outcomes[0] == self.outcomes[1]
        for command in map(self.codec.decode_command, answers[0]):
            assert command.header.sequence_counter == self.answers
            self.answers += 1
            if command.command_data is not None and command.command_data.joint_position is not None:
                assert len(command.command_data.joint_position) == 7
                assert all(map(math.isfinite, command.command_data.joint_position))
                if self.state == ACTIVE:
                    self.position = command.command_data.joint_position
        return answers

    def both(self, act: Any) -> None:
        for loop in self.loops:
            act(loop)

    def start(self) -> None:
        """Through COMMANDING_WAIT to the first commands."""
        self.state = COMMANDING_WAIT
        for _ in range(5):
            self.deliver(self.next_datagram())
        self.state = ACTIVE
        self.drive(3)

    def drive(self, count: int) -> None:
        """So many good messages, each answered under its counter."""
        for _ in range(count):
            (answers, _) = self.deliver(self.next_datagram())
            assert [self.codec.decode_command(a).header.reflected_sequence_counter for a in answers] == [self.counter]

    @property
    def over(self) -> bool:
        return self.outcomes[0] is not None

    def close(self) -> None:
        for loop in self.loops:
            loop._ring.close()
