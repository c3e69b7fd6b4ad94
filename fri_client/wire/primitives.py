"""The primitives of the FRI wire format: variable-length integers, tags, and skipping of unknown fields.

Here: reading and writing the protobuf primitives with every bound checked. Not here: which field is what (`schema`).
Offsets count from the start of the payload.
"""

from __future__ import annotations

from typing import Final

from fri_client.errors import InvalidFieldNumber, MalformedVarint, TruncatedMessage, WrongWireType

VARINT: Final = 0
FIXED64: Final = 1
LENGTH_DELIMITED: Final = 2
FIXED32: Final = 5

_ONE_BYTE: Final = tuple(bytes([value]) for value in range(0x80))


def varint(value: int) -> bytes:
    """`value` (0 <= value < 2^64) as a varint of the fewest bytes, least significant group first."""
    if value < 0x80:
        return _ONE_BYTE[value]
    groups = bytearray()
    while value >= 0x80:
        groups.append(value & 0x7F | 0x80)
        value >>= 7
    groups.append(value)
    return bytes(groups)


def read_varint(data: bytes, position: int, end: int, message: str) -> tuple[int, int]:
    """The varint at `position`, cut to 64 bits, and the position after it.

    Raises TruncatedMessage, and MalformedVarint where it is longer than 10 bytes.
    """
    start = position
    value = shift = 0
    while position < end:
        byte = data[position]
        position += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value & 0xFFFFFFFFFFFFFFFF, position
        shift += 7
        if shift == 70:
            raise MalformedVarint(message=message, offset=start)
    raise TruncatedMessage(message=message, offset=end)


def read_tag(data: bytes, position: int, end: int, message: str) -> tuple[int, int]:
    """The tag (field number << 3 | wire type) at `position`, and the position after it.

    Field numbers are 1 to 2^29 - 1. A zero byte where a tag is due is refused, although the vendor's decoder takes it
    for the end of the message (PROTOCOL section 14): bytes after the end are no part of any message we know.
    """
    tag, after = read_varint(data, position, end, message)
    if tag < 8 or tag >= 1 << 32 or after - position > 5:
        raise InvalidFieldNumber(message=message, number=tag >> 3, offset=position)
    return tag, after


def read_length(data: bytes, position: int, end: int, message: str) -> tuple[int, int]:
    """Start and stop of the length-delimited bytes whose length is written at `position`."""
    length, start = read_varint(data, position, end, message)
    if start - position > 5:
        raise MalformedVarint(message=message, offset=position)
    stop = start + length
    if stop > end:
        raise TruncatedMessage(message=message, offset=end)
    return start, stop


def skip_field(data: bytes, tag: int, position: int, end: int, message: str) -> int:
    """The position after the value of an unknown field. Groups (wire types 3 and 4) and 6, 7 are refused."""
    wire_type = tag & 7
    if wire_type == VARINT:
        return read_varint(data, position, end, message)[1]
    if wire_type == LENGTH_DELIMITED:
        return read_length(data, position, end, message)[1]
    if wire_type == FIXED64:
        position += 8
    elif wire_type == FIXED32:
        position += 4
    else:
        raise WrongWireType(message=message, field=str(tag >> 3), wire_type=wire_type, offset=position)
    if position > end:
        raise TruncatedMessage(message=message, offset=end)
    return position
