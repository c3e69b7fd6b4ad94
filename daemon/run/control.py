"""The supervisor's inbox: one ZeroMQ PULL socket that recorders push typed messages into.

ipc only, in a private folder (0700) that goes with the run, or, where that was killed, at the start of the next one.
Nothing that must not be lost depends on it: a stop goes through the ring, samples go through the ring, results go
through files. What cannot be decoded is dropped and counted.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import psutil
import zmq

from daemon.control_messages import MAXIMUM_CONTROL_BYTES, ControlMessage, decode_control
from daemon.endpoints import LONGEST_SOCKET_PATH

_PREFIX = "iiwa-run-"
"""Followed by the number of the process, whose end makes the folder useless."""


class ControlInbox:
    """A bound PULL socket; a context manager. `endpoint` is what the others connect to."""

    def __init__(self) -> None:
        self._folder = _private_folder(Path(tempfile.gettempdir()))
        path = self._folder / "control"
        if len(str(path).encode()) > LONGEST_SOCKET_PATH:
            # The system's limit on socket names; /tmp is short and private folders in it are fine.
            shutil.rmtree(self._folder, ignore_errors=True)
            self._folder = _private_folder(Path("/tmp"))
            path = self._folder / "control"
        self.endpoint = f"ipc://{path}"
        self.malformed = 0
        self._context: zmq.Context[Any] = zmq.Context()
        self._socket = self._context.socket(zmq.PULL)
        self._socket.linger = 0
        self._socket.rcvhwm = 10_000
        self._socket.setsockopt(zmq.MAXMSGSIZE, MAXIMUM_CONTROL_BYTES)
        self._socket.bind(self.endpoint)

    def receive(self, timeout_s: float) -> Iterator[ControlMessage]:
        """All messages that are there, after waiting at most timeout_s for the first."""
        if not self._socket.poll(int(timeout_s * 1000)):
            return
        while True:
            try:
                data = self._socket.recv(zmq.NOBLOCK)
            except zmq.Again:
                return
            try:
                yield decode_control(data)
            except msgspec.DecodeError:
                self.malformed += 1

    def close(self) -> None:
        """Close the socket and remove its folder."""
        self._socket.close()
        self._context.term()
        with contextlib.suppress(OSError):
            shutil.rmtree(self._folder)

    def __enter__(self) -> ControlInbox:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _private_folder(place: Path) -> Path:
    """A new folder of this process; those that killed ones of this user left behind go."""
    for left in place.glob(f"{_PREFIX}*"):
        owner = left.name.removeprefix(_PREFIX).partition("-")[0]
        with contextlib.suppress(OSError):
            if owner.isdigit() and not psutil.pid_exists(int(owner)) and left.lstat().st_uid == os.geteuid():
                shutil.rmtree(left)
    return Path(tempfile.mkdtemp(prefix=f"{_PREFIX}{os.getpid()}-", dir=place))
