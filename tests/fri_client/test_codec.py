"""The codec, claim by claim: what it takes, and what it refuses and why."""

from __future__ import annotations

import struct
import zlib
from typing import Any

import pytest

from fri_client.errors import (
    CodecError,
    FieldNotInVersion,
    InvalidFieldNumber,
    InvalidFieldValue,
    MalformedVarint,
    MessageTooLong,
    MissingRequiredField,
    TextTooLong,
    TruncatedMessage,
    WrongChecksum,
    WrongFrameLength,
    WrongMessageIdentifier,
    WrongValueCount,
    WrongWireType,
)
from fri_client.messages import (
    COMMAND_IDENTIFIER,
    MONITORING_IDENTIFIER,
    CommandData,
    CommandMessage,
    ConnectionInfo,
    EndOfMessageData,
    FriVersion,
    IoValue,
    MessageHeader,
    MonitorData,
    MonitoringMessage,
    QuaternionTransformation,
    RobotInfo,
    TimeStamp,
    Transformation,
)
from fri_client.wire.codec import MAXIMUM_DATAGRAM_BYTES

from .codec_parts import CODECS, HEADER, SEVEN, monitoring, packed, part, same, unpacked

# ---- what is accepted ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", [unpacked, packed, lambda values: unpacked(values[:3]) + packed(values[3:])])
def test_a_joint_array_is_read_packed_unpacked_and_mixed(form: Any) -> None:
    message = monitoring(part(3, part(1, form(SEVEN))))
    assert message.monitor_data is not None
    assert same(message.monitor_data.measured_joint_position, SEVEN)


def test_a_message_of_a_header_alone_has_no_connection_info() -> None:
    message = monitoring()
    assert message == MonitoringMessage(MessageHeader(MONITORING_IDENTIFIER, 900, 450))


def test_fields_may_come_in_any_order() -> None:
    connection = bytes.fromhex("220408041003")
    backwards = CODECS[FriVersion.V1_15].decode_monitoring(connection + HEADER)
    assert backwards == monitoring(connection)
    assert backwards.connection_info == ConnectionInfo(4, 3)


def test_unknown_fields_of_every_wire_type_are_passed_over() -> None:
    unknown = b"\x70\xff\xff\xff\x7f" + b"\x71" + bytes(8) + b"\x72\x03abc" + b"\x75" + bytes(4) + b"\xc2\x0c\x01\x00"
    assert monitoring(unknown) == monitoring()


def test_a_version_passes_over_the_fields_of_another() -> None:
    data = part(3, part(3, unpacked(SEVEN)))
    in_1_15, in_2_5 = monitoring(data).monitor_data, monitoring(data, version=FriVersion.V2_5).monitor_data
    assert in_1_15 is not None
    assert same(in_1_15.commanded_joint_position, SEVEN)
    assert in_2_5 == MonitorData()


def test_numbers_outside_an_enumeration_survive() -> None:
    message = monitoring(bytes.fromhex("22050809" + "10ff01"))
    assert message.connection_info is not None
    assert message.connection_info.session_state == 9
    assert message.connection_info.quality == 255


def test_a_negative_int32_is_a_ten_byte_varint() -> None:
    codec = CODECS[FriVersion.V1_15]
    message = MonitoringMessage(MessageHeader(MONITORING_IDENTIFIER, 900, 450), RobotInfo(number_of_joints=-1))
    datagram = codec.encode_monitoring(message)
    assert datagram == HEADER + bytes.fromhex("120b08ffffffffffffffffff01")
    assert codec.decode_monitoring(datagram) == message


def test_a_sub_message_that_comes_twice_is_merged_and_the_later_scalar_wins() -> None:
    message = monitoring(
        bytes.fromhex("12020801"), bytes.fromhex("120428002807"), bytes.fromhex("120608072802" + "3000")
    )
    with pytest.raises(CodecError):
        monitoring(bytes.fromhex("1204"))
    assert message.robot_info is not None
    assert message.robot_info.number_of_joints == 7
    assert message.robot_info.drive_state == (0, 7, 2)


def test_a_sub_message_that_comes_twice_must_be_complete_each_time() -> None:
    with pytest.raises(MissingRequiredField, match="quality"):
        monitoring(bytes.fromhex("220408041003"), bytes.fromhex("22020801"))


def test_bytearray_and_memoryview_are_read_and_not_kept() -> None:
    data = bytearray(HEADER + part(3, part(1, unpacked(SEVEN))))
    message = CODECS[FriVersion.V1_15].decode_monitoring(memoryview(data))
    before = message.monitor_data
    data[:] = bytes(len(data))
    assert same(message.monitor_data, before)
    assert same(message.monitor_data, MonitorData(measured_joint_position=SEVEN))


def test_a_name_that_is_no_text_is_written_back_as_it_came() -> None:
    io = b"\x0a\x03\xff\xfe\x41\x10\x00\x18\x00"
    message = monitoring(part(3, part(8, io)))
    assert CODECS[FriVersion.V1_15].encode_monitoring(message) == HEADER + part(3, part(8, io))


def test_an_integer_wider_than_its_field_is_cut_to_its_width() -> None:
    """As protobuf and the vendor's decoder have it."""
    message = monitoring(bytes.fromhex("120b08ffffffffffffffffff7f"), bytes.fromhex("220a0803100318818080 8070"))
    assert message.robot_info == RobotInfo(number_of_joints=-1)
    assert message.connection_info == ConnectionInfo(3, 3, send_period=1)


# ---- what is refused -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [0, 1, 3, 6, 8, 13])
@pytest.mark.parametrize("form", [unpacked, packed])
def test_a_joint_array_without_seven_values_is_refused(count: int, form: Any) -> None:
    body = form((1.0,) * count)
    array = bytes([0x0A, len(body)]) + body
    with pytest.raises(WrongValueCount) as caught:
        monitoring(part(3, array) if len(array) < 128 else b"")
    assert (caught.value.field, caught.value.count, caught.value.limit) == ("measuredJointPosition", count, 7)


def test_a_joint_array_that_comes_twice_is_refused() -> None:
    array = part(1, unpacked(SEVEN))
    with pytest.raises(WrongValueCount):
        CODECS[FriVersion.V1_15].decode_monitoring(HEADER + b"\x1a\x82\x01" + array + array)
    with pytest.raises(WrongValueCount):
        monitoring(part(3, array), part(3, array))


def test_eight_drive_states_are_refused() -> None:
    assert monitoring(part(2, b"\x28\x02" * 7)).robot_info == RobotInfo(drive_state=(2,) * 7)
    for form in (b"\x28\x02" * 8, b"\x2a\x08" + b"\x02" * 8):
        with pytest.raises(WrongValueCount):
            monitoring(part(2, form))


def test_every_cut_is_refused_except_between_two_parts() -> None:
    parts = [HEADER, part(2, b"\x28\x02" * 7), part(3, part(1, unpacked(SEVEN))), bytes.fromhex("220408041003")]
    datagram = b"".join(parts)
    boundaries = {sum(map(len, parts[:count])) for count in range(1, len(parts) + 1)}
    for length in range(len(datagram)):
        if length in boundaries:
            CODECS[FriVersion.V1_15].decode_monitoring(datagram[:length])
        else:
            with pytest.raises(TruncatedMessage if length else MissingRequiredField):
                CODECS[FriVersion.V1_15].decode_monitoring(datagram[:length])


def test_every_cut_of_a_framed_datagram_is_refused() -> None:
    codec = CODECS[FriVersion.V2_7]
    datagram = codec.encode_monitoring(monitoring(bytes.fromhex("220408041003")))
    for length in range(len(datagram)):
        with pytest.raises(WrongFrameLength):
            codec.decode_monitoring(datagram[:length])
    with pytest.raises(WrongFrameLength):
        codec.decode_monitoring(datagram + b"\x00")


def test_the_checksum_is_compared_before_the_payload_is_read() -> None:
    nonsense = b"\xff" * 20
    framed = struct.pack("<I", 20) + nonsense + struct.pack("<I", zlib.crc32(nonsense))
    with pytest.raises(MalformedVarint):
        CODECS[FriVersion.V2_7].decode_monitoring(framed)
    with pytest.raises(WrongChecksum) as caught:
        CODECS[FriVersion.V2_7].decode_monitoring(framed[:-1] + bytes([framed[-1] ^ 1]))
    assert caught.value.computed == zlib.crc32(nonsense)


@pytest.mark.parametrize(
    ("tail", "error"),
    [
        (b"\x00", InvalidFieldNumber),
        (b"\x00\x00\x00", InvalidFieldNumber),
        (b"\x80\x80\x80\x80\x80\x01", InvalidFieldNumber),
        (b"\x70" + b"\x80" * 10 + b"\x01", MalformedVarint),
        (b"\x70" + b"\x80" * 9, TruncatedMessage),
        (b"\x73", WrongWireType),
        (b"\x74", WrongWireType),
        (b"\x76\x00", WrongWireType),
        (b"\x77\x00", WrongWireType),
        (b"\x18\x01", WrongWireType),
        (b"\x75\x00\x00\x00", TruncatedMessage),
        (b"\x71\x00\x00\x00", TruncatedMessage),
        (b"\x72\xff\xff\xff\xff\x0f", TruncatedMessage),
        (b"\x72\x81\x80\x80\x80\x80\x00a", MalformedVarint),
        (part(3, part(1, b"\x08\x00")), WrongWireType),
        (part(3, part(1, b"\x0a\x09" + bytes(9))), TruncatedMessage),
        (part(5, b"\x60\x01"), WrongWireType),
        (part(2, b"\x29" + bytes(8)), WrongWireType),
    ],
)
def test_malformed_bytes_after_a_good_header(tail: bytes, error: type[CodecError]) -> None:
    with pytest.raises(error):
        monitoring(tail)


def test_eleven_inputs_six_frames_and_a_name_of_64_bytes_are_refused() -> None:
    io, frame = part(8, b"\x0a\x00\x10\x00\x18\x00"), part(6, b"\x0a\x00")
    assert len(monitoring(part(3, io * 10)).monitor_data.read_io_request) == 10  # type: ignore[union-attr]
    with pytest.raises(WrongValueCount):
        monitoring(part(3, io * 11))
    assert len(monitoring(frame * 5).requested_transformations) == 5
    with pytest.raises(WrongValueCount):
        monitoring(frame * 6)
    monitoring(part(6, part(1, b"n" * 63)))
    with pytest.raises(TextTooLong):
        monitoring(part(6, part(1, b"n" * 64)))


def test_a_command_is_no_monitoring_message() -> None:
    codec = CODECS[FriVersion.V1_15]
    command = codec.encode_command(CommandMessage(MessageHeader(COMMAND_IDENTIFIER, 0, 0)))
    with pytest.raises(WrongMessageIdentifier) as caught:
        codec.decode_monitoring(command)
    assert caught.value.identifier == COMMAND_IDENTIFIER


def test_more_than_the_vendors_buffer_is_refused_both_ways() -> None:
    frames = tuple(Transformation("n" * 63, (0.0,) * 12, TimeStamp(2**32 - 1, 2**32 - 1)) for _ in range(5))
    ios = tuple(IoValue("n" * 63, 1, 1, 2**64 - 1, 1.0) for _ in range(10))
    message = CommandMessage(
        MessageHeader(COMMAND_IDENTIFIER, 0, 0), CommandData(commanded_transformations=frames, write_io_request=ios)
    )
    with pytest.raises(MessageTooLong) as caught:
        CODECS[FriVersion.V1_15].encode_command(message)
    assert caught.value.limit == MAXIMUM_DATAGRAM_BYTES
    with pytest.raises(MessageTooLong):
        CODECS[FriVersion.V1_15].decode_monitoring(bytes(1501))


@pytest.mark.parametrize(
    ("data", "error"),
    [
        (CommandData(joint_position=(0.0,) * 6), WrongValueCount),
        (CommandData(joint_torque=(0.0,) * 8), WrongValueCount),
        (CommandData(cartesian_wrench_feed_forward=(0.0,) * 7), WrongValueCount),
        (CommandData(joint_position=("a",) * 7), InvalidFieldValue),  # type: ignore[arg-type]
        (CommandData(joint_position=3.0), InvalidFieldValue),  # type: ignore[arg-type]
        (CommandData(write_io_request=(IoValue("a", 2**31, 0),)), InvalidFieldValue),
        (CommandData(write_io_request=(IoValue("a", 0, 0, -1),)), InvalidFieldValue),
        (CommandData(write_io_request=(IoValue("a", 0, 0, 2**64),)), InvalidFieldValue),
        (CommandData(write_io_request=(IoValue("a" * 64, 0, 0),)), TextTooLong),
        (CommandData(write_io_request=(IoValue("a", 0, 0),) * 11), WrongValueCount),
        (CommandData(write_io_request=(TimeStamp(0, 0),)), InvalidFieldValue),  # type: ignore[arg-type]
        (CommandData(write_io_request=(IoValue(None, 0, 0),)), MissingRequiredField),  # type: ignore[arg-type]
        (CommandData(cartesian_pose=QuaternionTransformation("")), FieldNotInVersion),
        (CommandData(commanded_transformations=(QuaternionTransformation(""),)), InvalidFieldValue),
    ],
)
def test_what_no_datagram_can_hold_is_not_written(data: CommandData, error: type[CodecError]) -> None:
    with pytest.raises(error):
        CODECS[FriVersion.V1_15].encode_command(CommandMessage(MessageHeader(COMMAND_IDENTIFIER, 0, 0), data))


def test_a_wrong_identifier_is_not_written() -> None:
    for version, codec in CODECS.items():
        with pytest.raises(WrongMessageIdentifier):
            codec.encode_command(CommandMessage(MessageHeader(MONITORING_IDENTIFIER, 0, 0)))
        with pytest.raises(FieldNotInVersion) if version is FriVersion.V2_7 else pytest.raises(InvalidFieldValue):
            codec.encode_monitoring(
                MonitoringMessage(
                    MessageHeader(MONITORING_IDENTIFIER, 0, 0), end_of_message_data=EndOfMessageData(2**31)
                )
            )


@pytest.mark.parametrize("position", [(0.0,) * 6, (0.0,) * 8, (), ("a",) * 7, None, ([],) * 7])
def test_a_position_command_without_seven_numbers_is_not_written(position: Any) -> None:
    with pytest.raises((WrongValueCount, InvalidFieldValue)):
        CODECS[FriVersion.V1_15].encode_position_command(0, 0, position)


@pytest.mark.parametrize("counters", [(-1, 0), (0, -1), (2**32, 0), (0, 2**32)])
def test_a_position_command_needs_uint32_counters(counters: tuple[int, int]) -> None:
    with pytest.raises(InvalidFieldValue):
        CODECS[FriVersion.V1_15].encode_position_command(*counters, (0.0,) * 7)
