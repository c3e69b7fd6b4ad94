"""What the bytes of a monitoring datagram say about the FRI version that sent them. Nothing on the wire names it.

Pure.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

from fri_client.errors import CodecError
from fri_client.messages import FriVersion, MonitoringMessage
from fri_client.wire.codec import Codec


@dataclass(frozen=True, slots=True)
class VersionGuess:
    """candidates: versions whose datagrams look like this, empty when none does; message: decoded as the first."""

    candidates: tuple[str, ...]
    message: MonitoringMessage | None

    def sentence(self) -> str:
        """One sentence with the version to ask for."""
        if not self.candidates:
            return "These are no FRI monitoring messages."
        if len(self.candidates) == 1:
            return f"This is FRI {self.candidates[0]}."
        return f"FRI {' or '.join(self.candidates)}: their messages look alike so far."


def guess_version(datagram: bytes) -> VersionGuess:
    """Versions that a datagram can be of (PROTOCOL §2, §13): framing tells 2.7, fields tell 1.x from 2.5.

    1.14, 1.15 and 1.16 are one format and appear as 1.15; 1.11 only differs in having no input and output groups.
    """
    framed = _decoded(datagram, FriVersion.V2_7)
    if framed is not None:
        return VersionGuess(("2.7",), framed)
    first, second = _decoded(datagram, FriVersion.V1_15), _decoded(datagram, FriVersion.V2_5)
    monitor_1 = None if first is None else first.monitor_data
    monitor_2 = None if second is None else second.monitor_data
    if monitor_1 is not None and monitor_1.commanded_joint_position is not None:
        return VersionGuess(("1.15",), first)
    if monitor_2 is not None and (
        monitor_2.measured_cartesian_pose is not None or monitor_2.measured_redundancy_information is not None
    ):
        return VersionGuess(("2.5",), second)
    candidates = tuple(version for version, message in (("1.15", first), ("2.5", second)) if message is not None)
    return VersionGuess(candidates, first if first is not None else second)


def _decoded(datagram: bytes, version: FriVersion) -> MonitoringMessage | None:
    try:
        return _codec(version).decode_monitoring(datagram)
    except CodecError:
        return None


@cache
def _codec(version: FriVersion) -> Codec:
    return Codec(version)
