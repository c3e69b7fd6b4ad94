"""Datagrams to messages and back, for one FRI version.

Here: `Codec`, the door to everything below it: size limit, frame (2.7), payload, message identifier. Not here: the
tables (`schema`), the bytes (`reader`, `layout`, `writer`, `wire`, `frame`), any judgement of what a message says: the
codec is faithful to NaN and infinities and to a message without connection_info; the session judges.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Iterator, Sequence
from typing import cast

from msgspec.structs import replace

from fri_client.errors import InvalidFieldValue, MessageTooLong, WrongMessageIdentifier, WrongValueCount
from fri_client.messages import (
    COMMAND_IDENTIFIER,
    JOINT_COUNT,
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
from fri_client.wire.frame import FRAME_BYTES, framed, unframed
from fri_client.wire.glance import Glance
from fri_client.wire.layout import LayoutBook
from fri_client.wire.primitives import varint
from fri_client.wire.reader import GroupReader
from fri_client.wire.writer import GroupWriter, joint_values

MAXIMUM_DATAGRAM_BYTES = 1500
"""Size of the vendor's receive and send buffers (PROTOCOL section 1); 2.7 leaves 1492 for the payload."""

_POSITION_HEADER = b"\x08" + varint(COMMAND_IDENTIFIER) + b"\x10"
_POSITION_BODY = b"\x12\x41\x0a\x3f"
_MOST_PUT_OFF = 40
_WARM_UP_ROUNDS = 30
"""The interpreter specialises a function within some 20 calls."""

_NANOSECONDS_OF_EVERY_WIDTH = tuple(1 << 7 * width for width in range(5))


class Codec:
    """Encodes and decodes both kinds of message in one version.

    Keeps the shapes of datagrams it has read (see `layout`), never a value of one: what a datagram decodes to does not
    depend on what was decoded before.

    learn_later: a shape costs 0.15 ms to learn, so who has no time while decoding says True and calls `catch_up` after.
    """

    def __init__(self, version: FriVersion, *, learn_later: bool = False) -> None:
        self.version = FriVersion(version)
        self._framed = self.version.is_framed
        self._monitoring_reader = GroupReader(MonitoringMessage, self.version)
        self._monitoring_layouts = LayoutBook(MonitoringMessage, self.version)
        self._monitoring_writer = GroupWriter(MonitoringMessage, self.version)
        self._learn_later = learn_later
        self._unlearned: deque[MonitoringMessage] = deque()
        self._command_reader = GroupReader(CommandMessage, self.version)
        self._command_layouts = LayoutBook(CommandMessage, self.version)
        self._command_writer = GroupWriter(CommandMessage, self.version)

    def decode_monitoring(self, data: bytes | bytearray | memoryview) -> MonitoringMessage:
        """The monitoring message in one datagram, in fresh storage. Raises CodecError subclasses and nothing else."""
        payload = self._payload(data)
        message = self._monitoring_layouts.read(payload)
        if message is None:
            message = self._monitoring_reader.read(payload, 0, len(payload))
            _check_identifier(message.header.message_identifier, MONITORING_IDENTIFIER)
            if self._learn_later:
                self._put_off(cast(MonitoringMessage, message))
            else:
                self._monitoring_layouts.learn(payload, message)
        return cast(MonitoringMessage, message)

    def warm_up(self) -> None:
        """Go a few times through what a tick needs, so that its first time, when it counts, is not the slowest."""
        zero = (0.0,) * JOINT_COUNT
        commanded = zero if self.version.major == 1 else None
        message = MonitoringMessage(
            MessageHeader(MONITORING_IDENTIFIER, 1, 1),
            RobotInfo(JOINT_COUNT, 0, (0,) * JOINT_COUNT, 0, 0),
            MonitorData(zero, zero, commanded, zero, zero, timestamp=TimeStamp(1, 1)),
            ConnectionInfo(0, 0, 1, 1),
            IpoData(zero, client_command_mode=1, overlay_type=1, tracking_performance=1.0),
        )
        datagram = memoryview(self.encode_monitoring(message))
        glance = self.glance(datagram, message)
        assert glance is not None
        for _ in range(_WARM_UP_ROUNDS):
            self.decode_monitoring(datagram)
            self.catch_up()
            glance.read(self._payload(datagram), b"\x01")
            self.encode_position_command(1, 1, zero)

    def catch_up(self) -> None:
        """Learn one shape of those put off (0.2 ms), if there is one: of a message that came, then of its relatives."""
        if self._unlearned:
            message = self._unlearned.popleft()
            payload = self._monitoring_writer.write(message)
            if self._monitoring_layouts.read(payload) is None:
                self._monitoring_layouts.learn(payload, message)

    def glance(self, data: bytes | bytearray | memoryview, message: MonitoringMessage) -> Glance | None:
        """The look at datagrams like this one, which was decoded as `message`; see `glance`."""
        return Glance.at(self._payload(data), message, self.version)

    def decode_command(self, data: bytes | bytearray | memoryview) -> CommandMessage:
        """The command message in one datagram, in fresh storage. Raises CodecError subclasses and nothing else."""
        payload = self._payload(data)
        message = self._command_layouts.read(payload)
        if message is None:
            message = self._command_reader.read(payload, 0, len(payload))
            _check_identifier(message.header.message_identifier, COMMAND_IDENTIFIER)
            self._command_layouts.learn(payload, message)
        return cast(CommandMessage, message)

    def encode_monitoring(self, message: MonitoringMessage) -> bytes:
        """The datagram a robot of this version would send. Raises CodecError subclasses and nothing else."""
        payload = self._monitoring_writer.write(message)
        _check_identifier(message.header.message_identifier, MONITORING_IDENTIFIER)
        return self._datagram(payload)

    def encode_command(self, message: CommandMessage) -> bytes:
        """The datagram the vendor's client of this version would send. Raises CodecError subclasses only."""
        payload = self._command_writer.write(message)
        _check_identifier(message.header.message_identifier, COMMAND_IDENTIFIER)
        return self._datagram(payload)

    def encode_position_command(
        self, sequence_counter: int, reflected_sequence_counter: int, position: Sequence[float]
    ) -> bytes:
        """The datagram of a command with 7 joint positions (rad) and nothing else: `encode_command`, but quicker.

        Raises WrongValueCount, InvalidFieldValue.
        """
        if not (0 <= sequence_counter < 1 << 32 and 0 <= reflected_sequence_counter < 1 << 32):
            raise InvalidFieldValue(
                message="MessageHeader",
                field="sequenceCounter",
                value=(sequence_counter, reflected_sequence_counter),
                expected="an integer from 0 to 2^32 - 1",
            )
        try:
            values = joint_values(position)
        except (TypeError, ValueError, struct.error) as error:
            if hasattr(position, "__len__") and len(position) != JOINT_COUNT:
                raise WrongValueCount(
                    message="MessageCommandData",
                    field="jointPosition",
                    count=len(position),
                    limit=JOINT_COUNT,
                    exact=True,
                ) from error
            raise InvalidFieldValue(
                message="MessageCommandData", field="jointPosition", value=position, expected="7 numbers"
            ) from error
        header = b"".join((_POSITION_HEADER, varint(sequence_counter), b"\x18", varint(reflected_sequence_counter)))
        payload = b"".join((b"\x0a", varint(len(header)), header, _POSITION_BODY, values))
        return framed(payload) if self._framed else payload

    def _put_off(self, message: MonitoringMessage) -> None:
        """Keep a message whose shape is new, and those that differ from it in the width of a counter or time only."""
        if len(self._unlearned) < _MOST_PUT_OFF:
            self._unlearned.append(message)
            self._unlearned.extend(_relatives(message))

    def _payload(self, data: bytes | bytearray | memoryview) -> bytes:
        if len(data) > MAXIMUM_DATAGRAM_BYTES:
            raise MessageTooLong(length=len(data), limit=MAXIMUM_DATAGRAM_BYTES)
        datagram = bytes(data)
        return unframed(datagram) if self._framed else datagram

    def _datagram(self, payload: bytes) -> bytes:
        length = len(payload) + (FRAME_BYTES if self._framed else 0)
        if length > MAXIMUM_DATAGRAM_BYTES:
            raise MessageTooLong(length=length, limit=MAXIMUM_DATAGRAM_BYTES)
        return framed(payload) if self._framed else payload


def _relatives(message: MonitoringMessage) -> Iterator[MonitoringMessage]:
    """The same message with the widths its counters and its time stamp will have soon."""
    header, monitor = message.header, message.monitor_data
    time = None if monitor is None else monitor.timestamp
    counters = (header.sequence_counter, header.reflected_sequence_counter)
    widths = [len(varint(counter)) for counter in counters]
    for wider in ((0, 0), (0, 1), (1, 0), (1, 1)):
        ahead = [1 << 7 * (width - 1 + more) for width, more in zip(widths, wider, strict=True)]
        if max(ahead) >= 1 << 32:
            continue
        changed = replace(message, header=MessageHeader(header.message_identifier, *ahead))
        if monitor is None or time is None:
            yield changed
            continue
        for nanosec in _NANOSECONDS_OF_EVERY_WIDTH:
            stamped = replace(monitor, timestamp=replace(time, nanosec=nanosec))
            yield replace(changed, monitor_data=stamped)


def _check_identifier(identifier: int, expected: int) -> None:
    if identifier != expected:
        raise WrongMessageIdentifier(identifier=identifier, expected=expected)
