"""The recorder's side of the live view: samples in, a frame for every 10 ms out, to whoever listens.

A ZeroMQ PUB socket in the user's private folder, named after the UDP port. Sending never waits: for a watcher that does
not keep up, frames are dropped. What goes wrong here ends the live view and never the recording.
"""

from __future__ import annotations

import contextlib
import os
import sys
import time
from typing import Any

import msgspec
import numpy as np
import zmq

from daemon.api import RunRequest
from daemon.live.frame import FRAME_S, LiveFrame, Seven
from daemon.runtime_folder import live_endpoint
from fri_client.handover.motion_phase import MotionPhase
from fri_client.handover.ring import Disposition, HandoverRecord, HandoverRing
from fri_client.messages import CommandMessage, ConnectionQuality, MonitoringMessage, SessionState, name_or_number

QUIET_S = 0.5
"""Without samples a frame goes out this often, so that a watcher tells a silent robot from a recorder that is gone."""
_FRAMES_KEPT = 200
_NAMES = ("position", "command", "torque", "external_torque")


class LiveBroadcast:
    """Frames of one recording; `sample`, `event` and `tick` are called by the recorder; a context manager."""

    def __init__(self, request: RunRequest, ring: HandoverRing, context: zmq.Context[Any]) -> None:
        self._ring = ring
        self._rows_per_frame = max(1, round(FRAME_S / request.table_period_s))
        self._request = request
        self._rows = _rows_of(request.table_file)
        self._event = ""
        self._key: tuple[int, int, int] | None = None
        self._gathered: dict[str, list[Seven]] = {name: [] for name in _NAMES}
        self._time_sum_s, self._samples, self._newest_ns = 0.0, 0, 0
        self._next_quiet = time.monotonic() + QUIET_S
        self._socket: zmq.Socket[Any] | None = None
        if request.bind_port:  # port 0 is the system's choice, and nobody could know it
            socket = context.socket(zmq.PUB)
            socket.linger = 200
            socket.sndhwm = _FRAMES_KEPT
            try:
                socket.bind(live_endpoint(request.bind_port))
                self._socket = socket
            except (zmq.ZMQError, OSError) as error:
                socket.close()
                print(f"There is no live view of this run: {error}.", file=sys.stderr)

    def sample(
        self, message: MonitoringMessage, command: CommandMessage | None, record: HandoverRecord, host_time_ns: int
    ) -> None:
        """Count one fresh sample with finite numbers into its frame; the frame before it goes out when it is full."""
        monitor, connection = message.monitor_data, message.connection_info
        if self._socket is None or record.disposition != Disposition.FRESH or monitor is None:
            return
        send_period_s = 1e-3 * ((connection.send_period if connection is not None else None) or 1)
        counter = message.header.sequence_counter
        if record.period >= 0:
            key = (record.phase, record.period, record.sample_in_period // self._rows_per_frame)
        else:
            key = (record.phase, -1, int(counter * send_period_s / FRAME_S))
        if key != self._key:
            self._send_frame()
            self._key = key
        torque = monitor.measured_torque
        self._add("position", monitor.measured_joint_position)
        self._add("command", command.command_data.joint_position if command and command.command_data else None)
        self._add("torque", None if torque is None else tuple(-value for value in torque))
        self._add("external_torque", monitor.external_torque)
        self._time_sum_s += counter * send_period_s
        self._samples += 1
        self._newest_ns = host_time_ns

    def event(self, sentence: str) -> None:
        """The next frames carry this sentence."""
        self._event = sentence

    def tick(self) -> None:
        """Called whenever the recorder comes round: a frame without samples now and then when none came."""
        if time.monotonic() >= self._next_quiet:
            self._send(LiveFrame(timestamp=time.time(), **self._state()))

    def end(self) -> None:
        """The last frame, with the loop's reason, and the socket is closed."""
        self._send_frame()
        last = self._state() | {"event": self._ring.reason or self._event}
        self._send(LiveFrame(timestamp=time.time(), ended=True, **last))
        if self._socket is not None:
            self._socket.close()
            self._socket = None
            # A socket that is gone is told from a run that says nothing; ZeroMQ leaves its file.
            with contextlib.suppress(OSError):
                os.unlink(live_endpoint(self._request.bind_port).removeprefix("ipc://"))

    def __enter__(self) -> LiveBroadcast:
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def _add(self, name: str, values: tuple[float, ...] | None) -> None:
        if values is not None and len(values) == 7:
            self._gathered[name].append(values)

    def _send_frame(self) -> None:
        if self._key is None or not self._samples:
            return
        phase, period, place = self._key
        state = self._state()
        state |= {
            "phase": self._phase_name(phase),
            "period": period if period >= 0 else state["period"],
            "sample_in_period": place * self._rows_per_frame if period >= 0 else -1,
            "robot_time_s": self._time_sum_s / self._samples,
        }
        means: dict[str, Any] = {name: self._mean(name) for name in _NAMES}
        for rows in self._gathered.values():
            rows.clear()
        self._time_sum_s, self._samples, self._key = 0.0, 0, None
        self._send(LiveFrame(timestamp=self._newest_ns * 1e-9, **means, **state))

    def _mean(self, name: str) -> Seven | None:
        rows = self._gathered[name]
        if not rows:
            return None
        a, b, c, d, e, f, g = (sum(column) / len(rows) for column in zip(*rows, strict=True))
        return a, b, c, d, e, f, g

    def _phase_name(self, phase: int) -> str:
        watches = self._request.monitor_only and phase == MotionPhase.WAITING
        return "MONITOR_ONLY" if watches else name_or_number(MotionPhase, phase)

    def _state(self) -> dict[str, Any]:
        status, request = self._ring.status, self._request
        return {
            "run_id": request.run_id,
            "robot": request.robot,
            "folder": request.out_dir,
            "phase": self._phase_name(status.phase),
            "period": status.period if status.phase == MotionPhase.EXCITATION else -1,
            "periods": request.periods,
            "rows_per_period": self._rows,
            "rows_per_frame": self._rows_per_frame,
            "table_period_s": request.table_period_s,
            "session_state": name_or_number(SessionState, status.session_state),
            "quality": name_or_number(ConnectionQuality, status.quality),
            "received": status.received,
            "late": status.late,
            "missing": status.missing,
            "lost": self._ring.lost,
            "event": self._event,
        }

    def _send(self, frame: LiveFrame) -> None:
        self._next_quiet = time.monotonic() + QUIET_S
        if self._socket is not None:
            with contextlib.suppress(zmq.ZMQError):
                self._socket.send(msgspec.json.encode(frame), zmq.NOBLOCK)


def _rows_of(table_file: str) -> int:
    try:
        return len(np.load(table_file, mmap_mode="r", allow_pickle=False))
    except (OSError, ValueError, TypeError):
        return 0
