"""A look at a datagram that takes out only what the next answer needs, where everything else is as it was.

While an arm moves, all that changes from one message to the next are two counters, the time stamp, and measured
numbers. A `Glance` is made from one datagram after its answer has left. It says of later ones of the same length:
whether every other bit is the same (state, quality, safety state, drives, modes, periods, texts), the counter is the
one expected, every number is finite and every joint position one that an arm can have. If so, it gives measured
position and external torque; if not, None, and the message goes the whole way through codec and session. Not here: what
may be concluded from that (`answer_ahead`), and the drawing of shapes (`layout`), whose sketch this uses.

The steps are few and simple, because each of them delays the answer, and the caches are cold. The hundreds of bytes of
a message are compared as one integer.
"""

from __future__ import annotations

import struct

from fri_client.messages import FriVersion, MonitoringMessage
from fri_client.wire.layout import Sketch, sketch_group
from fri_client.wire.schema import Field

_FREE = frozenset({"sequence_counter", "reflected_sequence_counter", "sec", "nanosec"})
"""Integers that may change without a change of anything the session watches."""

_ANGLES = ("measured_joint_position", "commanded_joint_position", "joint_position")
"""Joint positions of a message: measured, commanded, of the IPO. The session refuses what is beyond FARTHEST_RAD."""

# A double is no finite number where its eleven exponent bits are all ones: adding the lowest of them then carries into
# the place of the sign. Adding more lets smaller numbers carry too: from 4 on, which is nearer than FARTHEST_RAD.
_EXPONENT = (0x7FF << 52).to_bytes(8, "little")
_ONE = (1 << 52).to_bytes(8, "little")
_FROM_FOUR = (0x800 - 0x401 << 52).to_bytes(8, "little")
_CARRY = (1 << 63).to_bytes(8, "little")


class _HeldSketch(Sketch):
    def holds(self, row: Field) -> bool:
        return row.attribute not in _FREE


class Glance:
    """Made by `Glance.at`; `read` is the look."""

    def __init__(self, sketch: Sketch, wanted: list[slice]) -> None:
        self._mask = int.from_bytes(sketch.mask, "little")
        self._expected = int.from_bytes(sketch.expected, "little")
        kept = {place for part in wanted for place in _range(part)}
        angles = {place for name in _ANGLES if name in sketch.places for place in _range(sketch.places[name])}
        formats, lanes = ["<"], [bytearray(), bytearray(), bytearray()]
        place = 0
        self._counter_offset = 0
        for code in sketch.formats:
            if place == sketch.places["sequence_counter"].start and not self._counter_offset and code == "B":
                self._counter_offset = len(lanes[0])
            added = _FROM_FOUR if place in angles else _ONE
            for lane, double in zip(lanes, (_EXPONENT, added, _CARRY), strict=True):
                lane += double if code == "d" else bytes(struct.calcsize("<" + code))
            formats.append(code if place in kept and code == "d" else f"{struct.calcsize('<' + code)}x")
            place += not code.endswith("x")
        self._exponents, self._ones, self._carry = (int.from_bytes(lane, "little") for lane in lanes)
        self._unpack = struct.Struct("".join(formats)).unpack

    @classmethod
    def at(cls, payload: bytes, message: MonitoringMessage, version: FriVersion) -> Glance | None:
        """The look at datagrams like this payload, read as `message`; None where there can be none."""
        sketch = _HeldSketch()
        sketch_group(sketch, MonitoringMessage, version, message)
        measured = sketch.places.get("measured_joint_position")
        if measured is None or len(sketch.mask) != len(payload):
            return None
        external = sketch.places.get("external_torque")
        glance = cls(sketch, [measured] if external is None else [measured, external])
        return None if glance.read(payload, b"") is None else glance

    def read(self, payload: bytes, counter: bytes) -> tuple[float, ...] | None:
        """Measured position in rad, 7, and external torque in Nm, 7, if the robot sends it; None where this is no
        datagram like the one the glance was made from, or its sequence counter is not the one with these varint bytes.
        """
        bits = int.from_bytes(payload, "little")
        if (
            bits & self._mask != self._expected
            or (bits & self._exponents) + self._ones & self._carry
            or not payload.startswith(counter, self._counter_offset)
        ):
            return None
        return self._unpack(payload)


def _range(places: slice) -> range:
    return range(places.start, places.stop)
