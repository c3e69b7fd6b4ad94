"""What tests of the codec share: parts of datagrams written by hand, and equality in which a NaN equals itself."""

from __future__ import annotations

import math
import struct
from typing import Any

from fri_client.messages import (
    FriVersion,
    MonitoringMessage,
)
from fri_client.wire.codec import Codec

CODECS = {version: Codec(version) for version in FriVersion}
HEADER = bytes.fromhex("0a0b08c2a2910110840718c203")
"""A monitoring header by hand: identifier 0x245142, counters 900 and 450."""

SEVEN = (0.1, -0.0, math.inf, -math.inf, math.nan, 5e-324, -1.7976931348623157e308)


def monitoring(*parts: bytes, version: FriVersion = FriVersion.V1_15) -> MonitoringMessage:
    return CODECS[version].decode_monitoring(HEADER + b"".join(parts))


def part(number: int, body: bytes) -> bytes:
    assert number < 16
    assert len(body) < 128
    return bytes([number << 3 | 2, len(body)]) + body


def unpacked(values: tuple[float, ...]) -> bytes:
    return b"".join(b"\x09" + struct.pack("<d", value) for value in values)


def packed(values: tuple[float, ...]) -> bytes:
    return bytes([0x0A, 8 * len(values)]) + struct.pack(f"<{len(values)}d", *values)


def same(one: Any, other: Any) -> bool:
    """Equality in which NaN equals itself and 0.0 differs from -0.0: doubles are compared by their bits."""
    if isinstance(one, float) and isinstance(other, float):
        return struct.pack("<d", one) == struct.pack("<d", other)
    if isinstance(one, tuple) and isinstance(other, tuple):
        return len(one) == len(other) and all(map(same, one, other))
    if hasattr(one, "__struct_fields__"):
        names = one.__struct_fields__
        return type(one) is type(other) and all(same(getattr(one, name), getattr(other, name)) for name in names)
    return type(one) is type(other) and bool(one == other)
