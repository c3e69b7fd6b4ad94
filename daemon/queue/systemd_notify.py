"""What the service tells systemd: ready, what it does, that it lives. One datagram each, see sd_notify(3).

Outside systemd ($NOTIFY_SOCKET unset) everything here does nothing. To be called from the
server's control thread only: the watchdog then watches the thread that hears the operator.
"""

from __future__ import annotations

import contextlib
import os
import socket
import time
from collections.abc import MutableMapping


class SystemdNotifier:
    """Sends state to the socket named in the environment; never waits, never raises."""

    def __init__(self, environment: MutableMapping[str, str] = os.environ) -> None:
        """Take the address out of the environment, so that child processes do not speak for the service."""
        path = environment.pop("NOTIFY_SOCKET", "")
        limit = environment.pop("WATCHDOG_USEC", "")
        watched = environment.pop("WATCHDOG_PID", str(os.getpid()))
        # A leading @ means Linux' abstract namespace, written as a zero byte.
        self._address = "\0" + path[1:] if path.startswith("@") else path
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) if path else None
        if self._socket is not None:
            self._socket.setblocking(False)
        mine = limit.isdigit() and watched == str(os.getpid())
        self.watchdog_interval_s: float | None = int(limit) / 2e6 if mine and int(limit) else None
        self._next_beat = 0.0
        self._status = ""

    def ready(self, status: str) -> None:
        """Requests are heard from now on."""
        self._status = status
        self._send(f"READY=1\nSTATUS={_line(status)}")

    def status(self, status: str) -> None:
        """One line for `systemctl status`, sent where it changed."""
        if status != self._status:
            self._status = status
            self._send(f"STATUS={_line(status)}")

    def stopping(self) -> None:
        """The end has begun."""
        self._send("STOPPING=1")

    def beat(self) -> None:
        """Still alive; sent at half the watchdog's time, as sd_watchdog_enabled(3) advises."""
        now = time.monotonic()
        if self.watchdog_interval_s is not None and now >= self._next_beat:
            self._next_beat = now + self.watchdog_interval_s
            self._send("WATCHDOG=1")

    def close(self) -> None:
        """Give the socket back."""
        if self._socket is not None:
            self._socket.close()

    def _send(self, text: str) -> None:
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.sendto(text.encode(), self._address)


def _line(text: str) -> str:
    return " ".join(text.split())
