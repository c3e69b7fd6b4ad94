"""The lines of `fri decode` and `fri encode` say what the golden files say, and give the bytes back."""

from __future__ import annotations

import json
import math
import struct
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fri_client.wire.json_form import decode_line, encode_line
from tests.reference import golden_datagrams

VECTORS = golden_datagrams()
CASES = [
    pytest.param(version, direction, entry, id=f"{version}-{entry['name']}")
    for version, groups in VECTORS.items()
    for direction in ("monitoring", "command")
    for entry in groups[direction]
]
HEADER = {"messageIdentifier": 0x34001, "sequenceCounter": 1, "reflectedSequenceCounter": 2}


def without_bits(content: Any) -> Any:
    if isinstance(content, dict):
        return {key: without_bits(value) for key, value in content.items() if not key.endswith("_bits")}
    return [without_bits(item) for item in content] if isinstance(content, list) else content


def refused(line: str) -> str:
    answer = json.loads(line)
    assert answer["ok"] is False
    assert set(answer) == {"ok", "error"}
    return str(answer["error"])


@pytest.mark.parametrize(("version", "direction", "entry"), CASES)
def test_a_line_has_the_vendors_fields_and_gives_the_vendors_bytes(
    version: str, direction: str, entry: dict[str, Any]
) -> None:
    line = json.dumps(decode_line(version, direction, entry["hex"]), allow_nan=False)
    # Compared as text, so that -0.0 is not 0.0 and 1 is not 1.0.
    wanted = {"ok": True, "fields": without_bits(entry["fields"])}
    assert json.dumps(json.loads(line), sort_keys=True) == json.dumps(wanted, sort_keys=True)
    assert encode_line(version, direction, line) == entry["hex"]
    assert encode_line(version, direction, json.dumps(json.loads(line)["fields"])) == entry["hex"]
    assert encode_line(version, direction, json.dumps(entry["fields"])) == entry["hex"]


@pytest.mark.parametrize("version", VECTORS)
@pytest.mark.parametrize("direction", ["monitoring", "command"])
def test_a_malformed_datagram_gives_an_error_line(version: str, direction: str) -> None:
    for entry in VECTORS[version][f"malformed_{direction}"]:
        answer = decode_line(version, direction, entry["hex"])
        if entry["name"].startswith("bad") and entry["name"] != "bad_cut_after_header":
            assert "\n" not in refused(json.dumps(answer))


@pytest.mark.parametrize("text", ["0", "0x0a", "zz", "0a0b0", "{}"])
def test_a_line_that_is_no_hexadecimal_gives_an_error_line(text: str) -> None:
    assert "hexadecimal" in refused(json.dumps(decode_line("1.15", "command", text)))


@pytest.mark.parametrize(
    ("line", "place"),
    [
        ("", "JSON"),
        ("{", "JSON"),
        ("[" * 100_000, "JSON"),
        ("[]", "object"),
        ("null", "object"),
        ('{"ok": false, "error": "cut"}', "refused"),
        ('{"ok": true}', "object"),
        ("{}", "header"),
        ('{"header": {}}', "messageIdentifier"),
        (json.dumps({"header": HEADER, "robotInfo": {}}), "robotInfo"),
        (json.dumps({"header": HEADER, "endOfMessageData": {"messageLength": 1.0}}), "endOfMessageData.messageLength"),
        (json.dumps({"header": HEADER | {"sequenceCounter": True}}), "header.sequenceCounter"),
        (json.dumps({"header": HEADER | {"sequenceCounter": None}}), "header.sequenceCounter"),
        (json.dumps({"header": HEADER | {"sequenceCounter": -1}}), "sequenceCounter"),
        (json.dumps({"header": HEADER | {"sequenceCounter": 2**32}}), "sequenceCounter"),
        (json.dumps({"header": HEADER | {"messageIdentifier": 7}}), "identifier"),
        (json.dumps({"header": HEADER, "commandData": {"jointPosition": [0.0] * 7}}), "commandData.jointPosition"),
        (json.dumps({"header": HEADER, "commandData": {"jointPosition": {"value": [0.0] * 6}}}), "exactly 7"),
        (
            json.dumps({"header": HEADER, "commandData": {"jointTorque": {"value": ["NaN"] * 7}}}),
            "jointTorque.value[0]",
        ),
        ('{"header": NaN}', "NaN"),
        ('{"header": 1e999}', "header"),
        (json.dumps({"header": HEADER, "commandData": {"jointTorque": {"value": [10**400] * 7}}}), "beyond a double"),
        (json.dumps({"header": HEADER, "commandData": {"writeIORequest": {}}}), "writeIORequest"),
        (json.dumps({"header": HEADER, "commandData": {"writeIORequest": [{"name": 3}]}}), "writeIORequest[0].name"),
        (json.dumps({"header": HEADER, "commandData": {"cartesianPose": {"name": ""}}}), "1.15"),
    ],
)
def test_a_line_that_is_no_message_gives_an_error_line_that_names_the_place(line: str, place: str) -> None:
    assert place in refused(encode_line("1.15", "command", line))


def test_other_directions_and_versions_are_a_callers_error() -> None:
    with pytest.raises(ValueError, match="direction"):
        decode_line("1.15", "sideways", "")
    with pytest.raises(ValueError, match=r"3\.0"):
        encode_line("3.0", "command", "{}")


def test_a_nan_comes_back_as_the_quiet_one_whatever_its_payload() -> None:
    """What the form cannot keep: JSON has no bits of a NaN."""
    payload_nan = bytes.fromhex("010000000000f4ff")
    command = bytes.fromhex("0a080881800d10011802") + b"\x12\x41\x0a\x3f" + b"".join([b"\x09" + payload_nan] * 7)
    answer = decode_line("1.15", "command", command.hex())
    assert answer["fields"]["commandData"]["jointPosition"]["value"] == ["nan"] * 7
    again = bytes.fromhex(encode_line("1.15", "command", json.dumps(answer)))
    assert again[-8:] == struct.pack("<d", math.nan)


@settings(deadline=None)
@given(st.lists(st.floats(allow_nan=False), min_size=7, max_size=7))
def test_every_double_comes_back_with_the_same_bits(position: list[float]) -> None:
    body = b"".join(b"\x09" + struct.pack("<d", value) for value in position)
    line = (bytes.fromhex("0a080881800d10011802") + b"\x12\x41\x0a\x3f" + body).hex()
    assert encode_line("1.15", "command", json.dumps(decode_line("1.15", "command", line), allow_nan=False)) == line


def test_a_name_that_is_no_text_comes_back_as_it_was() -> None:
    io = b"\x0a\x03\xff\xfe\x41\x10\x00\x18\x00"
    line = (bytes.fromhex("0a080881800d10011802") + b"\x12\x0b\x2a\x09" + io).hex()
    assert encode_line("1.15", "command", json.dumps(decode_line("1.15", "command", line))) == line
