"""What the datagrams themselves say about the FRI version the robot speaks, beside the one this run was told."""

from __future__ import annotations

from fri_client.errors import CodecError
from fri_client.messages import FriVersion
from fri_client.wire.codec import MAXIMUM_DATAGRAM_BYTES, Codec


class VersionEvidence:
    """The first message that could be read, and the first datagram that could not; judged once the run is over."""

    def __init__(self, version: FriVersion) -> None:
        self._version = version
        self._readable = b""
        self._unreadable = b""
        self._error = ""

    def note_readable(self, datagram: bytes) -> None:
        """A datagram that is a message of this run's version."""
        self._readable = self._readable or datagram

    def note_unreadable(self, datagram: bytes, error: CodecError) -> None:
        """A datagram that is none, and why."""
        if not self._unreadable:
            self._unreadable, self._error = datagram[:MAXIMUM_DATAGRAM_BYTES], str(error)

    @property
    def has_unreadable(self) -> bool:
        """Whether a datagram came that is no message of this run's version."""
        return bool(self._unreadable)

    def mismatch(self) -> str:
        """The sentence of `version_sentence` for the first datagram that could not be read."""
        return version_sentence(self._unreadable, self._error, self._version)

    def doubt(self) -> str:
        """The sentence of `version_doubt` for the first message that could be read."""
        return version_doubt(self._readable, self._version)


def version_sentence(datagram: bytes, error: str, mine: FriVersion) -> str:
    """What a datagram that is none of version `mine` is instead, found by trying the other wire formats."""
    for version in (FriVersion.V2_7, FriVersion.V2_5, FriVersion.V1_15):
        try:
            monitor = Codec(version).decode_monitoring(datagram).monitor_data
        except CodecError:
            continue
        if version == FriVersion.V2_5 and (monitor is None or monitor.measured_cartesian_pose is None):
            continue  # the same format as 1.x but for what it holds
        return f"The robot speaks FRI {version}, but this run was told FRI {mine}: choose --fri-version {version}."
    return f"Datagrams arrive, but none is a message of FRI {mine}: {error}"


def version_doubt(datagram: bytes, mine: FriVersion) -> str:
    """What speaks against version `mine` in a message that decodes as one; empty where nothing does.

    1.x and 2.5 share their wire format and a header names no version (PROTOCOL section 13). What tells them apart is
    what a robot puts in: only 1.x has a commanded joint position, only 2.x a Cartesian pose and a redundancy value. A
    robot that sends neither cannot be told, and nothing in this run depends on which it is.
    """
    try:
        first = Codec(FriVersion.V1_15).decode_monitoring(datagram).monitor_data
        second = Codec(FriVersion.V2_5).decode_monitoring(datagram).monitor_data
    except CodecError:
        return ""
    if first is None or second is None:
        return ""
    is_first = first.commanded_joint_position is not None
    is_second = second.measured_cartesian_pose is not None or second.measured_redundancy_information is not None
    if mine.major == 1 and is_second and not is_first:
        return _doubt("2.5", mine)
    if mine == FriVersion.V2_5 and is_first:
        return _doubt("1.15", mine)
    return ""


def _doubt(seen: str, mine: FriVersion) -> str:
    return (
        f" The robot's messages hold what only FRI {seen} sends, but this run was told FRI {mine}: joint positions and "
        f"torques are the same, the rest was left out; choose --fri-version {seen}."
    )
