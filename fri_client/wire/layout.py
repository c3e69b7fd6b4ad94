"""The quick way through a datagram that is shaped like one read before.

A robot sends the same shape a thousand times per second: the same fields in the same places, only the numbers differ.
Here: `LayoutBook` keeps the shape of datagrams that the `reader` has read, as two big integers (which bits are fixed,
and what they are) and one `struct` for the numbers between. If every fixed bit of a new datagram agrees (tags, lengths,
texts, continuation bits of the varints), it means to the reader exactly what the struct takes out of it; otherwise the
reader does the work. Not here: any number of any datagram.

Kept are only shapes of datagrams that the `writer` would write byte for byte, and only a limited number. Any other
shape is read by the `reader` each time.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from enum import IntEnum
from operator import itemgetter
from typing import Any, NamedTuple

from fri_client.messages import JOINT_COUNT, FriVersion
from fri_client.wire.primitives import FIXED64, LENGTH_DELIMITED, VARINT, varint
from fri_client.wire.schema import Field, Kind, Rule, rows_of

Values = tuple[Any, ...]

_WIDEST_FREE = 5
"""Varints of more bytes (negative numbers, large 64-bit values) belong to the shape: they are fixed bits."""


class _Shelf(IntEnum):
    """Where a part of the message comes from, in the order in which the parts are laid out for building."""

    CONSTANT = 0
    TAKEN = 1
    """One item or slice of what the struct unpacks."""
    JOINED = 2
    """A varint of several bytes, joined from items."""
    BUILT = 3


class _Part(NamedTuple):
    shelf: _Shelf
    place: int


_NONE = _Part(_Shelf.CONSTANT, 0)
_EMPTY = _Part(_Shelf.CONSTANT, 1)


class Layout:
    """One shape. `read` gives the message of a payload of this shape, or None for any other of the same length."""

    def __init__(self, sketch: Sketch) -> None:
        offsets = {
            _Shelf.CONSTANT: 0,
            _Shelf.TAKEN: len(sketch.constants),
            _Shelf.JOINED: len(sketch.constants) + len(sketch.taken),
            _Shelf.BUILT: len(sketch.constants) + len(sketch.taken) + len(sketch.joined),
        }
        self._mask = int.from_bytes(sketch.mask, "little")
        self._expected = int.from_bytes(sketch.expected, "little")
        self._unpack = struct.Struct("<" + "".join(sketch.formats)).unpack
        self._base = tuple(sketch.constants)
        self._take = _tuple_getter(sketch.taken)
        self._joined = tuple(sketch.joined)
        self._steps = tuple(
            (build, _tuple_getter([offsets[part.shelf] + part.place for part in parts]))
            for build, parts in sketch.built
        )

    def read(self, payload: bytes, bits: int) -> Any | None:
        """The message, or None. bits: the payload as a little-endian integer."""
        if bits & self._mask != self._expected:
            return None
        values = self._unpack(payload)
        parts = [*self._base, *self._take(values)]
        for join, start in self._joined:
            parts.append(join(values, start))
        for build, take in self._steps:
            parts.append(build(*take(parts)))
        return parts[-1]


class LayoutBook:
    """The shapes seen so far of one message type in one version."""

    MOST_PAGES = 128

    def __init__(self, group: type[Any], version: FriVersion) -> None:
        self._group = group
        self._version = version
        self._by_length: dict[int, list[Layout]] = {}
        self._pages = 0

    def read(self, payload: bytes) -> Any | None:
        """The message in a payload of a known shape, in fresh storage; None where the reader has to do it."""
        layouts = self._by_length.get(len(payload))
        if layouts is None:
            return None
        bits = int.from_bytes(payload, "little")
        for index, layout in enumerate(layouts):
            message = layout.read(payload, bits)
            if message is not None:
                if index:
                    layouts[0], layouts[index] = layouts[index], layouts[0]
                return message
        return None

    def learn(self, payload: bytes, message: Any) -> None:
        """Keep the shape of `payload`, which the reader has read as `message`, unless the book is full."""
        if self._pages >= self.MOST_PAGES:
            return
        sketch = Sketch()
        sketch_group(sketch, self._group, self._version, message)
        mask = int.from_bytes(sketch.mask, "little")
        same_length = len(sketch.mask) == len(payload)
        if same_length and int.from_bytes(payload, "little") & mask == int.from_bytes(sketch.expected, "little"):
            self._by_length.setdefault(len(payload), []).append(Layout(sketch))
            self._pages += 1


class Sketch:
    """A shape while it is drawn: fixed bits, struct format, and how the message is put together.

    places: where among the unpacked numbers a field stands, by its attribute; of a field that comes twice, the last.
    """

    def __init__(self) -> None:
        self.mask = bytearray()
        self.expected = bytearray()
        self.formats: list[str] = []
        self.unpacked = 0
        self.constants: list[Any] = [None, ()]
        self.taken: list[int | slice] = []
        self.joined: list[tuple[Callable[[Values, int], int], int]] = []
        self.built: list[tuple[Callable[..., Any], list[_Part]]] = []
        self.places: dict[str, slice] = {}

    def holds(self, row: Field) -> bool:
        """True where the value of an integer field belongs to the shape."""
        # The identifier has been checked; any other is another shape.
        return row.name == "messageIdentifier"

    def fix(self, data: bytes) -> None:
        """Bytes that belong to the shape."""
        self.mask += b"\xff" * len(data)
        self.expected += data
        self.formats.append(f"{len(data)}x")

    def free(self, code: str, mask: bytes, expected: bytes) -> int:
        """Bytes that hold one number of `struct` code `code`; gives its place among the unpacked numbers."""
        self.mask += mask
        self.expected += expected
        self.formats.append(code)
        self.unpacked += 1
        return self.unpacked - 1

    def constant(self, value: Any) -> _Part:
        """A part of the message that is the same in every datagram of the shape."""
        self.constants.append(value)
        return _Part(_Shelf.CONSTANT, len(self.constants) - 1)

    def take(self, item: int | slice) -> _Part:
        """A part that is one of the unpacked numbers, or a tuple of them."""
        self.taken.append(item)
        return _Part(_Shelf.TAKEN, len(self.taken) - 1)

    def join(self, function: Callable[[Values, int], int], start: int) -> _Part:
        """A part that is put together from the bytes of a varint."""
        self.joined.append((function, start))
        return _Part(_Shelf.JOINED, len(self.joined) - 1)

    def build(self, function: Callable[..., Any], parts: list[_Part]) -> _Part:
        """A part that is made of parts."""
        self.built.append((function, parts))
        return _Part(_Shelf.BUILT, len(self.built) - 1)

    def doubles(self, count: int, tag: bytes) -> _Part:
        """`count` doubles, each behind `tag`, as one tuple."""
        start = self.unpacked
        for _ in range(count):
            if tag:
                self.fix(tag)
            self.free("d", bytes(8), bytes(8))
        return self.take(slice(start, self.unpacked))


def sketch_group(sketch: Sketch, group: type[Any], version: FriVersion, message: Any) -> _Part:
    """Draw the shape of a whole message, `group` being its type."""
    parts = {attribute: _EMPTY if getattr(message, attribute) == () else _NONE for attribute in group.__struct_fields__}
    for row in rows_of(group, version):
        value = getattr(message, row.attribute)
        if value is not None and value != row.default:
            start = sketch.unpacked
            parts[row.attribute] = _sketch_field(sketch, row, value, version)
            sketch.places[row.attribute] = slice(start, sketch.unpacked)
    return sketch.build(group, list(parts.values()))


def _sketch_field(sketch: Sketch, row: Field, value: Any, version: FriVersion) -> _Part:
    match row.kind:
        case Kind.UINT32 | Kind.UINT64 | Kind.INT32:
            sketch.fix(varint(row.number << 3 | VARINT))
            return _sketch_integer(sketch, row.kind, value, fixed=sketch.holds(row))
        case Kind.DOUBLE:
            sketch.fix(varint(row.number << 3 | FIXED64))
            return sketch.take(sketch.free("d", bytes(8), bytes(8)))
        case Kind.TEXT:
            text = value.encode("utf-8", "surrogateescape")
            sketch.fix(varint(row.number << 3 | LENGTH_DELIMITED) + varint(len(text)) + text)
            return sketch.constant(value)
        case Kind.INT32_LIST:
            return _sketch_integers(sketch, row, value)
        case Kind.DOUBLE_LIST:
            sketch.fix(varint(row.number << 3 | LENGTH_DELIMITED) + varint(8 * len(value)))
            return sketch.doubles(len(value), b"")
        case Kind.JOINT_VALUES:
            sketch.fix(varint(row.number << 3 | LENGTH_DELIMITED) + varint(9 * JOINT_COUNT))
            return sketch.doubles(JOINT_COUNT, b"\x09")
        case Kind.VECTOR:
            inner = b"\x0a" + varint(8 * len(value)) if value else b""
            length = len(inner) + 8 * len(value)
            sketch.fix(varint(row.number << 3 | LENGTH_DELIMITED) + varint(length) + inner)
            return sketch.doubles(len(value), b"")
        case Kind.GROUP if row.rule is Rule.REPEATED:
            return sketch.build(_as_tuple, [_sketch_part(sketch, row, item, version) for item in value])
        case Kind.GROUP:
            return _sketch_part(sketch, row, value, version)


def _sketch_part(sketch: Sketch, row: Field, value: Any, version: FriVersion) -> _Part:
    """A sub-message: its length comes first and is known last, so its bits are drawn behind a gap that is filled in."""
    assert row.group is not None
    outer_mask, outer_expected = sketch.mask, sketch.expected
    place = len(sketch.formats)
    sketch.mask, sketch.expected = bytearray(), bytearray()
    part = sketch_group(sketch, row.group, version, value)
    head = varint(row.number << 3 | LENGTH_DELIMITED) + varint(len(sketch.mask))
    sketch.formats.insert(place, f"{len(head)}x")
    sketch.mask = outer_mask + b"\xff" * len(head) + sketch.mask
    sketch.expected = outer_expected + head + sketch.expected
    return part


def _sketch_integer(sketch: Sketch, kind: Kind, value: int, *, fixed: bool) -> _Part:
    data = varint(value & 0xFFFFFFFFFFFFFFFF)
    width = len(data)
    if fixed or width > _WIDEST_FREE or (width == _WIDEST_FREE and kind is Kind.INT32):
        sketch.fix(data)
        return sketch.constant(value)
    if width == 1:
        return sketch.take(sketch.free("B", b"\x80", b"\x00"))
    start = sketch.unpacked
    for _ in range(width - 1):
        sketch.free("B", b"\x80", b"\x80")
    # The fifth byte of a uint32 has room for 4 bits; more is the reader's business.
    sketch.free("B", b"\xf0" if width == _WIDEST_FREE and kind is Kind.UINT32 else b"\x80", b"\x00")
    return sketch.join(_JOIN[width], start)


def _sketch_integers(sketch: Sketch, row: Field, values: tuple[int, ...]) -> _Part:
    tag = varint(row.number << 3 | VARINT)
    if all(0 <= value < 0x80 for value in values) and not sketch.holds(row):
        start = sketch.unpacked
        for _ in values:
            sketch.fix(tag)
            sketch.free("B", b"\x80", b"\x00")
        return sketch.take(slice(start, sketch.unpacked))
    for value in values:
        sketch.fix(tag + varint(value & 0xFFFFFFFFFFFFFFFF))
    return sketch.constant(values)


def _join_2(values: Values, start: int) -> int:
    first, second = values[start : start + 2]
    return int(first & 0x7F | second << 7)


def _join_3(values: Values, start: int) -> int:
    first, second, third = values[start : start + 3]
    return int(first & 0x7F | (second & 0x7F) << 7 | third << 14)


def _join_4(values: Values, start: int) -> int:
    first, second, third, fourth = values[start : start + 4]
    return int(first & 0x7F | (second & 0x7F) << 7 | (third & 0x7F) << 14 | fourth << 21)


def _join_5(values: Values, start: int) -> int:
    first, second, third, fourth, fifth = values[start : start + 5]
    return int(first & 0x7F | (second & 0x7F) << 7 | (third & 0x7F) << 14 | (fourth & 0x7F) << 21 | fifth << 28)


_JOIN = {2: _join_2, 3: _join_3, 4: _join_4, 5: _join_5}


def _as_tuple(*items: Any) -> tuple[Any, ...]:
    return items


def _tuple_getter(items: list[Any]) -> Callable[[Any], tuple[Any, ...]]:
    """Like itemgetter, but a tuple for one item and for none as well."""
    if len(items) > 1:
        return itemgetter(*items)
    if not items:
        return lambda _: ()
    only = items[0]
    return lambda values: (values[only],)
