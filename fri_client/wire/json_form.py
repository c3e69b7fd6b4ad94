"""FRI messages as JSON objects, and the lines of `iiwa-ident fri decode` and `fri encode`.

Here: value objects to and from plain dicts with the wire's own names (PROTOCOL section 3), and two functions on text,
one line in, one line out. Not here: reading stdin and printing (the command line does), bytes (`codec`).

The form: an absent field is an absent key; JointValues is {"value": [...]}, CartesianVector is {"element": [...]};
enumerations are numbers; a double is a JSON number whose shortest decimal reads back to the same bits, or one of the
strings "nan", "inf", "-inf". What JSON cannot keep: sign and payload bits of a NaN; it comes back as the quiet NaN
7ff8000000000000. Bytes of a name that are no UTF-8 appear as lone surrogates and are written back as they came.
Keys that end in "_bits" are companions in the golden files and are passed over when reading.
"""

from __future__ import annotations

import json
import math
from functools import lru_cache
from typing import Any, NoReturn

from fri_client.errors import FriError, JsonFormError, MissingRequiredField
from fri_client.messages import CommandMessage, FriVersion, MonitoringMessage
from fri_client.wire.codec import Codec
from fri_client.wire.schema import Field, Kind, Rule, group_name, rows_of

_NON_FINITE = {"nan": math.nan, "inf": math.inf, "-inf": -math.inf}
_MESSAGES: dict[str, type[Any]] = {"monitoring": MonitoringMessage, "command": CommandMessage}


def decode_line(version: FriVersion | str, direction: str, hex_text: str) -> dict[str, Any]:
    """One datagram in hexadecimal to {"ok": true, "fields": {...}}, or {"ok": false, "error": "..."}.

    direction: "monitoring" or "command". Raises ValueError for another direction or version; never for a bad datagram.
    """
    codec = _codec(FriVersion(version))
    message_type = _message_type(direction)
    try:
        datagram = bytes.fromhex(hex_text)
    except ValueError:
        return _refusal("The line is no hexadecimal text: two digits per byte are expected.")
    message: Any
    try:
        if message_type is MonitoringMessage:
            message = codec.decode_monitoring(datagram)
        else:
            message = codec.decode_command(datagram)
    except FriError as error:
        return _refusal(str(error))
    return {"ok": True, "fields": fields_of(message, codec.version)}


def encode_line(version: FriVersion | str, direction: str, json_text: str) -> str:
    """One JSON object, as `decode_line` gives it or its `fields` alone, to the datagram in lower-case hexadecimal.

    A line that describes no message gives the JSON text of {"ok": false, "error": "..."} instead. direction: as in
    `decode_line`. Raises ValueError for another direction or version; never for a bad line.
    """
    codec = _codec(FriVersion(version))
    message_type = _message_type(direction)
    try:
        document = json.loads(json_text, parse_constant=_refuse_constant)
        message = message_from_fields(message_type, codec.version, _fields_in(document))
        if message_type is MonitoringMessage:
            return codec.encode_monitoring(message).hex()
        return codec.encode_command(message).hex()
    except FriError as error:
        return json.dumps(_refusal(str(error)))
    except (ValueError, RecursionError) as error:
        return json.dumps(_refusal(f"The line is no JSON object: {error}."))


def fields_of(message: Any, version: FriVersion) -> dict[str, Any]:
    """The JSON object of a message or of one of its parts (any class of `messages` that `schema` has rows for)."""
    fields: dict[str, Any] = {}
    for row in rows_of(type(message), version):
        value = getattr(message, row.attribute)
        if value is None or value == row.default:
            continue
        fields[row.name] = _value_of(row, value, version)
    return fields


def message_from_fields(group: type[Any], version: FriVersion, fields: object, place: str = "") -> Any:
    """The value object of class `group` that a JSON object describes.

    Raises JsonFormError (with the path of the field) and MissingRequiredField; limits and ranges are the codec's.
    """
    if not isinstance(fields, dict):
        raise JsonFormError(place=place, problem="an object is expected")
    rows = {row.name: row for row in rows_of(group, version)}
    values: dict[str, Any] = {}
    for key, value in fields.items():
        if key.endswith("_bits"):
            continue
        row = rows.get(key)
        here = f"{place}.{key}" if place else key
        if row is None:
            problem = f"FRI {version.value} has no such field in {group_name(group)}"
            raise JsonFormError(place=here, problem=problem)
        values[row.attribute] = _value_from(row, value, version, here)
    for row in rows.values():
        if row.rule is Rule.REQUIRED and row.attribute not in values:
            raise MissingRequiredField(message=group_name(group), field=row.name)
    return group(**values)


def _value_of(row: Field, value: Any, version: FriVersion) -> Any:
    match row.kind:
        case Kind.GROUP if row.rule is Rule.REPEATED:
            return [fields_of(part, version) for part in value]
        case Kind.GROUP:
            return fields_of(value, version)
        case Kind.JOINT_VALUES:
            return {"value": [_number_of(number) for number in value]}
        case Kind.VECTOR:
            return {"element": [_number_of(number) for number in value]}
        case Kind.DOUBLE_LIST:
            return [_number_of(number) for number in value]
        case Kind.INT32_LIST:
            return list(value)
        case Kind.DOUBLE:
            return _number_of(value)
        case _:
            return value


def _value_from(row: Field, value: Any, version: FriVersion, place: str) -> Any:
    match row.kind:
        case Kind.GROUP:
            if row.rule is not Rule.REPEATED:
                return message_from_fields(row.group or object, version, value, place)
            parts = enumerate(_list_from(value, place))
            return tuple(
                message_from_fields(row.group or object, version, part, f"{place}[{index}]") for index, part in parts
            )
        case Kind.JOINT_VALUES:
            return _doubles_message_from(value, "value", place)
        case Kind.VECTOR:
            return _doubles_message_from(value, "element", place)
        case Kind.DOUBLE_LIST:
            return _numbers_from(value, place)
        case Kind.INT32_LIST:
            return tuple(_integer_from(number, place) for number in _list_from(value, place))
        case Kind.DOUBLE:
            return _number_from(value, place)
        case Kind.TEXT:
            if not isinstance(value, str):
                raise JsonFormError(place=place, problem="text is expected")
            return value
        case _:
            return _integer_from(value, place)


def _number_of(value: float) -> float | str:
    if math.isnan(value):
        return "nan"
    if math.isinf(value):
        return "inf" if value > 0 else "-inf"
    return value


def _number_from(value: Any, place: str) -> float:
    if isinstance(value, str) and value in _NON_FINITE:
        return _NON_FINITE[value]
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise JsonFormError(place=place, problem='a number, "nan", "inf" or "-inf" is expected')
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if math.isinf(number):
        raise JsonFormError(place=place, problem='the number is beyond a double (infinity is written "inf")')
    return number


def _integer_from(value: Any, place: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int):
        raise JsonFormError(place=place, problem="an integer is expected")
    return value


def _list_from(value: Any, place: str) -> list[Any]:
    if not isinstance(value, list):
        raise JsonFormError(place=place, problem="a list is expected")
    return value


def _numbers_from(value: Any, place: str) -> tuple[float, ...]:
    return tuple(_number_from(number, f"{place}[{index}]") for index, number in enumerate(_list_from(value, place)))


def _doubles_message_from(value: Any, key: str, place: str) -> tuple[float, ...]:
    if not isinstance(value, dict) or any(name != key and not name.endswith("_bits") for name in value):
        raise JsonFormError(place=place, problem=f'an object with the one key "{key}" is expected')
    return _numbers_from(value.get(key, []), f"{place}.{key}")


def _fields_in(document: Any) -> Any:
    """The fields of a line of `fri decode`, or the document itself where it is the fields alone."""
    if isinstance(document, dict) and "ok" in document:
        if document["ok"] is not True:
            raise JsonFormError(place="ok", problem="the line reports a refused datagram, not a message")
        return document.get("fields")
    return document


def _refuse_constant(text: str) -> NoReturn:
    raise JsonFormError(place="", problem=f'{text} is no JSON number; write "nan", "inf" or "-inf"')


def _refusal(error: str) -> dict[str, Any]:
    return {"ok": False, "error": error}


def _message_type(direction: str) -> type[Any]:
    if direction not in _MESSAGES:
        raise ValueError(f"direction must be one of {', '.join(_MESSAGES)}, not {direction!r}")
    return _MESSAGES[direction]


@lru_cache(maxsize=len(FriVersion))
def _codec(version: FriVersion) -> Codec:
    return Codec(version)
