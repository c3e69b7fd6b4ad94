"""A producer for tests: fills a ring with golden-like monitoring datagrams as the loop would, without a robot."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from daemon.api import RecorderJob, RunRequest
from fri_client.handover.motion_phase import MotionPhase
from fri_client.handover.ring import EventCode, HandoverRing
from fri_client.messages import (
    CommandData,
    CommandMessage,
    ConnectionInfo,
    FriVersion,
    IpoData,
    MessageHeader,
    MonitorData,
    MonitoringMessage,
    RobotInfo,
    TimeStamp,
)
from fri_client.wire.codec import Codec

SAMPLES_PER_PERIOD = 100


def make_request(folder: Path, **changes: object) -> RunRequest:
    """A request whose table is 0.1 s of rest; the files exist."""
    folder.mkdir(parents=True, exist_ok=True)
    table, trajectory = folder / "table.npy", folder / "trajectory.json"
    np.save(table, np.zeros((SAMPLES_PER_PERIOD, 7)))
    trajectory.write_text("{}")
    values: dict[str, object] = {
        "run_id": "test-run",
        "robot": "iiwa14",
        "table_file": str(table),
        "trajectory_file": str(trajectory),
        "out_dir": str(folder),
        "periods": 2,
        "lead_in_s": 0.02,
        "bind_port": 0,
        "ring_slots": 4096,
        "realtime_priority": 0,
        # Where tests keep both cores busy, a process may well be silent for the 2 s that a cell allows.
        "supervisor_timeout_s": 60.0,
    }
    values.update(changes)
    return RunRequest(**values)  # type: ignore[arg-type]


def make_job(folder: Path, part: int = 0, **changes: object) -> RecorderJob:
    name = "recording.mcap" if part == 0 else f"recording.part{part}.mcap"
    return RecorderJob(request=make_request(folder, **changes), path=str(folder / name), part=part)


class Producer:
    """Pushes fresh samples with consecutive counters; `skip` leaves a hole in the robot's counter."""

    def __init__(self, ring: HandoverRing, version: FriVersion = FriVersion.V1_15) -> None:
        self.ring = ring
        self.codec = Codec(version)
        self.counter = 100
        self.sent = 0

    def monitoring(self, counter: int, value: float) -> bytes:
        seven = (value,) * 7
        return self.codec.encode_monitoring(
            MonitoringMessage(
                MessageHeader(0x245142, counter, max(counter - 1, 0)),
                RobotInfo(7, 0, (2,) * 7, 2, 0),
                MonitorData(
                    measured_joint_position=seven,
                    measured_torque=(1.0,) * 7,
                    commanded_joint_position=seven if self.codec.version.major == 1 else None,
                    commanded_torque=(0.5,) * 7,
                    external_torque=(0.1,) * 7,
                    timestamp=TimeStamp(1000 + counter // 1000, counter % 1000 * 1_000_000),
                ),
                ConnectionInfo(4, 3, 1, 1),
                IpoData(joint_position=seven, client_command_mode=1, overlay_type=1, tracking_performance=1.0),
            )
        )

    def push(self, count: int = 1, *, event: int = 0, disposition: int = 0, skip: int = 0) -> int:
        """Push records; returns how many found room."""
        accepted = 0
        self.counter += skip
        for _ in range(count):
            datagram = self.monitoring(self.counter, 0.001 * (self.counter % 50))
            if disposition == 0:
                self.counter += 1
            command = self.codec.encode_command(
                CommandMessage(MessageHeader(0x34001, self.sent, self.counter), CommandData(joint_position=(0.2,) * 7))
            )
            now = time.monotonic_ns()
            accepted += self.ring.push(
                now,
                now + 50_000,
                int(MotionPhase.EXCITATION),
                self.sent // SAMPLES_PER_PERIOD,
                self.sent % SAMPLES_PER_PERIOD,
                datagram,
                command,
                event,
                0,
                0.0,
                0.0,
                disposition,
            )
            self.sent += 1
        return accepted

    def push_event(self, code: EventCode, value: float = 0.0, limit: float = 0.0) -> None:
        self.ring.push(time.monotonic_ns(), 0, 0, -1, -1, b"", None, int(code), 0, value, limit, 5)

    def push_garbage(self, data: bytes) -> None:
        self.ring.push(time.monotonic_ns(), 0, 0, -1, -1, data, None, 0, 0, 0.0, 0.0, 4)
