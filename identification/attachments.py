"""What the bytes of an MCAP attachment say before anybody trusts them; no array, so that a recorder may load it."""

from __future__ import annotations

import zlib

__all__ = ["attachment_name", "has_its_checksum"]

_NAME_AT = 20
"""Behind the two times and the length of the name, of 8, 8 and 4 bytes (MCAP specification, op 0x09)."""
_LONGEST_NAME = 200
"""Of a damaged attachment; its stated length may be damaged too."""


def has_its_checksum(content: bytes) -> bool:
    """Whether an attachment's checksum, the last four bytes of its record, fits the rest; 0 states none."""
    stated = int.from_bytes(content[-4:], "little")
    return not stated or zlib.crc32(content[:-4]) == stated


def attachment_name(content: bytes) -> str:
    """The name of a damaged attachment as far as it can be read."""
    length = int.from_bytes(content[_NAME_AT - 4 : _NAME_AT], "little")
    return content[_NAME_AT : _NAME_AT + min(length, _LONGEST_NAME)].decode(errors="replace")
