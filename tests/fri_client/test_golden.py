"""Datagrams written by the vendor's own library mean what it says they mean, and are written back byte for byte.

The truth is tests/data/fri_vectors.json: bytes and values from the vendor's library, not from code of this project.
"""

from __future__ import annotations

import json
import struct
from contextlib import suppress
from typing import Any

import pytest

from fri_client.errors import (
    CodecError,
    InvalidFieldNumber,
    MissingRequiredField,
    TextTooLong,
    TruncatedMessage,
    WrongChecksum,
    WrongFrameLength,
    WrongMessageIdentifier,
    WrongValueCount,
    WrongWireType,
)
from fri_client.messages import CommandMessage, FriVersion, MonitoringMessage
from fri_client.wire.codec import Codec
from tests.reference import golden_datagrams

VECTORS = golden_datagrams()
GOLDEN = [
    pytest.param(version, direction, entry, id=f"{version}-{entry['name']}")
    for version, groups in VECTORS.items()
    for direction in ("monitoring", "command")
    for entry in groups[direction]
]
MALFORMED = [
    pytest.param(version, direction, entry, id=f"{version}-{entry['name']}")
    for version, groups in VECTORS.items()
    for direction in ("monitoring", "command")
    for entry in groups[f"malformed_{direction}"]
]
# What section 14 of the protocol sheet recommends for each: the error, or None where the datagram is fine.
EXPECTED: dict[str, type[CodecError] | None] = {
    "bad_empty": MissingRequiredField,
    "bad_cut_in_header": TruncatedMessage,
    "bad_cut_after_header": None,
    "bad_cut_in_joint_array": TruncatedMessage,
    "bad_wrong_message_id": WrongMessageIdentifier,
    "bad_missing_required": MissingRequiredField,
    "bad_random": CodecError,
    "bad_wire_type_group": WrongWireType,
    "bad_unknown_wire_type_7": WrongWireType,
    "bad_io_name_64": TextTooLong,
    "odd_three_joint_values": WrongValueCount,
    "odd_unknown_fields": None,
    "odd_trailing_zero": InvalidFieldNumber,
    "odd_enum_out_of_range": None,
    "odd_duplicate_header": None,
    "bad27_crc": WrongChecksum,
    "bad27_unframed": WrongFrameLength,
    "bad27_no_crc": WrongFrameLength,
    "badcmd_empty": MissingRequiredField,
    "badcmd_one_byte": InvalidFieldNumber,
    "badcmd_cut_in_header": TruncatedMessage,
    "badcmd_cut_in_joint_array": TruncatedMessage,
    "badcmd_missing_counter": MissingRequiredField,
    "badcmd_wrench_seven": WrongValueCount,
    "badcmd_io_eleven": WrongValueCount,
    "badcmd_random": CodecError,
    "oddcmd_six_positions": WrongValueCount,
}
TOO_SHORT_FOR_A_FRAME = {"bad_empty", "badcmd_empty", "badcmd_one_byte"}

# The wire's names against the attributes, written out here rather than taken from the code under test.
PARTS = {
    "header": "header",
    "robotInfo": "robot_info",
    "monitorData": "monitor_data",
    "connectionInfo": "connection_info",
    "ipoData": "ipo_data",
    "requestedTransformations": "requested_transformations",
    "endOfMessageData": "end_of_message_data",
    "commandData": "command_data",
    "messageIdentifier": "message_identifier",
    "sequenceCounter": "sequence_counter",
    "reflectedSequenceCounter": "reflected_sequence_counter",
    "numberOfJoints": "number_of_joints",
    "safetyState": "safety_state",
    "driveState": "drive_state",
    "operationMode": "operation_mode",
    "controlMode": "control_mode",
    "measuredJointPosition": "measured_joint_position",
    "measuredTorque": "measured_torque",
    "commandedJointPosition": "commanded_joint_position",
    "commandedTorque": "commanded_torque",
    "externalTorque": "external_torque",
    "externalForce": "external_force",
    "readIORequest": "read_io_request",
    "measuredCartesianPose": "measured_cartesian_pose",
    "measuredRedundancyInformation": "measured_redundancy_information",
    "timestamp": "timestamp",
    "sessionState": "session_state",
    "quality": "quality",
    "sendPeriod": "send_period",
    "receiveMultiplier": "receive_multiplier",
    "jointPosition": "joint_position",
    "cartesianPose": "cartesian_pose",
    "redundancyInformation": "redundancy_information",
    "clientCommandMode": "client_command_mode",
    "overlayType": "overlay_type",
    "trackingPerformance": "tracking_performance",
    "cartesianWrenchFeedForward": "cartesian_wrench_feed_forward",
    "jointTorque": "joint_torque",
    "commandedTransformations": "commanded_transformations",
    "writeIORequest": "write_io_request",
    "sec": "sec",
    "nanosec": "nanosec",
    "name": "name",
    "type": "type",
    "direction": "direction",
    "digitalValue": "digital_value",
    "analogValue": "analog_value",
    "matrix": "matrix",
    "element": "element",
    "strategy": "strategy",
    "value": "value",
    "messageLength": "message_length",
    "messageChecksum": "message_checksum",
    "crc32": "crc32",
}


def decode(codec: Codec, direction: str, datagram: bytes) -> MonitoringMessage | CommandMessage:
    return codec.decode_monitoring(datagram) if direction == "monitoring" else codec.decode_command(datagram)


def bits(number: float) -> str:
    return struct.pack(">d", number).hex()


def assert_says(message: Any, fields: dict[str, Any], place: str = "") -> None:
    """The value object says exactly what `fields` of a golden datagram says: doubles by their bits, nothing more."""
    said = {PARTS[key]: key for key in fields if not key.endswith("_bits")}
    for attribute in message.__struct_fields__:
        value = getattr(message, attribute)
        if attribute not in said:
            assert value in (None, ()), f"{place}.{attribute} is absent from the datagram"
            continue
        key = said[attribute]
        here = f"{place}.{key}"
        expected = fields[key]
        if f"{key}_bits" in fields:
            expected_bits = fields[f"{key}_bits"]
            numbers = value if isinstance(expected_bits, list) else (value,)
            wanted = expected_bits if isinstance(expected_bits, list) else [expected_bits]
            assert [bits(number) for number in numbers] == wanted, here
        elif isinstance(expected, dict) and isinstance(value, tuple):
            (list_bits,) = (content for name, content in expected.items() if name.endswith("_bits"))
            assert [bits(number) for number in value] == list_bits, here
        elif isinstance(expected, dict):
            assert_says(value, expected, here)
        elif isinstance(expected, list) and expected and isinstance(expected[0], dict):
            assert len(value) == len(expected), here
            for index, (part, part_fields) in enumerate(zip(value, expected, strict=True)):
                assert_says(part, part_fields, f"{here}[{index}]")
        elif isinstance(expected, list):
            assert list(value) == expected, here
        else:
            assert value == expected, here


@pytest.mark.parametrize(("version", "direction", "entry"), GOLDEN)
def test_golden_datagram_means_what_the_vendor_says(version: str, direction: str, entry: dict[str, Any]) -> None:
    datagram = bytes.fromhex(entry["hex"])
    codec = Codec(FriVersion(version))
    assert_says(decode(codec, direction, datagram), entry["fields"])
    # A second time: by now the codec knows the shape and takes the quick way.
    assert_says(decode(codec, direction, datagram), entry["fields"])


@pytest.mark.parametrize(("version", "direction", "entry"), GOLDEN)
def test_golden_datagram_is_written_back_byte_for_byte(version: str, direction: str, entry: dict[str, Any]) -> None:
    datagram = bytes.fromhex(entry["hex"])
    codec = Codec(FriVersion(version))
    if direction == "monitoring":
        assert codec.encode_monitoring(codec.decode_monitoring(datagram)) == datagram
    else:
        assert codec.encode_command(codec.decode_command(datagram)) == datagram


@pytest.mark.parametrize("version", ["1.14", "1.16"])
def test_versions_1_14_and_1_16_are_the_format_of_1_15(version: str) -> None:
    codec = Codec(FriVersion(version))
    for direction in ("monitoring", "command"):
        for entry in VECTORS["1.15"][direction]:
            assert_says(decode(codec, direction, bytes.fromhex(entry["hex"])), entry["fields"])


def test_version_1_11_is_the_format_of_1_15_without_inputs_and_outputs() -> None:
    codec = Codec(FriVersion.V1_11)
    for direction in ("monitoring", "command"):
        for entry in VECTORS["1.15"][direction]:
            fields = json.loads(json.dumps(entry["fields"]))
            fields.get("monitorData", {}).pop("readIORequest", None)
            fields.get("commandData", {}).pop("writeIORequest", None)
            assert_says(decode(codec, direction, bytes.fromhex(entry["hex"])), fields)


@pytest.mark.parametrize(("version", "direction", "entry"), MALFORMED)
def test_malformed_datagram_gives_the_error_that_names_it(version: str, direction: str, entry: dict[str, Any]) -> None:
    expected = EXPECTED[entry["name"]]
    if version == "2.7" and entry["name"] in TOO_SHORT_FOR_A_FRAME:
        expected = WrongFrameLength
    codec = Codec(FriVersion(version))
    datagram = bytes.fromhex(entry["hex"])
    if expected is None:
        decode(codec, direction, datagram)
    else:
        with pytest.raises(expected):
            decode(codec, direction, datagram)


@pytest.mark.parametrize("version", VECTORS)
@pytest.mark.parametrize("direction", ["monitoring", "command"])
def test_every_good_datagram_decodes_untouched_after_every_malformed_one(version: str, direction: str) -> None:
    codec = Codec(FriVersion(version))
    for malformed in VECTORS[version][f"malformed_{direction}"]:
        for good in VECTORS[version][direction]:
            with suppress(CodecError):
                decode(codec, direction, bytes.fromhex(malformed["hex"]))
            assert_says(decode(codec, direction, bytes.fromhex(good["hex"])), good["fields"])


@pytest.mark.parametrize("version", VECTORS)
def test_a_repeated_header_is_the_last_one(version: str) -> None:
    (entry,) = (e for e in VECTORS[version]["malformed_monitoring"] if e["name"] == "odd_duplicate_header")
    header = Codec(FriVersion(version)).decode_monitoring(bytes.fromhex(entry["hex"])).header
    # The vendor's client answered this datagram with the counter of the last header, 901 (reply_hex: 18 85 07).
    assert header.sequence_counter == 901


@pytest.mark.parametrize("version", VECTORS)
def test_a_position_command_is_the_vendors_command(version: str) -> None:
    codec = Codec(FriVersion(version))
    names = {"cmd_position", "cmd_position_neg", "cmd_monitor_mirror_zero", "cmd_counters_max", "cmd_nan_inf"}
    only_position = [
        e for e in VECTORS[version]["command"] if set(e["fields"].get("commandData", {})) == {"jointPosition"}
    ]
    checked = set()
    for entry in only_position:
        if "endOfMessageData" in entry["fields"]:
            continue
        header, numbers = entry["fields"]["header"], entry["fields"]["commandData"]["jointPosition"]["value_bits"]
        position = [struct.unpack(">d", bytes.fromhex(number))[0] for number in numbers]
        counters = header["sequenceCounter"], header["reflectedSequenceCounter"]
        assert codec.encode_position_command(*counters, position).hex() == entry["hex"]
        checked.add(entry["name"])
    assert checked == names
