"""The UDP socket of the loop: blocking, with the kernel's own time-out and a small buffer.

Here: how the socket is made, and the four things that the loop does with it. A `Channel` is all that the loop knows of
a network and of what waits in it, so that a test can put a simulated one in its place.
"""

from __future__ import annotations

import select
import socket
import struct
from typing import Protocol

Address = tuple[str, int]

RECEIVE_BUFFER_BYTES = 64 * 1024
"""Of the socket: some 50 messages, 50 ms at 1 kHz. More would only keep what is too old to be worth an answer."""

_POLL_S = 0.05
"""Longest single wait in the receive, so that signals and requests are seen while the robot is silent."""


class Channel(Protocol):
    """Datagrams in and out."""

    def receive_into(self, buffer: bytearray) -> tuple[int, Address]:
        """Wait for the next datagram: its length and its sender. Raises BlockingIOError after the time-out."""

    def receive_waiting_into(self, buffer: bytearray) -> tuple[int, Address] | None:
        """The same for a datagram that is there already; None where none is."""

    def is_waiting(self) -> bool:
        """Whether a datagram is there."""

    def wait(self, seconds: float) -> bool:
        """Wait until a datagram is there, at most so long; whether one is. Nothing is taken out."""

    def send(self, datagram: bytes, address: Address) -> bool:
        """Send one; False where the network refused it. It then counts as never sent, for the robot and in the log."""


class UdpChannel:
    """A UDP socket. As long as it is not bound no message piles up in it that nobody answers in time."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
        # The kernel's own time-out leaves the socket blocking: one system call per receive instead of poll and receive.
        seconds, fraction = divmod(_POLL_S, 1.0)
        self._socket.setsockopt(
            socket.SOL_SOCKET, socket.SO_RCVTIMEO, struct.pack("@ll", int(seconds), int(fraction * 1_000_000))
        )
        self._poll = select.poll()
        self._poll.register(self._socket, select.POLLIN)
        self.receive_into = self._socket.recvfrom_into

    def bind(self, host: str, port: int) -> None:
        """Raises OSError (EADDRINUSE when another program holds the port)."""
        self._socket.bind((host, port))

    @property
    def address(self) -> Address:
        """Host and port that it is bound to."""
        host, port = self._socket.getsockname()
        return host, port

    def fileno(self) -> int:
        """Descriptor of the socket, for a process that inherits it."""
        return self._socket.fileno()

    def receive_waiting_into(self, buffer: bytearray) -> tuple[int, Address] | None:
        """See `Channel`."""
        try:
            return self._socket.recvfrom_into(buffer, 0, socket.MSG_DONTWAIT)
        except BlockingIOError:  # also a datagram with a wrong UDP checksum, which the kernel notices only now
            return None

    def is_waiting(self) -> bool:
        """See `Channel`; one system call of 1 µs."""
        return bool(self._poll.poll(0))

    def wait(self, seconds: float) -> bool:
        """See `Channel`."""
        return bool(select.select((self._socket,), (), (), seconds)[0])

    def send(self, datagram: bytes, address: Address) -> bool:
        """See `Channel`."""
        try:
            self._socket.sendto(datagram, address)
        except OSError:
            return False
        return True

    def close(self) -> None:
        """Give the port back."""
        self._socket.close()

    def __enter__(self) -> UdpChannel:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
