"""The FRI field tables of every version: the one place where a field number, a type or a limit is written down.

Here: PROTOCOL section 3 as data, and `rows_of(group, version)`, the rows one version has. Not here: how a row becomes
bytes (`wire`, `reader`, `writer`, `layout`) or JSON (`json_form`); all of those are driven by these rows.

Source: docs of the generated message tables of the vendor's library, PROTOCOL section 3 and 13 (facts only).
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from enum import Enum, auto
from typing import Any

from fri_client import messages
from fri_client.errors import WrongValueCount
from fri_client.messages import JOINT_COUNT, FriVersion

MAXIMUM_NAME_BYTES = 63
"""A name lies in a 64-byte buffer with a closing zero byte."""


class Kind(Enum):
    """What a field holds, and thereby how it is written."""

    UINT32 = auto()
    UINT64 = auto()
    INT32 = auto()
    """Also every enumeration: a negative number is sign-extended to a 10-byte varint."""
    DOUBLE = auto()
    TEXT = auto()
    GROUP = auto()
    """A sub-message with rows of its own."""
    INT32_LIST = auto()
    """driveState: one tag per element when written, packed accepted when read."""
    DOUBLE_LIST = auto()
    """Packed doubles when written, one tag per element accepted when read."""
    JOINT_VALUES = auto()
    """A sub-message JointValues whose field 1, `value`, repeats 7 times, one tag per element; packed accepted."""
    VECTOR = auto()
    """A sub-message CartesianVector whose field 1, `element`, is a packed list of doubles."""


class Rule(Enum):
    """Presence, as in proto2."""

    REQUIRED = auto()
    OPTIONAL = auto()
    REPEATED = auto()


@dataclass(frozen=True, slots=True)
class Field:
    """One row: number and name on the wire, kind, presence, greatest count, type of the sub-message, versions."""

    number: int
    name: str
    kind: Kind
    rule: Rule
    versions: frozenset[FriVersion]
    limit: int = 0
    group: type[Any] | None = None
    attribute: str = field(init=False)
    """Name of the field in the value object: readIORequest is read_io_request."""
    default: tuple[()] | None = field(init=False)
    """The value that stands for absent."""

    def __post_init__(self) -> None:
        words = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", self.name).lower()
        object.__setattr__(self, "attribute", words)
        object.__setattr__(self, "default", () if self.rule is Rule.REPEATED else None)


_EVERY = frozenset(FriVersion)
_ONE = frozenset(version for version in FriVersion if version.major == 1)
_TWO = _EVERY - _ONE
_WITH_IO = _EVERY - {FriVersion.V1_11}
_WITH_ENDING = _EVERY - {FriVersion.V2_7}
_ONLY_2_7 = frozenset({FriVersion.V2_7})

_REQ, _OPT, _REP = Rule.REQUIRED, Rule.OPTIONAL, Rule.REPEATED


def _joints(number: int, name: str, versions: frozenset[FriVersion] = _EVERY) -> Field:
    return Field(number, name, Kind.JOINT_VALUES, _OPT, versions, JOINT_COUNT)


def _vector(number: int, name: str, versions: frozenset[FriVersion]) -> Field:
    return Field(number, name, Kind.VECTOR, _OPT, versions, 6)


def _part(number: int, name: str, group: type[Any], versions: frozenset[FriVersion] = _EVERY) -> Field:
    return Field(number, name, Kind.GROUP, _OPT, versions, 0, group)


def _header() -> Field:
    return Field(1, "header", Kind.GROUP, _REQ, _EVERY, 0, messages.MessageHeader)


def _transformations(number: int, name: str) -> tuple[Field, Field]:
    return (
        Field(number, name, Kind.GROUP, _REP, _ONE, 5, messages.Transformation),
        Field(number, name, Kind.GROUP, _REP, _TWO, 5, messages.QuaternionTransformation),
    )


def _ios(number: int, name: str) -> Field:
    return Field(number, name, Kind.GROUP, _REP, _WITH_IO, 10, messages.IoValue)


def _number(number: int, name: str, kind: Kind, rule: Rule = _OPT, versions: frozenset[FriVersion] = _EVERY) -> Field:
    return Field(number, name, kind, rule, versions)


def _frame(list_name: str, limit: int, versions: frozenset[FriVersion]) -> tuple[Field, ...]:
    return (
        _number(1, "name", Kind.TEXT, _REQ, versions),
        Field(2, list_name, Kind.DOUBLE_LIST, _REP, versions, limit),
        _part(3, "timestamp", messages.TimeStamp, versions),
    )


_TABLE: dict[type[Any], tuple[str, tuple[Field, ...]]] = {
    messages.MonitoringMessage: (
        "FRIMonitoringMessage",
        (
            _header(),
            _part(2, "robotInfo", messages.RobotInfo),
            _part(3, "monitorData", messages.MonitorData),
            _part(4, "connectionInfo", messages.ConnectionInfo),
            _part(5, "ipoData", messages.IpoData),
            *_transformations(6, "requestedTransformations"),
            _part(15, "endOfMessageData", messages.EndOfMessageData, _WITH_ENDING),
            _number(2047, "announcement", Kind.TEXT),  # ours: no cabinet sends it
        ),
    ),
    messages.CommandMessage: (
        "FRICommandMessage",
        (
            _header(),
            _part(2, "commandData", messages.CommandData),
            _part(15, "endOfMessageData", messages.EndOfMessageData, _WITH_ENDING),
        ),
    ),
    messages.MessageHeader: (
        "MessageHeader",
        (
            _number(1, "messageIdentifier", Kind.UINT32, _REQ),
            _number(2, "sequenceCounter", Kind.UINT32, _REQ),
            _number(3, "reflectedSequenceCounter", Kind.UINT32, _REQ),
        ),
    ),
    messages.RobotInfo: (
        "RobotInfo",
        (
            _number(1, "numberOfJoints", Kind.INT32),
            _number(2, "safetyState", Kind.INT32),
            Field(5, "driveState", Kind.INT32_LIST, _REP, _EVERY, JOINT_COUNT),
            _number(6, "operationMode", Kind.INT32),
            _number(7, "controlMode", Kind.INT32),
        ),
    ),
    messages.MonitorData: (
        "MessageMonitorData",
        (
            _joints(1, "measuredJointPosition"),
            _joints(2, "measuredTorque"),
            _joints(3, "commandedJointPosition", _ONE),
            _joints(4, "commandedTorque"),
            _joints(5, "externalTorque"),
            _vector(6, "externalForce", _ONLY_2_7),
            _ios(8, "readIORequest"),
            _part(9, "measuredCartesianPose", messages.QuaternionTransformation, _TWO),
            _part(10, "measuredRedundancyInformation", messages.RedundancyInformation, _TWO),
            _part(15, "timestamp", messages.TimeStamp),
        ),
    ),
    messages.ConnectionInfo: (
        "ConnectionInfo",
        (
            _number(1, "sessionState", Kind.INT32, _REQ),
            _number(2, "quality", Kind.INT32, _REQ),
            _number(3, "sendPeriod", Kind.UINT32),
            _number(4, "receiveMultiplier", Kind.UINT32),
        ),
    ),
    messages.IpoData: (
        "MessageIpoData",
        (
            _joints(1, "jointPosition"),
            _part(2, "cartesianPose", messages.QuaternionTransformation, _TWO),
            _part(3, "redundancyInformation", messages.RedundancyInformation, _TWO),
            _number(10, "clientCommandMode", Kind.INT32),
            _number(11, "overlayType", Kind.INT32),
            _number(12, "trackingPerformance", Kind.DOUBLE),
        ),
    ),
    messages.CommandData: (
        "MessageCommandData",
        (
            _joints(1, "jointPosition"),
            _vector(2, "cartesianWrenchFeedForward", _EVERY),
            _joints(3, "jointTorque"),
            *_transformations(4, "commandedTransformations"),
            _ios(5, "writeIORequest"),
            _part(6, "cartesianPose", messages.QuaternionTransformation, _TWO),
            _part(7, "redundancyInformation", messages.RedundancyInformation, _TWO),
        ),
    ),
    messages.TimeStamp: ("TimeStamp", (_number(1, "sec", Kind.UINT32, _REQ), _number(2, "nanosec", Kind.UINT32, _REQ))),
    messages.IoValue: (
        "FriIOValue",
        (
            _number(1, "name", Kind.TEXT, _REQ, _WITH_IO),
            _number(2, "type", Kind.INT32, _REQ, _WITH_IO),
            _number(3, "direction", Kind.INT32, _REQ, _WITH_IO),
            _number(4, "digitalValue", Kind.UINT64, _OPT, _WITH_IO),
            _number(5, "analogValue", Kind.DOUBLE, _OPT, _WITH_IO),
        ),
    ),
    messages.Transformation: ("Transformation", _frame("matrix", 12, _ONE)),
    messages.QuaternionTransformation: ("QuaternionTransformation", _frame("element", 7, _TWO)),
    messages.RedundancyInformation: (
        "RedundancyInformation",
        (_number(1, "strategy", Kind.INT32, _REQ, _TWO), _number(2, "value", Kind.DOUBLE, _REQ, _TWO)),
    ),
    messages.EndOfMessageData: (
        "MessageEndOf",
        (
            _number(1, "messageLength", Kind.INT32, _OPT, _WITH_ENDING),
            _part(2, "messageChecksum", messages.Checksum, _WITH_ENDING),
        ),
    ),
    messages.Checksum: ("Checksum", (_number(1, "crc32", Kind.INT32, _OPT, _WITH_ENDING),)),
}


def group_name(group: type[Any]) -> str:
    """The name the protocol gives the message that `group` holds, e.g. MessageMonitorData for MonitorData."""
    return _TABLE[group][0]


def rows_of(group: type[Any], version: FriVersion) -> tuple[Field, ...]:
    """The rows of `group` that `version` has, in ascending field number: the order in which they are written."""
    return _ROWS[group, version]


def check_count(row: Field, message: str, count: int) -> None:
    """Raises WrongValueCount for more values than the row allows."""
    if count > row.limit:
        raise WrongValueCount(message=message, field=row.name, count=count, limit=row.limit, exact=False)


_ROWS = {
    (group, version): tuple(sorted((row for row in rows if version in row.versions), key=lambda row: row.number))
    for group, (_, rows) in _TABLE.items()
    for version in FriVersion
}
