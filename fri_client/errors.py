"""Every error of the FRI client, as one tree; each carries its data as attributes and an exit code of the contract.

    FriError                        76  protocol or version mismatch
    ├── UnknownFriVersion           78  a version this client does not speak
    ├── CodecError                  76  a datagram or message that is refused
    │   ├── DecodeError                 bytes that are no message of this version
    │   │   ├── TruncatedMessage            the bytes end inside a field
    │   │   ├── MalformedVarint             a varint of more than 10 bytes
    │   │   ├── WrongWireType               a known field, or any field, with a wire type it cannot have
    │   │   ├── InvalidFieldNumber          field number 0 (also: trailing zero bytes) or beyond 2^29 - 1
    │   │   └── BadFrame                    2.7: length or checksum around the payload
    │   │       ├── WrongFrameLength
    │   │       └── WrongChecksum
    │   ├── EncodeError                 values that fit no message of this version
    │   │   ├── InvalidFieldValue           a type or a range the field cannot hold
    │   │   └── FieldNotInVersion           a field that this version does not have
    │   ├── WrongMessageIdentifier      well-formed, but not the message that was asked for
    │   ├── MissingRequiredField        a required field is absent
    │   ├── WrongValueCount             a joint array without exactly 7 values, an array with too many
    │   ├── TextTooLong                 a name of more than 63 bytes
    │   └── MessageTooLong              more than the 1500 bytes the vendor's buffers hold
    ├── JsonFormError               65  a JSON object that is no message
    ├── RealRobot                    1  a robot that does not say that it is the fake one, where nobody was asked
    ├── MotionError                 65  a table that cannot be driven as asked (in motion/table.py)
    └── HandoverError               70  the ring to the recorder cannot be made or found (in handover/errors.py)
        └── NoMemoryForHandover     74  the operating system refuses its memory

Here: the classes and their sentences. Not here: what anyone does about them. Everyone in and above this package
may catch `FriError`; decoding and encoding raise `CodecError` and nothing else.
"""

from __future__ import annotations

from typing import ClassVar


class FriError(Exception):
    """Root of every error of this package; `exit_code` is the process exit code of the contract."""

    exit_code: ClassVar[int] = 76


class UnknownFriVersion(FriError, ValueError):
    """The text names no FRI version this client speaks."""

    exit_code: ClassVar[int] = 78

    def __init__(self, *, version: str, known: tuple[str, ...]) -> None:
        super().__init__(f"FRI version {version!r} is not known; choose one of {', '.join(known)}.")
        self.version = version
        self.known = known


class RealRobot(FriError):
    """The run was meant for the fake robot, and the robot that answers does not say that it is one."""

    exit_code: ClassVar[int] = 1

    def __init__(self) -> None:
        super().__init__(
            "The robot does not say that it is the fake robot, so an arm may move, and nobody was asked: nothing was "
            "moved. If a cabinet is relayed to this loopback address, say --real-robot (service: fri.real_robot: true)."
        )


class CodecError(FriError):
    """A datagram or a message is refused; nothing of it was kept."""


class DecodeError(CodecError):
    """The bytes are no FRI message of the version in use."""


class TruncatedMessage(DecodeError):
    """The bytes end inside a field, at byte `offset`."""

    def __init__(self, *, message: str, offset: int) -> None:
        super().__init__(f"The datagram ends inside {message} at byte {offset}: it is cut off or no FRI message.")
        self.message = message
        self.offset = offset


class MalformedVarint(DecodeError):
    """A variable-length integer does not end within 10 bytes."""

    def __init__(self, *, message: str, offset: int) -> None:
        super().__init__(f"The number at byte {offset} of {message} is longer than 10 bytes.")
        self.message = message
        self.offset = offset


class WrongWireType(DecodeError):
    """A field has a wire type that it, or any FRI field, cannot have."""

    def __init__(self, *, message: str, field: str, wire_type: int, offset: int) -> None:
        super().__init__(
            f"Field {field} of {message} has wire type {wire_type} at byte {offset}, which it cannot have."
        )
        self.message = message
        self.field = field
        self.wire_type = wire_type
        self.offset = offset


class InvalidFieldNumber(DecodeError):
    """A field number that no message can have; trailing zero bytes read as field number 0."""

    def __init__(self, *, message: str, number: int, offset: int) -> None:
        super().__init__(f"Byte {offset} of {message} names field {number}, which no message has (trailing bytes?).")
        self.message = message
        self.number = number
        self.offset = offset


class BadFrame(DecodeError):
    """The frame that 2.7 puts around the payload is wrong; the payload was not looked at."""


class WrongFrameLength(BadFrame):
    """The length prefix does not agree with the size of the datagram."""

    def __init__(self, *, declared: int | None, available: int) -> None:
        if declared is None:
            what = f"The datagram has {available + 8} bytes, too few for the length and checksum of FRI 2.7"
        else:
            what = f"The FRI 2.7 length prefix says {declared}, but the datagram leaves {available} payload bytes"
        super().__init__(f"{what}; the other side may speak another FRI version.")
        self.declared = declared
        self.available = available


class WrongChecksum(BadFrame):
    """The CRC-32 of the payload is not the one the datagram carries."""

    def __init__(self, *, carried: int, computed: int) -> None:
        super().__init__(f"The datagram carries CRC-32 {carried:08x} but its payload has {computed:08x}.")
        self.carried = carried
        self.computed = computed


class EncodeError(CodecError):
    """The values fit no FRI message of the version in use."""


class InvalidFieldValue(EncodeError):
    """A value has a type or a range that its field cannot hold."""

    def __init__(self, *, message: str, field: str, value: object, expected: str) -> None:
        super().__init__(f"Field {field} of {message} must be {expected}, not {value!r}.")
        self.message = message
        self.field = field
        self.value = value
        self.expected = expected


class FieldNotInVersion(EncodeError):
    """A field is set that this FRI version does not have."""

    def __init__(self, *, message: str, field: str, version: str) -> None:
        super().__init__(f"FRI {version} has no field {field} in {message}.")
        self.message = message
        self.field = field
        self.version = version


class WrongMessageIdentifier(CodecError):
    """The message is well-formed but is not the kind that was asked for."""

    def __init__(self, *, identifier: int, expected: int) -> None:
        super().__init__(f"The message identifier is {identifier:#x} where {expected:#x} is expected.")
        self.identifier = identifier
        self.expected = expected


class MissingRequiredField(CodecError):
    """A field without which the message means nothing is absent."""

    def __init__(self, *, message: str, field: str) -> None:
        super().__init__(f"{message} lacks its required field {field}.")
        self.message = message
        self.field = field


class WrongValueCount(CodecError):
    """An array does not hold the number of values it must (`exact`) or may (at most `limit`)."""

    def __init__(self, *, message: str, field: str, count: int, limit: int, exact: bool) -> None:
        super().__init__(
            f"{field} of {message} holds {count} values where {'exactly' if exact else 'at most'} {limit} are allowed."
        )
        self.message = message
        self.field = field
        self.count = count
        self.limit = limit
        self.exact = exact


class TextTooLong(CodecError):
    """A name is longer than the vendor's buffer."""

    def __init__(self, *, message: str, field: str, length: int, limit: int) -> None:
        super().__init__(f"{field} of {message} has {length} bytes where at most {limit} are allowed.")
        self.message = message
        self.field = field
        self.length = length
        self.limit = limit


class MessageTooLong(CodecError):
    """The datagram exceeds what the vendor's buffers hold."""

    def __init__(self, *, length: int, limit: int) -> None:
        super().__init__(f"The datagram has {length} bytes where an FRI datagram has at most {limit}.")
        self.length = length
        self.limit = limit


class JsonFormError(FriError):
    """A JSON text does not describe an FRI message; `place` is the path of the field at fault."""

    exit_code: ClassVar[int] = 65

    def __init__(self, *, place: str, problem: str) -> None:
        super().__init__(f"{place}: {problem}." if place else f"{problem}.")
        self.place = place
        self.problem = problem
