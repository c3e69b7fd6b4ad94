"""What the datagrams themselves say about the FRI version the robot speaks, beside the one this run was told."""

from __future__ import annotations

from fri_client.errors import CodecError
from fri_client.messages import FriVersion
from fri_client.wire.codec import MAXIMUM_DATAGRAM_BYTES
from fri_client.wire.version_guess import guess_version


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
        """What the first datagram that could not be read is instead, found by trying the other wire formats."""
        seen, mine = guess_version(self._unreadable).candidates, self._version
        if not seen:
            return f"Datagrams arrive, but none is a message of FRI {mine}: {self._error}"
        return f"The robot speaks FRI {seen[0]}, but this run was told FRI {mine}: choose --fri-version {seen[0]}."

    def doubt(self) -> str:
        """The sentence of `version_doubt` for the first message that could be read."""
        return version_doubt(self._readable, self._version)


def version_doubt(datagram: bytes, mine: FriVersion) -> str:
    """What speaks against version `mine` in a message that decodes as one; empty where nothing does.

    1.x and 2.5 share their wire format and a header names no version (PROTOCOL section 13). A robot that sends nothing
    that tells them apart cannot be told, and nothing in this run depends on which it is.
    """
    seen = guess_version(datagram).candidates
    if (mine.major, seen) != (1, ("2.5",)) and (mine, seen) != (FriVersion.V2_5, ("1.15",)):
        return ""
    return (
        f" The robot's messages hold what only FRI {seen[0]} sends, but this run was told FRI {mine}: joint positions "
        f"and torques are the same, the rest was left out; choose --fri-version {seen[0]}."
    )
