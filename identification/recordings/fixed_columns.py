"""Messages of one topic as columns, as far as their fields have a fixed size: all messages at once, not one by one.

CDR lays fields out one after the other, each aligned to its own size. Until the first sequence or text every message of
a definition has the same layout, and numpy reads thousands of them as one table.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from identification.arrays import IntArray

_SIZES = {"bool": 1, "byte": 1, "char": 1, "int8": 1, "uint8": 1, "int16": 2, "uint16": 2, "int32": 4, "uint32": 4,
          "int64": 8, "uint64": 8, "float32": 4, "float64": 8}  # fmt: skip
_KINDS = {"bool": "?", "byte": "u1", "char": "u1", "float32": "f4", "float64": "f8"}
_FIELD = re.compile(r"^(\w+)(?:\[(\d+)\])?\s+(\w+)$")
_HEADER = 4
"""Bytes before the fields: how they are encoded. Alignment counts from behind them."""
_LITTLE_ENDIAN = b"\x00\x01"


class FixedColumns:
    """Collects the fields of messages that come before the first one of variable size.

    definition: text of the message, as in an MCAP schema.
    """

    def __init__(self, definition: str) -> None:
        self.layout = _layout(definition)
        self._rows: list[npt.NDArray[np.void]] = []
        self._misfit = ""

    def __len__(self) -> int:
        return sum(len(rows) for rows in self._rows)

    def add(self, data: bytes, starts: IntArray, ends: IntArray) -> None:
        """Messages that stand at these places of a block of bytes."""
        end = self.layout.itemsize
        short = ends - starts < end
        if short.any():
            self._misfit = (
                f"a message of {(ends - starts)[short][0]} bytes does not hold its {end} bytes of fixed fields"
            )
            starts = starts[~short]
        if starts.size == 0:
            return
        # As plain bytes, so that numpy copies whole messages and not field by field.
        rows = np.ndarray(len(data) - end + 1, f"V{end}", data, strides=(1,))[starts]
        if np.any(rows.view(np.uint8).reshape(-1, end)[:, : len(_LITTLE_ENDIAN)] != list(_LITTLE_ENDIAN)):
            self._misfit = "a message is not encoded as plain little-endian CDR"
        self._rows.append(rows)

    def columns(self, names: Sequence[str]) -> dict[str, npt.NDArray[np.generic]]:
        """Fields by their names, one row per message. Raises KeyError for one that is not there, and ValueError where a
        message was shorter than its fields or not encoded as plain little-endian CDR.
        """
        if self._misfit:
            raise ValueError(self._misfit)
        fields = [self._field(name) for name in names]
        # As plain bytes too: one copy a message, not one a number.
        found = [np.empty(len(self), f"V{kind.itemsize}") for kind, _ in fields]
        row = 0
        for rows in self._rows:  # the messages of a block stay in the processor's cache until all fields are out
            for column, (_, offset) in zip(found, fields, strict=True):
                column[row : row + len(rows)] = np.ndarray(len(rows), column.dtype, rows, offset, (rows.itemsize,))
            row += len(rows)
        return {
            name: column.view(kind.base).reshape(-1, *kind.shape)
            for name, column, (kind, _) in zip(names, found, fields, strict=True)
        }

    def _field(self, name: str) -> tuple[np.dtype[Any], int]:
        """Type and place of a field in a message."""
        assert self.layout.fields is not None
        kind, offset = self.layout.fields[name][:2]
        return kind, offset


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
        offsets.append(_HEADER + start)
        end = start + size * int(count or 1)
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": _HEADER + end})
