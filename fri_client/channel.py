"""The UDP socket of the loop: blocking, with the kernel's own time-out and a small buffer.

Here only how it is made; `loop` receives and sends, the loop process decides which address.
"""

from __future__ import annotations

import contextlib
import socket
import struct

__all__ = ["forget_backlog", "open_socket"]

RECEIVE_BUFFER_BYTES = 64 * 1024
"""Of the socket: some 50 messages, 50 ms at 1 kHz. More would only keep what is too old to be worth an answer."""

_POLL_S = 0.05
"""Longest single wait in the receive, so that signals and requests are seen while the robot is silent."""


def open_socket(host: str, port: int) -> socket.socket:
    """A bound UDP socket for the loop. Raises OSError (EADDRINUSE when another program holds the port)."""
    channel = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        channel.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
        # The kernel's own time-out leaves the socket blocking: one system call per receive instead of poll and receive.
        seconds, fraction = divmod(_POLL_S, 1.0)
        channel.setsockopt(
            socket.SOL_SOCKET, socket.SO_RCVTIMEO, struct.pack("@ll", int(seconds), int(fraction * 1_000_000))
        )
        channel.bind((host, port))
    except BaseException:
        channel.close()
        raise
    return channel


def forget_backlog(channel: socket.socket) -> None:
    """Drop what the kernel kept while the motion was prepared: too old to answer, and what no longer fitted is missing.

    A bounded number, so that a robot that sends faster than we read cannot hold this up.
    """
    with contextlib.suppress(BlockingIOError):
        for _ in range(RECEIVE_BUFFER_BYTES // 100):
            channel.recv(1, socket.MSG_DONTWAIT)
