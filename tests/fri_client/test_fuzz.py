"""Over 100 000 random and damaged datagrams: the typed error and no other, no trace left, agreement with protobuf.

The truth is google.protobuf, given its own field tables below (written from section 3 of the protocol sheet, not from
the tables under test). Where it accepts more than FRI does, the difference is named.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import DecodeError as ProtobufDecodeError

from fri_client.errors import (
    CodecError,
    InvalidFieldNumber,
    MissingRequiredField,
    TextTooLong,
    TruncatedMessage,
    WrongMessageIdentifier,
    WrongValueCount,
    WrongWireType,
)
from fri_client.messages import CommandMessage, FriVersion, MonitoringMessage
from fri_client.wire.codec import Codec
from tests.reference import golden_datagrams

VECTORS = golden_datagrams()
SEED = 20240117
DATAGRAMS_PER_CASE = 18_000
BATCH = 500

# name number type: q required, o optional, r repeated, p repeated packed. Enumerations are int32, so that a value
# outside of them is kept; names are bytes, since nanopb does not look at their encoding.
COMMON = {
    "Header": "q1:uint32 q2:uint32 q3:uint32",
    "RobotInfo": "o1:int32 o2:int32 r5:int32 o6:int32 o7:int32",
    "ConnectionInfo": "q1:int32 q2:int32 o3:uint32 o4:uint32",
    "Joints": "r1:double",
    "Vector": "p1:double",
    "TimeStamp": "q1:uint32 q2:uint32",
    "Io": "q1:bytes q2:int32 q3:int32 o4:uint64 o5:double",
    "Frame": "q1:bytes p2:double o3:TimeStamp",
    "Redundancy": "q1:int32 q2:double",
    "Checksum": "o1:int32",
    "End": "o1:int32 o2:Checksum",
}
MONITORING = "q1:Header o2:RobotInfo o3:Data o4:ConnectionInfo o5:Ipo r6:Frame"
ANNOUNCEMENT = "o2047:bytes"  # ours, of the fake robot
COMMAND = "q1:Header o2:Command"
BY_VERSION = {
    "1.15": {
        "Data": "o1:Joints o2:Joints o3:Joints o4:Joints o5:Joints r8:Io o15:TimeStamp",
        "Ipo": "o1:Joints o10:int32 o11:int32 o12:double",
        "Command": "o1:Joints o2:Vector o3:Joints r4:Frame r5:Io",
        "monitoring": f"{MONITORING} o15:End {ANNOUNCEMENT}",
        "command": f"{COMMAND} o15:End",
    },
    "2.5": {
        "Data": "o1:Joints o2:Joints o4:Joints o5:Joints r8:Io o9:Frame o10:Redundancy o15:TimeStamp",
        "Ipo": "o1:Joints o2:Frame o3:Redundancy o10:int32 o11:int32 o12:double",
        "Command": "o1:Joints o2:Vector o3:Joints r4:Frame r5:Io o6:Frame o7:Redundancy",
        "monitoring": f"{MONITORING} o15:End {ANNOUNCEMENT}",
        "command": f"{COMMAND} o15:End",
    },
    "2.7": {
        "Data": "o1:Joints o2:Joints o4:Joints o5:Joints o6:Vector r8:Io o9:Frame o10:Redundancy o15:TimeStamp",
        "Ipo": "o1:Joints o2:Frame o3:Redundancy o10:int32 o11:int32 o12:double",
        "Command": "o1:Joints o2:Vector o3:Joints r4:Frame r5:Io o6:Frame o7:Redundancy",
        "monitoring": f"{MONITORING} {ANNOUNCEMENT}",
        "command": COMMAND,
    },
}
TYPES = {
    "double": descriptor_pb2.FieldDescriptorProto.TYPE_DOUBLE,
    "int32": descriptor_pb2.FieldDescriptorProto.TYPE_INT32,
    "uint32": descriptor_pb2.FieldDescriptorProto.TYPE_UINT32,
    "uint64": descriptor_pb2.FieldDescriptorProto.TYPE_UINT64,
    "bytes": descriptor_pb2.FieldDescriptorProto.TYPE_BYTES,
}
LABELS = {
    "q": descriptor_pb2.FieldDescriptorProto.LABEL_REQUIRED,
    "o": descriptor_pb2.FieldDescriptorProto.LABEL_OPTIONAL,
    "r": descriptor_pb2.FieldDescriptorProto.LABEL_REPEATED,
    "p": descriptor_pb2.FieldDescriptorProto.LABEL_REPEATED,
}


def protobuf_class(version: str, direction: str) -> Any:
    """The protobuf message class of one direction, built from the tables above."""
    package = f"reference_{version.replace('.', '_')}_{direction}"
    file = descriptor_pb2.FileDescriptorProto(name=f"{package}.proto", package=package, syntax="proto2")
    tables = COMMON | BY_VERSION[version]
    for name, row in tables.items():
        message = file.message_type.add(name=name)
        for text in row.split():
            number, kind = text[1:].split(":")
            field = message.field.add(name=f"f{number}", number=int(number), label=LABELS[text[0]])
            if kind in TYPES:
                field.type = TYPES[kind]
            else:
                field.type = descriptor_pb2.FieldDescriptorProto.TYPE_MESSAGE
                field.type_name = f".{package}.{kind}"
            if text[0] == "p":
                field.options.packed = True
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(f"{package}.{direction}"))


def protobuf_values(message: Any) -> Any:
    """Every value protobuf holds: nested tuples in the order of the field numbers, doubles as bits, None absent."""
    values: list[Any] = []
    for field in sorted(message.DESCRIPTOR.fields, key=lambda field: field.number):
        content = getattr(message, field.name)
        if field.is_repeated:
            values.append(tuple(protobuf_value(item) for item in content))
        elif message.HasField(field.name):
            values.append(protobuf_value(content))
        else:
            values.append(None)
    return values[0] if message.DESCRIPTOR.name in ("Joints", "Vector") else tuple(values)


def protobuf_value(content: Any) -> Any:
    if isinstance(content, float):
        return struct.pack("<d", content)
    return protobuf_values(content) if hasattr(content, "DESCRIPTOR") else content


def our_values(message: Any, version: str) -> Any:
    """The same of a value object; fields that the version does not have are left out and must be empty."""
    if isinstance(message, tuple):
        return tuple(our_values(item, version) for item in message)
    if isinstance(message, float):
        return struct.pack("<d", message)
    if isinstance(message, str):
        return message.encode("utf-8", "surrogateescape")
    if not hasattr(message, "__struct_fields__"):
        return message
    foreign = (
        {"commanded_joint_position"}
        if version != "1.15"
        else {
            "measured_cartesian_pose",
            "measured_redundancy_information",
            "cartesian_pose",
            "redundancy_information",
        }
    )
    if version != "2.7":
        foreign.add("external_force")
    else:
        foreign.add("end_of_message_data")
    values = []
    for attribute in message.__struct_fields__:
        value = getattr(message, attribute)
        if attribute in foreign:
            assert value is None
        else:
            values.append(our_values(value, version))
    return tuple(values)


def framed(version: str, payload: bytes) -> bytes:
    if version != "2.7":
        return payload
    return struct.pack("<I", len(payload)) + payload + struct.pack("<I", zlib.crc32(payload))


def varint(value: int) -> bytes:
    groups = bytearray()
    while value > 0x7F:
        groups.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*groups, value])


def damaged(payloads: list[bytes], random: np.random.Generator) -> bytes:
    """A good payload with one to three injuries, or bytes that never were one."""
    kind = int(random.integers(0, 20))
    if kind == 0:
        return random.bytes(int(random.integers(0, 120)))
    data = bytearray(payloads[int(random.integers(len(payloads)))])
    for _ in range(int(random.integers(1, 4))):
        place = int(random.integers(0, len(data) + 1))
        match int(random.integers(0, 9)):
            case 0 if data:
                data[min(place, len(data) - 1)] ^= 1 << int(random.integers(8))
            case 1 if data:
                data[min(place, len(data) - 1)] = int(random.integers(256))
            case 2:
                del data[place:]
            case 3:
                del data[place : place + int(random.integers(1, 12))]
            case 4:
                data[place:place] = random.bytes(int(random.integers(1, 12)))
            case 5:
                other = payloads[int(random.integers(len(payloads)))]
                start = int(random.integers(0, len(other)))
                data[place:place] = other[start : start + int(random.integers(1, 80))]
            case 6:
                # A whole further field at the end, known or not, sometimes well-formed.
                body = random.bytes(int(random.integers(0, 10)))
                data += varint(int(random.integers(1, 20)) << 3 | 2) + varint(len(body)) + body
            case 7:
                data += varint(int(random.integers(1, 200)) << 3) + varint(int(random.integers(0, 2**62)))
            case _:
                data += payloads[int(random.integers(len(payloads)))]
    return bytes(data[:1492])


# Refused by FRI although protobuf takes it, see section 14: a known field with another wire type, and groups, are
# unknown fields to protobuf; counts and lengths have limits; each occurrence of a part has to be complete.
STRICTER = (WrongWireType, WrongValueCount, TextTooLong, MissingRequiredField, WrongMessageIdentifier)


def assert_agrees(decode: Callable[[bytes], Any], reference: Any, version: str, payload: bytes) -> str:
    """Decode one payload both ways and compare. Gives what happened."""
    try:
        message = decode(framed(version, payload))
    except CodecError as error:
        if isinstance(error, STRICTER):
            return type(error).__name__
        with pytest.raises(ProtobufDecodeError):
            reference().ParseFromString(payload)
        return type(error).__name__
    theirs = reference()
    theirs.ParseFromString(payload)
    assert theirs.IsInitialized()
    assert our_values(message, version) == protobuf_values(theirs)
    return "accepted"


@pytest.mark.parametrize("direction", ["monitoring", "command"])
@pytest.mark.parametrize("version", VECTORS)
def test_damaged_datagrams_give_the_typed_error_and_leave_no_trace(version: str, direction: str) -> None:
    codec = Codec(FriVersion(version))
    decode: Callable[[bytes], MonitoringMessage | CommandMessage]
    decode = codec.decode_monitoring if direction == "monitoring" else codec.decode_command
    reference = protobuf_class(version, direction)
    good = [bytes.fromhex(entry["hex"]) for entry in VECTORS[version][direction]]
    payloads = [datagram[4:-4] if version == "2.7" else datagram for datagram in good]
    expected = []
    for payload in payloads:
        truth = reference()
        truth.ParseFromString(payload)
        expected.append(protobuf_values(truth))
    random = np.random.default_rng([SEED, *version.encode(), len(direction)])
    outcomes: dict[str, int] = {}
    for number in range(DATAGRAMS_PER_CASE):
        outcome = assert_agrees(decode, reference, version, damaged(payloads, random))
        outcomes[outcome] = outcomes.get(outcome, 0) + 1
        if number % BATCH == BATCH - 1:
            for datagram, values in zip(good, expected, strict=True):
                assert our_values(decode(datagram), version) == values
    # The injuries reach every refusal and leave some datagrams good, or this test would show little.
    reached = (TruncatedMessage, InvalidFieldNumber, WrongWireType, MissingRequiredField, WrongValueCount)
    assert {"accepted", *(error.__name__ for error in reached)} <= set(outcomes)


@pytest.mark.parametrize("direction", ["monitoring", "command"])
@pytest.mark.parametrize("version", VECTORS)
def test_protobuf_writes_what_the_codec_writes(version: str, direction: str) -> None:
    codec = Codec(FriVersion(version))
    reference = protobuf_class(version, direction)
    for entry in VECTORS[version][direction]:
        datagram = bytes.fromhex(entry["hex"])
        theirs = reference()
        theirs.ParseFromString(datagram[4:-4] if version == "2.7" else datagram)
        if direction == "monitoring":
            ours = codec.encode_monitoring(codec.decode_monitoring(datagram))
        else:
            ours = codec.encode_command(codec.decode_command(datagram))
        assert ours == framed(version, theirs.SerializeToString())


def test_random_bytes_are_no_framed_datagram() -> None:
    """2.7 without repairing length and checksum: nothing damaged gets past the frame."""
    codec = Codec(FriVersion.V2_7)
    random = np.random.default_rng(SEED)
    good = [bytes.fromhex(entry["hex"]) for entry in VECTORS["2.7"]["monitoring"]]
    for _ in range(6_000):
        datagram = damaged(good, random)
        if datagram not in good:
            with pytest.raises(CodecError):
                codec.decode_monitoring(datagram)
    for datagram in good:
        assert codec.encode_monitoring(codec.decode_monitoring(datagram)) == datagram
