"""A watcher's side of the live view: which runs can be seen on this machine, and their frames as they come."""

from __future__ import annotations

import contextlib
import re
import socket
from pathlib import Path
from typing import Any

import msgspec
import zmq

from daemon.live.frame import LiveFrame
from daemon.runtime_folder import live_endpoint, runtime_folder

_FRAMES_KEPT = 200
_MAXIMUM_BYTES = 65536


def served_ports() -> list[int]:
    """UDP ports with a live view of this user; the socket that a killed recorder left is none."""
    found = {path: re.fullmatch(r"watch-(\d+)", path.name) for path in runtime_folder().iterdir()}
    return sorted(int(match[1]) for path, match in found.items() if match and _is_listened_at(path))


def _is_listened_at(path: Path) -> bool:
    """Whether a process has this socket: the kernel refuses a connection where none has."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_NONBLOCK) as probe:
        try:
            probe.connect(str(path))
        except (ConnectionRefusedError, FileNotFoundError):
            return False
        except OSError:  # one that is held (SIGSTOP) takes no more, say
            return True
    return True


class LiveSubscription:
    """Frames of the run on one UDP port; a context manager. It may begin before the run does and outlive it."""

    def __init__(self, port: int) -> None:
        self.port = port
        self._context: zmq.Context[Any] = zmq.Context()
        self._socket = self._context.socket(zmq.SUB)
        self._socket.linger = 0
        self._socket.rcvhwm = _FRAMES_KEPT
        self._socket.setsockopt(zmq.MAXMSGSIZE, _MAXIMUM_BYTES)
        self._socket.setsockopt(zmq.SUBSCRIBE, b"")
        self._socket.connect(live_endpoint(port))

    def receive(self, timeout_s: float) -> list[LiveFrame]:
        """All frames that are there, oldest first, after waiting at most timeout_s for one; others' bytes are passed
        over.
        """
        frames: list[LiveFrame] = []
        wait = self._socket.poll(int(1000 * timeout_s))
        while wait and len(frames) < 2 * _FRAMES_KEPT:
            try:
                data = self._socket.recv(zmq.NOBLOCK)
            except zmq.Again:
                break
            with contextlib.suppress(msgspec.DecodeError):
                frames.append(msgspec.json.decode(data, type=LiveFrame))
        return frames

    def close(self) -> None:
        """Leave; the recorder does not notice."""
        self._socket.close()
        self._context.term()

    def __enter__(self) -> LiveSubscription:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
