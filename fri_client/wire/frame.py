"""The frame of FRI 2.7: length, payload, CRC-32 (PROTOCOL section 2). Other versions send the payload bare.

Here: putting the frame on and taking it off. Length and checksum are compared before a byte of the payload is read:
the vendor's client does it the other way round, and a damaged datagram changes its state.
"""

from __future__ import annotations

import struct
from zlib import crc32

from fri_client.errors import WrongChecksum, WrongFrameLength

FRAME_BYTES = 8
"""Bytes the frame adds to the payload."""

_WORD = struct.Struct("<I")


def framed(payload: bytes) -> bytes:
    """The payload within uint32 LE length and uint32 LE CRC-32 (zlib) of the payload alone."""
    return b"".join((_WORD.pack(len(payload)), payload, _WORD.pack(crc32(payload))))


def unframed(datagram: bytes) -> bytes:
    """The payload of a framed datagram. Raises WrongFrameLength, WrongChecksum."""
    available = len(datagram) - FRAME_BYTES
    if available < 0:
        raise WrongFrameLength(declared=None, available=available)
    (declared,) = _WORD.unpack_from(datagram)
    if declared != available:
        raise WrongFrameLength(declared=declared, available=available)
    payload = datagram[4:-4]
    computed = crc32(payload)
    (carried,) = _WORD.unpack_from(datagram, len(datagram) - 4)
    if carried != computed:
        raise WrongChecksum(carried=carried, computed=computed)
    return payload
