"""Messages to bytes, exactly as the vendor's library writes them.

Here: one `GroupWriter` per message type and version, made once from the rows of `schema`: ascending field numbers,
joint values and drive states with a tag per element, the other arrays packed, zeros and negative zeros written
(PROTOCOL section 3.1). Not here: frames and identifiers (`codec`). Refused are values that a field cannot hold and
fields that the version does not have; non-finite numbers are written as they are.
"""

from __future__ import annotations

import operator
import struct
from collections.abc import Callable, Sequence
from typing import Any

from fri_client.errors import (
    CodecError,
    FieldNotInVersion,
    InvalidFieldValue,
    MissingRequiredField,
    TextTooLong,
    WrongValueCount,
)
from fri_client.messages import FriVersion
from fri_client.wire.primitives import FIXED64, LENGTH_DELIMITED, VARINT, varint
from fri_client.wire.schema import MAXIMUM_NAME_BYTES, Field, Kind, Rule, check_count, group_name, rows_of

Emit = Callable[[Any], bytes]
"""The bytes of one present field, tag included."""

_DOUBLE = struct.Struct("<d")
_SEVEN_TAGGED = struct.Struct("<" + "Bd" * 7)
_TAG = 1 << 3 | FIXED64


def joint_values(values: Sequence[float]) -> bytes:
    """The 63 bytes of a JointValues message with the 7 `values`. Raises struct.error, TypeError, ValueError."""
    a, b, c, d, e, f, g = values
    return _SEVEN_TAGGED.pack(_TAG, a, _TAG, b, _TAG, c, _TAG, d, _TAG, e, _TAG, f, _TAG, g)


class GroupWriter:
    """Writes the messages of one type in one version."""

    def __init__(self, group: type[Any], version: FriVersion) -> None:
        self._group = group
        self._name = group_name(group)
        self._version = version
        rows = rows_of(group, version)
        self._emitters = tuple(
            (row.attribute, row.name, row.rule is Rule.REQUIRED, _emitter(row, self._name, version)) for row in rows
        )
        written = {row.attribute for row in rows}
        self._foreign = tuple(name for name in group.__struct_fields__ if name not in written)

    def write(self, message: Any) -> bytes:
        """The bytes of `message`. Raises EncodeError subclasses, MissingRequiredField, WrongValueCount, TextTooLong."""
        if not isinstance(message, self._group):
            expected = f"a {self._group.__name__}"
            raise InvalidFieldValue(message=self._name, field="(itself)", value=message, expected=expected)
        pieces = []
        for attribute, name, required, emit in self._emitters:
            value = getattr(message, attribute)
            if value is None:
                if required:
                    raise MissingRequiredField(message=self._name, field=name)
                continue
            try:
                pieces.append(emit(value))
            except CodecError:
                raise
            except (TypeError, ValueError, OverflowError, struct.error) as error:
                expected = "of the field's own type"
                raise InvalidFieldValue(message=self._name, field=name, value=value, expected=expected) from error
        for attribute in self._foreign:
            if getattr(message, attribute) not in (None, ()):
                raise FieldNotInVersion(message=self._name, field=attribute, version=self._version.value)
        return b"".join(pieces)


def _emitter(row: Field, message: str, version: FriVersion) -> Emit:
    match row.kind:
        case Kind.UINT32 | Kind.UINT64 | Kind.INT32:
            return _integer_emitter(row, message)
        case Kind.DOUBLE:
            tag = varint(row.number << 3 | FIXED64)
            return lambda value: tag + _DOUBLE.pack(value)
        case Kind.TEXT:
            return _text_emitter(row, message)
        case Kind.GROUP:
            return _group_emitter(row, message, version)
        case Kind.INT32_LIST:
            return _repeated(row, message, _integer_emitter(row, message))
        case Kind.DOUBLE_LIST:
            return _packed_emitter(row, message)
        case Kind.JOINT_VALUES | Kind.VECTOR:
            return _doubles_message_emitter(row, message)


def _integer_emitter(row: Field, message: str) -> Emit:
    tag = varint(row.number << 3 | VARINT)
    lower, upper, expected = {
        Kind.UINT32: (0, 1 << 32, "an integer from 0 to 2^32 - 1"),
        Kind.UINT64: (0, 1 << 64, "an integer from 0 to 2^64 - 1"),
    }.get(row.kind, (-(1 << 31), 1 << 31, "an integer from -2^31 to 2^31 - 1"))

    def emit(value: Any) -> bytes:
        number = operator.index(value)
        if not lower <= number < upper:
            raise InvalidFieldValue(message=message, field=row.name, value=value, expected=expected)
        return tag + varint(number & 0xFFFFFFFFFFFFFFFF)

    return emit


def _text_emitter(row: Field, message: str) -> Emit:
    tag = varint(row.number << 3 | LENGTH_DELIMITED)

    def emit(value: Any) -> bytes:
        if not isinstance(value, str):
            raise InvalidFieldValue(message=message, field=row.name, value=value, expected="text")
        text = value.encode("utf-8", "surrogateescape")
        if len(text) > MAXIMUM_NAME_BYTES:
            raise TextTooLong(message=message, field=row.name, length=len(text), limit=MAXIMUM_NAME_BYTES)
        return tag + varint(len(text)) + text

    return emit


def _group_emitter(row: Field, message: str, version: FriVersion) -> Emit:
    assert row.group is not None
    tag = varint(row.number << 3 | LENGTH_DELIMITED)
    write = GroupWriter(row.group, version).write

    def emit(value: Any) -> bytes:
        body = write(value)
        return tag + varint(len(body)) + body

    return _repeated(row, message, emit) if row.rule is Rule.REPEATED else emit


def _repeated(row: Field, message: str, emit: Emit) -> Emit:
    def emit_each(values: Any) -> bytes:
        check_count(row, message, len(values))
        return b"".join([emit(value) for value in values])

    return emit_each


def _packed_emitter(row: Field, message: str) -> Emit:
    tag = varint(row.number << 3 | LENGTH_DELIMITED)

    def emit(values: Any) -> bytes:
        count = len(values)
        check_count(row, message, count)
        return tag + varint(8 * count) + struct.pack(f"<{count}d", *values) if count else b""

    return emit


def _doubles_message_emitter(row: Field, message: str) -> Emit:
    tag = varint(row.number << 3 | LENGTH_DELIMITED)
    if row.kind is Kind.JOINT_VALUES:
        head = tag + varint(_SEVEN_TAGGED.size)

        def emit(values: Any) -> bytes:
            if len(values) != row.limit:
                count = len(values)
                raise WrongValueCount(message=message, field=row.name, count=count, limit=row.limit, exact=True)
            return head + joint_values(values)

        return emit
    element = Field(1, "element", Kind.DOUBLE_LIST, Rule.REPEATED, row.versions, row.limit)
    packed = _packed_emitter(element, message)

    def emit_vector(values: Any) -> bytes:
        check_count(row, message, len(values))
        body = packed(values)
        return tag + varint(len(body)) + body

    return emit_vector
