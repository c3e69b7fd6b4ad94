"""Ports for tests that run beside each other: none is given twice, and the kernel gives none to who asks for any."""

from __future__ import annotations

import contextlib
import secrets
import socket

__all__ = ["free_tcp_port", "free_udp_port"]

BELOW_THOSE_OF_THE_KERNEL = range(20_000, 32_000)


def free_udp_port() -> int:
    """A UDP port on loopback that nobody holds and that no other test gets while this process lives."""
    return _reserved(socket.SOCK_DGRAM, by=socket.SOCK_STREAM)


def free_tcp_port() -> int:
    """The same for TCP."""
    return _reserved(socket.SOCK_STREAM, by=socket.SOCK_DGRAM)


def _reserved(kind: socket.SocketKind, by: socket.SocketKind) -> int:
    """A port of which this process holds the number with the other kind of socket, for as long as it lives."""
    while True:
        port = secrets.choice(BELOW_THOSE_OF_THE_KERNEL)
        with socket.socket(type=by) as mark, socket.socket(type=kind) as probe, contextlib.suppress(OSError):
            mark.bind(("127.0.0.1", port))
            probe.bind(("127.0.0.1", port))
            mark.detach()
            return port
