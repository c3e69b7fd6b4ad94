"""Bytes to messages, field by field: the reader that knows nothing beforehand and trusts nothing.

Here: one `GroupReader` per message type and version, made once from the rows of `schema`. Not here: frames and
identifiers (`codec`), the quicker way through a datagram shaped like one that was read before (`layout`).

Every value goes into storage made for this datagram. Accepted: unknown fields, fields in any order, packed and
unpacked lists, numbers outside an enumeration, integers wider than their field (cut to its width, as protobuf says).
Refused: everything listed in `errors` under DecodeError, and arrays and names beyond their limits.

A sub-message that comes twice is merged as protobuf defines it (later scalars win, lists grow, sub-messages merge),
with one stricter rule that the vendor's decoder has too: each occurrence must bring all its required fields. So a
repeated header is the last one. A joint array that comes twice would hold 14 values and is refused.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

from fri_client.errors import MissingRequiredField, TextTooLong, TruncatedMessage, WrongValueCount, WrongWireType
from fri_client.messages import JOINT_COUNT, FriVersion
from fri_client.wire.primitives import FIXED64, LENGTH_DELIMITED, VARINT, read_length, read_tag, read_varint, skip_field
from fri_client.wire.schema import MAXIMUM_NAME_BYTES, Field, Kind, Rule, check_count, group_name, rows_of

Slots = list[Any]
Action = Callable[[bytes, int, int, Slots], int]
"""(data, position after the tag, end of the message, slots to fill) -> position after the value."""

_DOUBLE = struct.Struct("<d")
_SEVEN_TAGGED = struct.Struct("<" + "Bd" * JOINT_COUNT)
_SEVEN_TAGS = (1 << 3 | FIXED64,) * JOINT_COUNT


class GroupReader:
    """Reads the messages of one type in one version."""

    def __init__(self, group: type[Any], version: FriVersion) -> None:
        rows = rows_of(group, version)
        attributes: tuple[str, ...] = group.__struct_fields__
        self._group = group
        self._name = group_name(group)
        self._known = {row.number: row.name for row in rows}
        self._required = tuple((attributes.index(r.attribute), r.name) for r in rows if r.rule is Rule.REQUIRED)
        # Rows that another version has still have a slot in the value object; an optional scalar's absence is None.
        self._defaults: Slots = [() if default == () else None for default in _defaults(group)]
        self._attributes = attributes
        self._actions: dict[int, Action] = {}
        for row in rows:
            slot = attributes.index(row.attribute)
            for wire_type, action in _actions(row, slot, self._name, version):
                self._actions[row.number << 3 | wire_type] = action

    def read(self, data: bytes, position: int, end: int, earlier: Any = None) -> Any:
        """The message in data[position:end], merged onto `earlier` if there is one. Raises CodecError subclasses."""
        if earlier is None:
            slots = self._defaults.copy()
        else:
            slots = [getattr(earlier, attribute) for attribute in self._attributes]
            for slot, _ in self._required:
                slots[slot] = None
        actions = self._actions
        while position < end:
            tag = data[position]
            if 8 <= tag < 0x80:
                position += 1
            else:
                tag, position = read_tag(data, position, end, self._name)
            action = actions.get(tag)
            if action is not None:
                position = action(data, position, end, slots)
            elif tag >> 3 in self._known:
                name = self._known[tag >> 3]
                raise WrongWireType(message=self._name, field=name, wire_type=tag & 7, offset=position)
            else:
                position = skip_field(data, tag, position, end, self._name)
        for slot, name in self._required:
            if slots[slot] is None:
                raise MissingRequiredField(message=self._name, field=name)
        return self._group(*slots)


def _defaults(group: type[Any]) -> list[Any]:
    """One entry per attribute of the value object: () for a repeated field, None otherwise."""
    missing = len(group.__struct_fields__) - len(group.__struct_defaults__)
    return [None] * missing + list(group.__struct_defaults__)


def _actions(row: Field, slot: int, message: str, version: FriVersion) -> list[tuple[int, Action]]:
    """Wire types under which a field is read, each with what to do."""
    match row.kind:
        case Kind.UINT32 | Kind.INT32 | Kind.UINT64:
            return [(VARINT, _integer_action(slot, message, _OF_WIDTH[row.kind]))]
        case Kind.DOUBLE:
            return [(FIXED64, _double_action(slot, message))]
        case Kind.TEXT:
            return [(LENGTH_DELIMITED, _text_action(row, slot, message))]
        case Kind.GROUP:
            return [(LENGTH_DELIMITED, _group_action(row, slot, message, version))]
        case Kind.INT32_LIST | Kind.DOUBLE_LIST:
            single, read = (VARINT, _read_int32) if row.kind is Kind.INT32_LIST else (FIXED64, _read_double)
            actions = _element_action(row, slot, message, read), _packed_action(row, slot, message, read)
            return list(zip((single, LENGTH_DELIMITED), actions, strict=True))
        case Kind.JOINT_VALUES | Kind.VECTOR:
            return [(LENGTH_DELIMITED, _doubles_message_action(row, slot, message))]


def _to_int32(value: int) -> int:
    value &= 0xFFFFFFFF
    return value - 0x100000000 if value & 0x80000000 else value


_OF_WIDTH: dict[Kind, Callable[[int], int]] = {
    Kind.UINT32: lambda value: value & 0xFFFFFFFF,
    Kind.INT32: _to_int32,
    Kind.UINT64: lambda value: value,
}


def _integer_action(slot: int, message: str, convert: Callable[[int], int]) -> Action:
    def action(data: bytes, position: int, end: int, slots: Slots) -> int:
        if position < end and data[position] < 0x80:
            slots[slot] = data[position]
            return position + 1
        value, position = read_varint(data, position, end, message)
        slots[slot] = convert(value)
        return position

    return action


def _double_action(slot: int, message: str) -> Action:
    def action(data: bytes, position: int, end: int, slots: Slots) -> int:
        slots[slot], position = _read_double(data, position, end, message)
        return position

    return action


def _text_action(row: Field, slot: int, message: str) -> Action:
    def action(data: bytes, position: int, end: int, slots: Slots) -> int:
        start, stop = read_length(data, position, end, message)
        if stop - start > MAXIMUM_NAME_BYTES:
            raise TextTooLong(message=message, field=row.name, length=stop - start, limit=MAXIMUM_NAME_BYTES)
        # Bytes that are no UTF-8 survive as surrogates and are written back as they came.
        slots[slot] = data[start:stop].decode("utf-8", "surrogateescape")
        return stop

    return action


def _group_action(row: Field, slot: int, message: str, version: FriVersion) -> Action:
    assert row.group is not None
    reader = GroupReader(row.group, version)
    if row.rule is Rule.REPEATED:

        def append(data: bytes, position: int, end: int, slots: Slots) -> int:
            start, stop = read_length(data, position, end, message)
            check_count(row, message, len(slots[slot]) + 1)
            slots[slot] = (*slots[slot], reader.read(data, start, stop))
            return stop

        return append

    def action(data: bytes, position: int, end: int, slots: Slots) -> int:
        start, stop = read_length(data, position, end, message)
        slots[slot] = reader.read(data, start, stop, slots[slot])
        return stop

    return action


Read = Callable[[bytes, int, int, str], tuple[Any, int]]
"""(data, position, end, message) -> a number and the position after it."""


def _read_int32(data: bytes, position: int, end: int, message: str) -> tuple[int, int]:
    value, position = read_varint(data, position, end, message)
    return _to_int32(value), position


def _read_double(data: bytes, position: int, end: int, message: str) -> tuple[float, int]:
    if position + 8 > end:
        raise TruncatedMessage(message=message, offset=end)
    return _DOUBLE.unpack_from(data, position)[0], position + 8


def _element_action(row: Field, slot: int, message: str, read: Read) -> Action:
    def action(data: bytes, position: int, end: int, slots: Slots) -> int:
        value, position = read(data, position, end, message)
        check_count(row, message, len(slots[slot]) + 1)
        slots[slot] = (*slots[slot], value)
        return position

    return action


def _packed_action(row: Field, slot: int, message: str, read: Read) -> Action:
    def action(data: bytes, position: int, end: int, slots: Slots) -> int:
        position, stop = read_length(data, position, end, message)
        values = list(slots[slot])
        while position < stop:
            value, position = read(data, position, stop, message)
            values.append(value)
        check_count(row, message, len(values))
        slots[slot] = tuple(values)
        return stop

    return action


def _doubles_message_action(row: Field, slot: int, message: str) -> Action:
    """JointValues and CartesianVector: a sub-message that is nothing but one list of doubles, flattened."""
    exact = row.kind is Kind.JOINT_VALUES
    inner = "JointValues" if exact else "CartesianVector"
    element = Field(1, "value" if exact else "element", Kind.DOUBLE_LIST, Rule.REPEATED, row.versions, 10_000)
    single = _element_action(element, 0, inner, _read_double)
    packed = _packed_action(element, 0, inner, _read_double)

    def action(data: bytes, position: int, end: int, slots: Slots) -> int:
        start, stop = read_length(data, position, end, message)
        earlier = slots[slot]
        if exact and earlier is None and stop - start == _SEVEN_TAGGED.size:
            tagged = _SEVEN_TAGGED.unpack_from(data, start)
            if tagged[0::2] == _SEVEN_TAGS:
                slots[slot] = tagged[1::2]
                return stop
        inner_slots: Slots = [earlier or ()]
        position = start
        while position < stop:
            tag, position = read_tag(data, position, stop, inner)
            if tag == 1 << 3 | FIXED64:
                position = single(data, position, stop, inner_slots)
            elif tag == 1 << 3 | LENGTH_DELIMITED:
                position = packed(data, position, stop, inner_slots)
            elif tag >> 3 == 1:
                raise WrongWireType(message=inner, field=element.name, wire_type=tag & 7, offset=position)
            else:
                position = skip_field(data, tag, position, stop, inner)
        values: tuple[float, ...] = inner_slots[0]
        if len(values) > row.limit or (exact and len(values) != row.limit):
            raise WrongValueCount(message=message, field=row.name, count=len(values), limit=row.limit, exact=exact)
        slots[slot] = values
        return stop

    return action
