"""The UDP socket of the loop: blocking, with the kernel's own time-out and a small buffer; and what waits in it.

Here: how the socket is made, and looking at its queue. `loop` receives and sends; the loop process names the address.
"""

from __future__ import annotations

import select
import socket
import struct

from fri_client.codec import Codec
from fri_client.errors import CodecError

__all__ = ["Queue", "open_socket", "unbound_socket"]

RECEIVE_BUFFER_BYTES = 64 * 1024
"""Of the socket: some 50 messages, 50 ms at 1 kHz. More would only keep what is too old to be worth an answer."""

_POLL_S = 0.05
"""Longest single wait in the receive, so that signals and requests are seen while the robot is silent."""


def open_socket(host: str, port: int) -> socket.socket:
    """A bound UDP socket for the loop. Raises OSError (EADDRINUSE when another program holds the port)."""
    channel = unbound_socket()
    try:
        channel.bind((host, port))
    except BaseException:
        channel.close()
        raise
    return channel


def unbound_socket() -> socket.socket:
    """The same before `bind`. As long as it is not bound no message piles up in it that nobody answers in time."""
    channel = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    channel.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
    # The kernel's own time-out leaves the socket blocking: one system call per receive instead of poll and receive.
    seconds, fraction = divmod(_POLL_S, 1.0)
    channel.setsockopt(
        socket.SOL_SOCKET, socket.SO_RCVTIMEO, struct.pack("@ll", int(seconds), int(fraction * 1_000_000))
    )
    return channel


class Queue:
    """What waits in the kernel for this socket."""

    __slots__ = ("_buffer", "_channel", "_codec", "_poll", "_view")

    def __init__(self, channel: socket.socket, codec: Codec) -> None:
        self._channel = channel
        self._codec = codec
        self._buffer = bytearray(2048)
        self._view = memoryview(self._buffer)
        self._poll = select.poll()
        self._poll.register(channel, select.POLLIN)

    def holds_newer_than(self, counter: int, robot: tuple[str, int] | None) -> bool:
        """True when a newer message of `robot` waits already; one system call of 1 µs where nothing does.

        Looked at is the next datagram alone: a duplicate or an older message behind another does not make that late.
        """
        if not self._poll.poll(0):
            return False
        try:
            size, address = self._channel.recvfrom_into(self._buffer, 0, socket.MSG_PEEK | socket.MSG_DONTWAIT)
        except BlockingIOError:  # it had a wrong UDP checksum, which the kernel notices only now
            return False
        if address != robot:
            return False
        try:
            waiting = self._codec.decode_monitoring(self._view[:size]).header.sequence_counter
        except CodecError:
            return False
        return 0 < (waiting - counter & 0xFFFFFFFF) < 1 << 31
