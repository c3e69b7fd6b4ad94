"""The MCAP writer: one decoded sample becomes three messages, in small chunks, flushed a few times a second.

Here: channels, quality-of-service texts, attachments, metadata, the mapping of the robot's clock, chunk policy. Not
here: processes, the ring, decoding of datagrams.

Times. `log_time` is the host's receive time (UNIX ns). `publish_time` is the robot's time stamp plus one constant,
chosen at the first sample such that both agree there: differences are those of the robot's clock, whatever the host
does. Samples without a robot time stamp are published at their receive time. The constant stands in the metadata.
/joint_states carries publish_time as its stamp.

Signs. /fri/state keeps the vendor's; /joint_states has effort = −measured_torque, the sign of eq. (1). Its velocity is
the difference of two measured positions over the robot's clock, made for looking at; estimators derive their own.
"""

from __future__ import annotations

import errno
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, cast

from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

from daemon.errors import BadLogError, LogIOError
from daemon.host import own_version
from daemon.log import definitions
from daemon.log.cdr import (
    DiagnosticStatus,
    LoggedEvent,
    SampleLabels,
    pack_diagnostics,
    pack_event,
    pack_fri_command,
    pack_fri_state,
    pack_joint_state,
    pack_string,
)
from daemon.log.chunk_index import pack_chunk_indexes_of
from daemon.log.stream import PatientFile
from fri_client.handover.motion_phase import MotionPhase
from fri_client.messages import CommandMessage, MonitoringMessage

CHUNK_BYTES = 512 * 1024
CHUNK_SECONDS = 0.25
"""At 1 kHz a chunk ends by its time, with some 350 kB in it; by its size only when a backlog is written."""
SCHEMA_VERSION = "1"
RECORDING_STARTED = 1000
"""Event codes from 1000 on are the recorder's own; those below are the loop's (EventCode)."""
METADATA_NAME = "iiwa_ident"
END_METADATA_NAME = "iiwa_ident_end"
TORQUE_SIGN_CONVENTION = (
    "/joint_states effort: inverse dynamics, eq. (1); /fri/state and /fri/command: vendor, the negative of it "
    "(external_torque as the vendor gives it)"
)
_PLAUSIBLE_DEVIATION_NS = 86_400_000_000_000
"""A robot time a day away from the host's is garbage; such a sample is published at its receive time."""
_NAN_7 = (math.nan,) * 7


@dataclass(frozen=True, slots=True)
class Attachment:
    """A file that travels in the log."""

    name: str
    media_type: str
    data: bytes


def _quality_of_service(*, latched: bool) -> str:
    """The `offered_qos_profiles` text rosbag2 expects: keep last, reliable, volatile or transient local."""
    endless = "\n    sec: 9223372036\n    nsec: 854775807"
    return (
        f"- history: 1\n  depth: {1 if latched else 100}\n  reliability: 1\n  durability: {1 if latched else 2}\n"
        f"  deadline:{endless}\n  lifespan:{endless}\n  liveliness: 1\n  liveliness_lease_duration:{endless}\n"
        "  avoid_ros_namespace_conventions: false"
    )


class LogWriter:
    """Writes one log file; every method may raise LogIOError, and may then be called again.

    metadata: the record `iiwa_ident`, written with the first sample, when the send period is known, or at the end; once
    more for each other send period before the motion. The last one counts.
    """

    def __init__(
        self,
        path: Path,
        *,
        metadata: dict[str, str],
        attachments: Sequence[Attachment] = (),
        robot_description: str = "",
    ) -> None:
        self._path = path
        self._file = PatientFile(path)
        # Any: the library annotates only part of its methods.
        self._writer: Any = Writer(
            cast(IO[bytes], self._file), chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD
        )
        pack_chunk_indexes_of(self._writer)
        self._metadata = dict(metadata)
        self._metadata_written = False
        self._send_period_ms: int | None = None
        self._finished = False
        self._clock_offset_ns: int | None = None
        self._previous_position: Sequence[float] | None = None
        self._previous_time_ns = 0
        self._velocity: Sequence[float] = _NAN_7
        self._last_log_time = time.time_ns()
        self.samples = 0
        self._begin(attachments, robot_description)

    def _begin(self, attachments: Sequence[Attachment], robot_description: str) -> None:
        writer, now = self._writer, self._last_log_time
        writer.start(profile="ros2", library=f"iiwa-ident {own_version()}")
        self._state = self._channel("/fri/state", definitions.FRI_STATE)
        self._command = self._channel("/fri/command", definitions.FRI_COMMAND)
        self._joints = self._channel("/joint_states", definitions.JOINT_STATE)
        self._events = self._channel("/run/events", definitions.RUN_EVENT)
        self._diagnostics = self._channel("/diagnostics", definitions.DIAGNOSTIC_ARRAY)
        self._description = self._channel("/robot_description", definitions.STRING, latched=True)
        for attachment in attachments:
            writer.add_attachment(now, now, attachment.name, attachment.media_type, attachment.data)
        if robot_description:
            writer.add_message(self._description, now, pack_string(robot_description), now)
        self.write_event(LoggedEvent(RECORDING_STARTED, "RECORDING_STARTED", "The recorder opened this file.", now))
        self._next_flush = 0.0
        self.flush()

    def _channel(self, topic: str, message: str, *, latched: bool = False) -> int:
        schema = self._writer.register_schema(message, "ros2msg", definitions.schema_text(message).encode())
        profiles = {"offered_qos_profiles": _quality_of_service(latched=latched)}
        return int(self._writer.register_channel(topic, "cdr", schema, profiles))

    def write_sample(self, message: MonitoringMessage, command: CommandMessage | None, labels: SampleLabels) -> None:
        """One received monitoring message and its answer: /fri/state, /fri/command if answered, /joint_states."""
        monitor = message.monitor_data
        stamp = None if monitor is None else monitor.timestamp
        log_time = publish_time = labels.receive_time_ns
        if stamp is not None:
            robot_time = stamp.sec * 1_000_000_000 + stamp.nanosec
            if self._clock_offset_ns is None:
                self._clock_offset_ns = log_time - robot_time
            mapped = robot_time + self._clock_offset_ns
            if abs(mapped - log_time) < _PLAUSIBLE_DEVIATION_NS:
                publish_time = mapped
        if not self._metadata_written or self._is_another_period(message, labels):
            self._write_metadata(message)
        sequence = message.header.sequence_counter
        add = self._writer.add_message
        add(self._state, log_time, pack_fri_state(message, labels), publish_time, sequence)
        if command is not None:
            # A set-point leaves the host at the send time.
            sent = labels.send_time_ns or log_time
            add(self._command, sent, pack_fri_command(command, labels), sent, command.header.sequence_counter)
        if monitor is not None and monitor.measured_joint_position is not None:
            position = monitor.measured_joint_position
            torque = monitor.measured_torque
            velocity = self._estimate_velocity(position, publish_time)
            effort = _NAN_7 if torque is None else [-value for value in torque]
            add(
                self._joints,
                log_time,
                pack_joint_state(publish_time, position, velocity, effort),
                publish_time,
                sequence,
            )
        self.samples += 1
        self._last_log_time = log_time

    def _estimate_velocity(self, position: Sequence[float], time_ns: int) -> Sequence[float]:
        """Difference quotient to the sample before, rad/s; NaN at the first, unchanged for a repeated time stamp."""
        elapsed = (time_ns - self._previous_time_ns) * 1e-9
        if self._previous_position is None:
            self._velocity = _NAN_7
        elif elapsed > 0.0:
            self._velocity = [(new - old) / elapsed for new, old in zip(position, self._previous_position, strict=True)]
        elif elapsed == 0.0:
            return self._velocity
        else:
            return _NAN_7
        self._previous_position, self._previous_time_ns = position, time_ns
        return self._velocity

    def write_event(self, event: LoggedEvent) -> None:
        """Something that happened, on /run/events."""
        self._writer.add_message(self._events, event.host_time_ns, pack_event(event), event.host_time_ns)

    def write_diagnostics(self, statuses: Sequence[DiagnosticStatus], hardware: str, host_time_ns: int) -> None:
        """State of the link and of the recorder, on /diagnostics; meant for about one a second."""
        data = pack_diagnostics(host_time_ns, statuses, hardware)
        self._writer.add_message(self._diagnostics, host_time_ns, data, host_time_ns)

    def add_attachment(self, attachment: Attachment) -> None:
        """A file that came into being during the run (the host report)."""
        now = time.time_ns()
        self._writer.add_attachment(now, now, attachment.name, attachment.media_type, attachment.data)

    def flush_when_due(self) -> bool:
        """Hand over what 512 KiB or 0.25 s have gathered; True when everything written so far is with the system."""
        if time.monotonic() >= self._next_flush:
            self.flush()
            return True
        if self._file.pending:
            # A chunk was full: it goes out, the one begun since then stays open.
            self._file.flush()
        return False

    def require_place(self) -> None:
        """Raises LogIOError where the file was moved or removed since it was opened."""
        if not self._file.is_in_place:
            raise LogIOError(str(self._path), OSError(errno.ENOENT, "was moved or removed while it was written"))

    def flush(self) -> None:
        """Close the chunk and hand everything to the operating system."""
        self._writer.flush()
        self._next_flush = time.monotonic() + CHUNK_SECONDS

    def finish(self, end_metadata: dict[str, str]) -> int:
        """Write what is missing, close the file, open it again and count. Returns the samples found in it.

        Raises BadLogError when the file does not hold what was written, LogIOError when the disk refuses (may be
        called again then).
        """
        if not self._finished:
            if not self._metadata_written:
                self._write_metadata(None)
            self._writer.add_metadata(
                END_METADATA_NAME,
                {**end_metadata, "samples": str(self.samples), "clock_offset_ns": str(self._clock_offset_ns or 0)},
            )
            self._writer.finish()
            self._finished = True
        self._file.flush()
        self._file.sync()
        self._file.close()
        counted = count_messages(self._path).get("/fri/state", 0)
        if counted != self.samples:
            raise BadLogError(str(self._path), f"{self.samples} samples were written, {counted} are in the file.")
        return counted

    def _is_another_period(self, message: MonitoringMessage, labels: SampleLabels) -> bool:
        """Whether the robot has begun its session anew with another send period, which the motion will have."""
        connection = message.connection_info
        stated = None if connection is None else connection.send_period
        return labels.motion_phase == MotionPhase.WAITING and stated not in (None, 0, self._send_period_ms)

    def _write_metadata(self, message: MonitoringMessage | None) -> None:
        connection = None if message is None else message.connection_info
        if connection is not None and connection.send_period:
            self._send_period_ms = connection.send_period
            self._metadata["send_period_ms"] = str(connection.send_period)
            period_s = float(self._metadata.get("period_s") or 0.0)
            self._metadata["samples_per_period"] = str(round(period_s * 1000.0 / connection.send_period))
        self._metadata.setdefault("send_period_ms", "")
        self._metadata["torque_sign_convention"] = TORQUE_SIGN_CONVENTION
        self._metadata["schema_version"] = SCHEMA_VERSION
        self._metadata["software_version"] = own_version()
        self._metadata["publish_time"] = "robot time stamp plus clock_offset_ns"
        self._metadata["clock_offset_ns"] = str(self._clock_offset_ns or 0)
        self._metadata["joint_states_velocity"] = "difference of measured positions over the robot's clock"
        self._writer.add_metadata(METADATA_NAME, self._metadata)
        self._metadata_written = True


def has_non_finite(message: MonitoringMessage) -> bool:
    """Whether a measured position or torque is no finite number."""
    monitor = message.monitor_data
    if monitor is None:
        return False
    total = sum(monitor.measured_joint_position or ()) + sum(monitor.measured_torque or ())
    return not math.isfinite(total)


def count_messages(path: Path) -> dict[str, int]:
    """Messages per topic, by reading every one (not the statistics record) from the first to the closing magic.

    Read as a stream, so that nothing but the current chunk is in memory. Raises BadLogError for a file that is broken
    off, damaged or absent.
    """
    counts: dict[str, int] = {}
    topics: dict[int, str] = {}
    try:
        with path.open("rb") as stream:
            for record in StreamReader(stream, validate_crcs=True).records:
                if isinstance(record, Message):
                    topic = topics[record.channel_id]
                    counts[topic] = counts.get(topic, 0) + 1
                elif isinstance(record, Channel):
                    topics[record.id] = record.topic
    except Exception as error:
        raise BadLogError(str(path), f"cannot be read back: {error or type(error).__name__}.") from error
    return counts
