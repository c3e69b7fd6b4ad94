"""Packing of the log's messages into CDR bytes, by structures compiled once.

Here: one pure function per message of `definitions`. Not here: files, clocks, decisions.

Plain CDR (XCDR1), little endian, as ROS 2 writes it: 4 bytes of encapsulation (00 01 00 00), then every primitive
aligned to its own size counted from behind those 4 bytes; a string is its uint32 length including the closing NUL and
its bytes; a sequence is its uint32 count and its elements. The fixed-size parts lie in descending size (8, 4, 1), so
their only padding is in front of the first count. Two independent readers decode these bytes in the tests.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any, NamedTuple

from fri_client.messages import (
    Checksum,
    CommandData,
    CommandMessage,
    ConnectionInfo,
    EndOfMessageData,
    IoValue,
    IpoData,
    MonitorData,
    MonitoringMessage,
    QuaternionTransformation,
    RedundancyInformation,
    RobotInfo,
    Transformation,
)

JOINT_NAMES = tuple(f"iiwa_joint_{joint}" for joint in range(1, 8))

_ENCAPSULATION = b"\x00\x01\x00\x00"
_NAN = float("nan")
_NAN_6, _NAN_7, _NAN_12 = (_NAN,) * 6, (_NAN,) * 7, (_NAN,) * 12
_NO_DRIVES = (-1,) * 7
_NO_ROBOT, _NO_MONITOR, _NO_CONNECTION, _NO_IPO = RobotInfo(), MonitorData(), ConnectionInfo(-1, -1), IpoData()
_NO_COMMAND, _NO_END, _NO_CHECKSUM = CommandData(), EndOfMessageData(), Checksum()
_NO_POSE, _NO_REDUNDANCY = QuaternionTransformation(""), RedundancyInformation(-1, _NAN)

# 65 reals, 2 host times, sample index, 7 counters, 22 integers, 21 flags, padding to 4.
_STATE = struct.Struct("<4s65d2qQ7I22i21?3x")
# 28 reals, 2 host times, sample index, 3 counters, 4 integers, 5 flags, padding to 4.
_COMMAND = struct.Struct("<4s28d2qQ3I4i5?3x")
_EVENT = struct.Struct("<4s2dqQ2i")
_TRANSFORMATION = struct.Struct("<12d3I?")
_IO_VALUE = struct.Struct("<dQ2i2?")
_COUNT = struct.Struct("<I")
_EMPTY_STATE_TAIL = _COUNT.pack(0) * 3
_EMPTY_COMMAND_TAIL = _COUNT.pack(0) * 2
_STATE_COUNTERS = struct.Struct("<Q2I")
_STATE_COUNTERS_OFFSET = 4 + 65 * 8 + 2 * 8  # sample_index, message_identifier, sequence_counter
_INDEX = struct.Struct("<Q")
_COMMAND_INDEX_OFFSET = 4 + 28 * 8 + 2 * 8
_EVENT_INDEX_OFFSET = 4 + 2 * 8 + 8
_STATE_PERIOD = struct.Struct("<i")
_STATE_PERIOD_OFFSET = 4 + 65 * 8 + 3 * 8 + 7 * 4 + 20 * 4
_OUT_OF_ORDER_OFFSET = _STATE_PERIOD_OFFSET + 2 * 4 + 19


class SampleLabels(NamedTuple):
    """What the host adds to a message: times (UNIX ns), index, motion labels and how the message was judged."""

    receive_time_ns: int
    send_time_ns: int
    sample_index: int
    motion_phase: int
    period: int
    sample_in_period: int
    answered: bool
    duplicate: bool
    out_of_order: bool
    non_finite: bool


class LoggedEvent(NamedTuple):
    """One message of /run/events; host_time_ns: UNIX; joint counts from 1, 0 = none."""

    code: int
    name: str
    sentence: str
    host_time_ns: int
    sample_index: int = 0
    joint: int = 0
    value: float = _NAN
    limit: float = _NAN


class DiagnosticStatus(NamedTuple):
    """One entry of /diagnostics: level 0 OK, 1 warning, 2 error, 3 stale."""

    level: int
    name: str
    message: str
    values: tuple[tuple[str, str], ...]


def pack_fri_state(message: MonitoringMessage, labels: SampleLabels) -> bytes:
    """CDR of iiwa_ident_msgs/msg/FriState: the message as decoded, vendor's sign and units (PROTOCOL §3, §11)."""
    header, robot, end = message.header, message.robot_info or _NO_ROBOT, message.end_of_message_data or _NO_END
    monitor, ipo = message.monitor_data or _NO_MONITOR, message.ipo_data or _NO_IPO
    connection, stamp = message.connection_info or _NO_CONNECTION, monitor.timestamp
    pose, ipo_pose, tracking = monitor.measured_cartesian_pose, ipo.cartesian_pose, ipo.tracking_performance
    redundancy = monitor.measured_redundancy_information or _NO_REDUNDANCY
    ipo_redundancy = ipo.redundancy_information or _NO_REDUNDANCY
    joints = (
        monitor.measured_joint_position, monitor.measured_torque, monitor.commanded_joint_position,
        monitor.commanded_torque, monitor.external_torque, ipo.joint_position,
    )  # fmt: skip
    ends = end.message_length, (end.message_checksum or _NO_CHECKSUM).crc32
    flagged = (
        *joints, monitor.external_force, pose, ipo_pose, monitor.measured_redundancy_information,
        ipo.redundancy_information, tracking, stamp, connection.send_period, connection.receive_multiplier, *ends,
    )  # fmt: skip
    fixed = _STATE.pack(
        _ENCAPSULATION, *(joints[0] or _NAN_7), *(joints[1] or _NAN_7), *(joints[2] or _NAN_7),
        *(joints[3] or _NAN_7), *(joints[4] or _NAN_7), *(joints[5] or _NAN_7),
        *_padded(monitor.external_force, _NAN_6), *_padded((pose or _NO_POSE).element, _NAN_7),
        *_padded((ipo_pose or _NO_POSE).element, _NAN_7), redundancy.value, ipo_redundancy.value,
        _NAN if tracking is None else tracking,
        *labels[:3], header.message_identifier, header.sequence_counter, header.reflected_sequence_counter,
        *((0, 0) if stamp is None else (stamp.sec, stamp.nanosec)),
        connection.send_period or 0, connection.receive_multiplier or 0,
        *_integers(
            robot.number_of_joints, connection.session_state, connection.quality, robot.safety_state,
            robot.operation_mode, robot.control_mode, ipo.client_command_mode, ipo.overlay_type,
        ),
        redundancy.strategy, ipo_redundancy.strategy, *_padded(robot.drive_state, _NO_DRIVES), *_integers(*ends),
        *labels[3:6], *[item is not None for item in flagged], *labels[6:],
    )  # fmt: skip
    if not monitor.read_io_request and not message.requested_transformations and pose is None and ipo_pose is None:
        return fixed + _EMPTY_STATE_TAIL
    tail = bytearray(fixed)
    _append_io_values(tail, monitor.read_io_request)
    _append_transformations(tail, message.requested_transformations)
    _append_transformations(tail, [each for each in (pose, ipo_pose) if each is not None])
    return bytes(tail)


def pack_fri_command(message: CommandMessage, labels: SampleLabels) -> bytes:
    """CDR of iiwa_ident_msgs/msg/FriCommand: the command as it was sent, vendor's sign and units."""
    header, command = message.header, message.command_data or _NO_COMMAND
    joints, wrench = (command.joint_position, command.joint_torque), command.cartesian_wrench_feed_forward
    pose, redundancy = command.cartesian_pose, command.redundancy_information or _NO_REDUNDANCY
    flagged = *joints, wrench, pose, command.redundancy_information
    fixed = _COMMAND.pack(
        _ENCAPSULATION, *(joints[0] or _NAN_7), *(joints[1] or _NAN_7), *_padded(wrench, _NAN_6),
        *_padded((pose or _NO_POSE).element, _NAN_7), redundancy.value,
        *labels[:3], header.message_identifier, header.sequence_counter, header.reflected_sequence_counter,
        redundancy.strategy, *labels[3:6], *[item is not None for item in flagged],
    )  # fmt: skip
    if not command.write_io_request and not command.commanded_transformations:
        return fixed + _EMPTY_COMMAND_TAIL
    tail = bytearray(fixed)
    _append_io_values(tail, command.write_io_request)
    _append_transformations(tail, command.commanded_transformations)
    return bytes(tail)


def _padded(values: tuple[Any, ...] | None, filler: tuple[Any, ...]) -> tuple[Any, ...]:
    """As many as the filler has, which stands where there are none."""
    return (*(values or ()), *filler)[: len(filler)]


def _integers(*values: int | None) -> list[int]:
    """-1 where there is none."""
    return [-1 if value is None else value for value in values]


def _joint_state_names() -> bytes:
    """Header's empty frame_id and the joint names, from byte 8 of the message to the count of `position`."""
    part = bytearray(_ENCAPSULATION + bytes(8))
    _append_string(part, "")
    _append_count(part, len(JOINT_NAMES))
    for name in JOINT_NAMES:
        _append_string(part, name)
    _append_count(part, len(JOINT_NAMES))
    return bytes(part[12:])


def pack_joint_state(
    stamp_ns: int, position: Sequence[float], velocity: Sequence[float], effort: Sequence[float]
) -> bytes:
    """CDR of sensor_msgs/msg/JointState of the 7 joints: rad, rad/s, Nm; stamp in UNIX ns."""
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    return _JOINT_STATE.pack(
        _ENCAPSULATION, seconds, nanoseconds, _JOINT_STATE_NAMES, *position, 7, *velocity, 7, *effort
    )


def pack_event(event: LoggedEvent) -> bytes:
    """CDR of iiwa_ident_msgs/msg/RunEvent."""
    code, name, sentence, host_time_ns, sample_index, joint, value, limit = event
    data = bytearray(_EVENT.pack(_ENCAPSULATION, value, limit, host_time_ns, sample_index, code, joint))
    _append_string(data, name)
    _append_string(data, sentence)
    return bytes(data)


def pack_string(text: str) -> bytes:
    """CDR of std_msgs/msg/String."""
    data = bytearray(_ENCAPSULATION)
    _append_string(data, text)
    return bytes(data)


def pack_diagnostics(stamp_ns: int, statuses: Sequence[DiagnosticStatus], hardware: str) -> bytes:
    """CDR of diagnostic_msgs/msg/DiagnosticArray; stamp in UNIX ns."""
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    data = bytearray(_ENCAPSULATION + struct.pack("<iI", seconds, nanoseconds))
    _append_string(data, "")
    _append_count(data, len(statuses))
    for status in statuses:
        data.append(status.level)
        _append_string(data, status.name)
        _append_string(data, status.message)
        _append_string(data, hardware)
        _append_count(data, len(status.values))
        for key, value in status.values:
            _append_string(data, key)
            _append_string(data, value)
    return bytes(data)


def state_counters(fri_state: bytes) -> tuple[int, int, int]:
    """sample_index, sequence_counter and period of a packed FriState, without decoding the rest.

    Raises struct.error when the bytes are too few to be one.
    """
    sample_index, _, sequence_counter = _STATE_COUNTERS.unpack_from(fri_state, _STATE_COUNTERS_OFFSET)
    (period,) = _STATE_PERIOD.unpack_from(fri_state, _STATE_PERIOD_OFFSET)
    return sample_index, sequence_counter, period


def is_out_of_order(fri_state: bytes) -> bool:
    """The flag of a packed FriState that is long enough for `state_counters`: old, or a counter that was refused."""
    return len(fri_state) > _OUT_OF_ORDER_OFFSET and bool(fri_state[_OUT_OF_ORDER_OFFSET])


def command_index(fri_command: bytes) -> int:
    """sample_index of a packed FriCommand. Raises struct.error when the bytes are too few to be one."""
    (index,) = _INDEX.unpack_from(fri_command, _COMMAND_INDEX_OFFSET)
    return int(index)


def event_index(run_event: bytes) -> int:
    """sample_index of a packed RunEvent. Raises struct.error when the bytes are too few to be one."""
    (index,) = _INDEX.unpack_from(run_event, _EVENT_INDEX_OFFSET)
    return int(index)


def _align(data: bytearray, size: int) -> None:
    data.extend(bytes(-(len(data) - len(_ENCAPSULATION)) % size))


def _append_count(data: bytearray, count: int) -> None:
    _align(data, 4)
    data += _COUNT.pack(count)


def _append_string(data: bytearray, text: str) -> None:
    encoded = text.encode("utf-8", errors="replace").replace(b"\x00", b"") + b"\x00"
    _append_count(data, len(encoded))
    data += encoded


def _append_io_values(data: bytearray, values: Sequence[IoValue]) -> None:
    _append_count(data, len(values))
    for value in values:
        _align(data, 8)
        data += _IO_VALUE.pack(
            _NAN if value.analog_value is None else value.analog_value,
            value.digital_value or 0,
            value.type,
            value.direction,
            value.digital_value is not None,
            value.analog_value is not None,
        )
        _append_string(data, value.name)


def _append_transformations(
    data: bytearray, transformations: Sequence[Transformation | QuaternionTransformation]
) -> None:
    _append_count(data, len(transformations))
    for transformation in transformations:
        elements = transformation.matrix if isinstance(transformation, Transformation) else transformation.element
        stamp = transformation.timestamp
        _align(data, 8)
        data += _TRANSFORMATION.pack(
            *(*elements, *_NAN_12)[:12],
            len(elements),
            0 if stamp is None else stamp.sec,
            0 if stamp is None else stamp.nanosec,
            stamp is not None,
        )
        _append_string(data, transformation.name)


_JOINT_STATE_NAMES = _joint_state_names()
_JOINT_STATE = struct.Struct(f"<4siI{len(_JOINT_STATE_NAMES)}s4x7dI4x7dI4x7d")
