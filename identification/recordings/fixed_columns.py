"""Messages of one topic as columns, as far as their fields have a fixed size: all messages at once, not one by one.

CDR lays fields out one after the other, each aligned to its own size. Until the first sequence or text every message of
a definition has the same layout, and numpy reads thousands of them as one table.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

__all__ = ["fixed_columns"]

_SIZES = {"bool": 1, "byte": 1, "char": 1, "int8": 1, "uint8": 1, "int16": 2, "uint16": 2, "int32": 4, "uint32": 4,
          "int64": 8, "uint64": 8, "float32": 4, "float64": 8}  # fmt: skip
_KINDS = {"bool": "?", "byte": "u1", "char": "u1", "float32": "f4", "float64": "f8"}
_FIELD = re.compile(r"^(\w+)(?:\[(\d+)\])?\s+(\w+)$")
_HEADER = 4
"""Bytes before the fields: how they are encoded. Alignment counts from behind them."""
_LITTLE_ENDIAN = b"\x00\x01"


def fixed_columns(definition: str, messages: Sequence[bytes]) -> np.ndarray:
    """A structured array with one row per message and the fields that come before the first one of variable size.

    definition: text of the message, as in an MCAP schema. Raises ValueError where a message is shorter than its fields
    or is not encoded as plain little-endian CDR.
    """
    layout = _layout(definition)
    end = _HEADER + layout.itemsize
    for message in messages:
        if len(message) < end or not message.startswith(_LITTLE_ENDIAN):
            raise ValueError(f"a message of {len(message)} bytes does not hold its {end} bytes of fixed fields")
    return np.frombuffer(b"".join([message[_HEADER:end] for message in messages]), dtype=layout)


def _layout(definition: str) -> np.dtype[np.void]:
    names: list[str] = []
    formats: list[str] = []
    offsets: list[int] = []
    end = 0
    for line in definition.split("\n====", 1)[0].splitlines():
        text = line.split("#", 1)[0].strip()
        if not text or "=" in text:  # a constant takes no bytes
            continue
        found = _FIELD.match(text)
        if found is None or found[1] not in _SIZES:
            break
        kind, count, name = found.groups()
        size = _SIZES[kind]
        start = -(-end // size) * size
        code = _KINDS.get(kind, f"{'u' if kind.startswith('u') else 'i'}{size}")
        names.append(name)
        formats.append(f"{count or ''}{'' if size == 1 else '<'}{code}")
        offsets.append(start)
        end = start + size * int(count or 1)
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": end})
