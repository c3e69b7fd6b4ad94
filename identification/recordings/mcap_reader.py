"""Reads .mcap recordings: logs of this project (/fri/state), imports (attachment), and ROS 2 bags (JointState).

Messages are decoded with the schema embedded in the file. A file that breaks off still gives all of its complete
chunks. Called by `reader.read_recording`; the writing of logs lives elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mcap.exceptions import EndOfFile, McapError
from mcap.records import Attachment, Channel, Footer, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from identification.errors import RecordingError
from identification.recordings import archive
from identification.recordings.npz_reader import resolve_robot
from identification.recordings.recording import Finding, FloatArray, Recording
from identification.recordings.table import RawTable

FRI_STATE_TOPIC = "/fri/state"
JOINT_STATE = "sensor_msgs/msg/JointState"
METADATA_RECORD = "iiwa_ident"
EXCITATION_PHASE = 3


@dataclass(slots=True)
class _Contents:
    """What a file holds: messages by topic as (log time, bytes), schemas by topic, metadata, the import's arrays."""

    messages: dict[str, list[tuple[int, bytes]]] = field(default_factory=dict)
    schemas: dict[str, Schema] = field(default_factory=dict)
    encodings: dict[str, str] = field(default_factory=dict)
    metadata: dict[str, str] = field(default_factory=dict)
    archive: bytes | None = None
    complete: bool = False
    error: str = ""


def read_mcap(path: Path, robot: str | None) -> RawTable | Recording:
    """Rows of an .mcap file, or the Recording that an import put into it.

    Raises RecordingError when the file is no MCAP, or holds neither /fri/state nor a JointState with effort.
    """
    contents = _contents(path)
    if contents.archive is not None:
        return archive.unpack(contents.archive, path, robot=robot)
    findings: list[Finding] = []
    if FRI_STATE_TOPIC in contents.messages:
        table = _own_log(path, contents, findings)
    else:
        table = _joint_states(path, contents, findings)
    if not contents.complete:
        rows = table.time.shape[0]
        findings.append(
            Finding(
                "truncated_file",
                max(rows, 1),
                max(rows, 1),
                1,
                f"the file breaks off after row {rows} ({contents.error}); its complete chunks were read",
            )
        )
    table.findings = findings
    return table


def _contents(path: Path) -> _Contents:
    contents = _Contents()
    schemas: dict[int, Schema] = {}
    topics: dict[int, list[tuple[int, bytes]] | None] = {}
    try:
        with path.open("rb") as file:
            for record in StreamReader(file).records:
                if isinstance(record, Message):
                    kept = topics.get(record.channel_id)
                    if kept is not None:
                        kept.append((record.log_time, record.data))
                elif isinstance(record, Schema):
                    schemas[record.id] = record
                elif isinstance(record, Channel):
                    schema = schemas.get(record.schema_id)
                    if schema is None or not (record.topic == FRI_STATE_TOPIC or schema.name == JOINT_STATE):
                        topics.setdefault(record.id, None)
                        continue
                    topics[record.id] = contents.messages.setdefault(record.topic, [])
                    contents.schemas[record.topic] = schema
                    contents.encodings[record.topic] = record.message_encoding
                elif isinstance(record, Metadata) and record.name == METADATA_RECORD:
                    contents.metadata.update(record.metadata)
                elif isinstance(record, Attachment) and record.name == archive.ATTACHMENT_NAME:
                    contents.archive = record.data
                elif isinstance(record, Footer):
                    contents.complete = True
    except Exception as error:  # the library leaks struct.error, zstd and lz4 errors besides its own
        contents.error = _cause(error)
        if not any(contents.messages.values()) and contents.archive is None:
            raise RecordingError(
                f"{path.name}: no complete chunk of an MCAP log could be read ({contents.error})", file=path
            ) from error
    if not contents.complete and not contents.error:
        contents.error = "the footer is missing"
    return contents


def _cause(error: Exception) -> str:
    """What ended the reading, in words: the library's end-of-file error has none of its own."""
    if isinstance(error, EndOfFile):
        return "the file ends in the middle of a record"
    return str(error) if isinstance(error, McapError) and str(error) else f"{type(error).__name__}: {error}"


def _decode(path: Path, contents: _Contents, topic: str) -> list[Any]:
    """All messages of a topic, decoded with the schema in the file."""
    schema = contents.schemas[topic]
    if schema.encoding != "ros2msg" or contents.encodings[topic] != "cdr":
        raise RecordingError(
            f"{path.name}: {topic} is encoded as {contents.encodings[topic]} with a {schema.encoding} schema; "
            "cdr with a ros2msg schema is needed",
            file=path,
            field=topic,
        )
    store = get_typestore(Stores.EMPTY)
    try:
        store.register(get_types_from_msg(schema.data.decode(), schema.name))
        return [store.deserialize_cdr(data, schema.name) for _, data in contents.messages[topic]]
    except Exception as error:  # a parser of another library; whatever it raises, the message is unusable
        raise RecordingError(
            f"{path.name}: the messages on {topic} do not fit their schema {schema.name} ({error})",
            file=path,
            field=topic,
        ) from error


def _own_log(path: Path, contents: _Contents, findings: list[Finding]) -> RawTable:
    """Rows of /fri/state: the torque gets the inverse-dynamics sign, the labels of the run are kept."""
    states = _decode(path, contents, FRI_STATE_TOPIC)
    usable = np.array(
        [
            state.measured_joint_position_valid
            and state.measured_torque_valid
            and not (state.duplicate or state.out_of_order)
            for state in states
        ],
        dtype=np.bool_,
    )
    if not usable.all():
        bad = np.flatnonzero(~usable) + 1
        findings.append(
            Finding(
                "unusable_message",
                int(bad[0]),
                int(bad[-1]),
                int(bad.size),
                f"{bad.size} messages between {bad[0]} and {bad[-1]} carry no position or torque, or came twice or too "
                "late; they were left out",
            )
        )
    states = [state for state, good in zip(states, usable, strict=True) if good]
    if not states:
        raise RecordingError(f"{path.name}: {FRI_STATE_TOPIC} holds no usable sample", file=path)
    counters = np.array([state.sequence_counter for state in states], dtype=np.int64)
    steps = np.diff(counters) % 2**32
    lost = np.flatnonzero(steps > 1)
    if lost.size:
        missing = int((steps[lost] - 1).sum())
        findings.append(
            Finding(
                "lost_samples",
                int(lost[0]) + 1,
                int(lost[-1]) + 2,
                missing,
                f"{missing} messages of the robot are missing at {lost.size} places, seen by its sequence counter",
            )
        )
    metadata = contents.metadata
    # KUKA measures the torque against the sign of the inverse dynamics; external torque is not turned.
    sign = 1.0 if metadata.get("torque_sign_convention", "vendor") in ("inverse_dynamics",) else -1.0
    optional = {
        "external_torque": _stack(states, "external_torque"),
        "command_position": _stack(states, "commanded_joint_position"),
    }
    if np.isnan(optional["command_position"]).all():
        optional["command_position"] = _stack(states, "ipo_joint_position")
    phase = np.array([state.motion_phase for state in states], dtype=np.int64)
    period = np.array([state.period for state in states], dtype=np.int64)
    sample = np.array([state.sample_in_period for state in states], dtype=np.int64)
    labelled = (phase == EXCITATION_PHASE) & (period >= 0) & (sample >= 0)
    table = RawTable(
        path=path,
        kind="log",
        time=_robot_time(states, counters, findings),
        position=_stack(states, "measured_joint_position"),
        torque=sign * _stack(states, "measured_torque"),
        optional={name: values for name, values in optional.items() if not np.isnan(values).all()},
        robot=resolve_robot(path, metadata.get("robot", "")),
        metadata=metadata,
    )
    if labelled.any():
        per_period = _number(metadata.get("samples_per_period"))
        table.samples_per_period = int(per_period) if per_period else int(sample[labelled].max()) + 1
        table.period_index = np.where(labelled, period, -1)
        table.sample_in_period = np.where(labelled, sample, -1)
        send_period_s = 1e-3 * (states[0].send_period_ms or 1)
        table.period_s = _number(metadata.get("period_s")) or table.samples_per_period * send_period_s
    return table


def _stack(messages: list[Any], name: str) -> FloatArray:
    return np.stack([getattr(message, name) for message in messages]).astype(np.float64)


def _number(text: str | None) -> float | None:
    try:
        return float(text) if text else None
    except ValueError:
        return None


def _robot_time(states: list[Any], counters: np.ndarray[Any, Any], findings: list[Finding]) -> FloatArray:
    """Time since the first sample by the robot's own clock, else by its sequence counter and send period."""
    if all(state.robot_time_valid for state in states):
        clock = np.array([state.robot_time_sec * 10**9 + state.robot_time_nanosec for state in states], dtype=np.int64)
        if np.all(np.diff(clock) > 0):
            return np.asarray((clock - clock[0]) * 1e-9, dtype=np.float64)
    findings.append(
        Finding(
            "no_robot_clock",
            1,
            len(states),
            len(states),
            "the robot's time stamps are absent or do not advance; time is its sequence counter times the send period",
        )
    )
    steps = np.concatenate([[0], np.cumsum(np.diff(counters) % 2**32)])
    return np.asarray(steps * 1e-3 * (states[0].send_period_ms or 1), dtype=np.float64)


def _joint_states(path: Path, contents: _Contents, findings: list[Finding]) -> RawTable:
    """Rows of the busiest JointState topic that carries effort; joints in the order of its first message."""
    if not any(contents.messages.values()):
        raise RecordingError(
            f"{path.name}: holds neither {FRI_STATE_TOPIC} nor a topic of type {JOINT_STATE}", file=path
        )
    topic = max(contents.messages, key=lambda name: len(contents.messages[name]))
    messages = _decode(path, contents, topic)
    names = tuple(next((message.name for message in messages if len(message.name)), ()))
    joints = len(names) or (len(messages[0].position) if messages else 0)
    if joints == 0 or all(len(message.effort) != joints for message in messages):
        raise RecordingError(f"{path.name}: {topic} carries no effort (torque)", file=path, field="effort")
    order = {name: index for index, name in enumerate(names)}
    rows = len(messages)
    position = np.full((rows, joints), np.nan)
    velocity = np.full((rows, joints), np.nan)
    torque = np.full((rows, joints), np.nan)
    for row, message in enumerate(messages):
        if tuple(message.name) == names or not names:
            columns: Any = slice(None)
        elif all(name in order for name in message.name):
            columns = [order[name] for name in message.name]
        else:
            continue  # other joints (a gripper, a second arm): the row stays nan and is reported as garbled
        size = joints if isinstance(columns, slice) else len(columns)
        for target, values in ((position, message.position), (velocity, message.velocity), (torque, message.effort)):
            if len(values) == size:
                target[row, columns] = values
    stamps = np.array([m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in messages], dtype=np.int64)
    if not np.any(stamps):
        stamps = np.array([log_time for log_time, _ in contents.messages[topic]], dtype=np.int64)
        findings.append(
            Finding("no_header_stamp", 1, rows, rows, f"{topic} carries no time stamps; the log's times are used")
        )
    period = _number(contents.metadata.get("period_s"))
    return RawTable(
        path=path,
        kind="ros2",
        time=(stamps - stamps[0]).astype(np.float64) * 1e-9,
        position=position,
        torque=torque,
        optional={} if np.isnan(velocity).all() else {"velocity": velocity},
        period_s=period if period else None,
        robot=resolve_robot(path, contents.metadata.get("robot", "")),
        joint_names=names or None,
        metadata=contents.metadata,
    )
