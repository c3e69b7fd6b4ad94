"""Writes imported recordings as the project's log: an MCAP that viewers open and `read_recording` reads bit by bit.

Layout: profile ros2; /joint_states (sensor_msgs/msg/JointState, all four arrays of equal length) for viewers and bag
tools; attachment `recording.npz` with the arrays as they are, the robot's URDF where there is one; metadata record
`iiwa_ident`. Logs of a live run are
written elsewhere, sample by sample.
"""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
from mcap.records import Metadata
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

from identification.recordings.archive import ATTACHMENT_NAME, pack
from identification.recordings.bag import JOINT_STATE, METADATA_RECORD
from identification.recordings.recording import Recording
from identification.whole_file import written_whole

SCHEMA_VERSION = "1"
KIND = "import"
STRING = "std_msgs/msg/String"


def write_recording(recording: Recording, path: str | Path) -> Path:
    """Write a recording as an MCAP log and return its path; an existing file is replaced only when all is written.

    Torques keep the inverse-dynamics sign (said in the metadata). Raises OSError when the file cannot be written.
    """
    path = Path(path)
    with written_whole(path) as partial, partial.open("wb") as file:
        _write(recording, file, path.parent)
    return path


def is_import(path: Path) -> bool:
    """Whether a file is a log that `write_recording` wrote; a robot's own log, a bag and any other file are not."""
    try:
        with path.open("rb") as file:
            for record in StreamReader(file, emit_chunks=True, record_size_limit=path.stat().st_size).records:
                if isinstance(record, Metadata) and record.name == METADATA_RECORD:
                    return record.metadata.get("kind") == KIND
    except Exception:
        pass
    return False


def _write(recording: Recording, file: object, folder: Path) -> None:
    from rosbags.typesys import Stores, get_typestore  # slow to load, and a fit writes no recording

    store = get_typestore(Stores.ROS2_HUMBLE)
    joint_state = store.types[JOINT_STATE]
    header = store.types["std_msgs/msg/Header"]
    stamp = store.types["builtin_interfaces/msg/Time"]
    definition, _ = store.generate_msgdef(JOINT_STATE, ros_version=2)
    names = recording.joint_names or tuple(f"joint{joint}" for joint in range(1, recording.n + 1))
    velocity = recording.velocity if recording.velocity is not None else np.full_like(recording.position, np.nan)
    nanoseconds = np.rint(recording.time * 1e9).astype(np.int64)
    # Message times must not be negative; a recording may well begin before its zero.
    nanoseconds = nanoseconds - min(0, int(nanoseconds[0]))

    writer = Writer(file, compression=CompressionType.ZSTD)  # type: ignore[arg-type]
    writer.start(profile="ros2", library="iiwa-ident")
    robot, description = _robot(recording, folder)
    writer.add_metadata(METADATA_RECORD, _metadata(recording, robot))
    writer.add_attachment(
        create_time=0,
        log_time=0,
        name=ATTACHMENT_NAME,
        media_type="application/x-npz",
        data=pack(recording, robot=robot),
    )
    if description:
        writer.add_attachment(
            create_time=0, log_time=0, name="robot.urdf", media_type="application/xml", data=description.encode()
        )
    if description:
        text, _ = store.generate_msgdef(STRING, ros_version=2)
        topic = writer.register_channel(
            "/robot_description", "cdr", writer.register_schema(STRING, "ros2msg", text.encode())
        )
        data = bytes(store.serialize_cdr(store.types[STRING](description), STRING))
        writer.add_message(topic, int(nanoseconds[0]), data, int(nanoseconds[0]))
    schema = writer.register_schema(JOINT_STATE, "ros2msg", definition.encode())
    channel = writer.register_channel("/joint_states", "cdr", schema)
    # A message takes its numbers as they lie in memory; those of a MATLAB file, and of columns that were chosen, lie
    # column by column.
    arrays = [np.ascontiguousarray(values) for values in (recording.position, velocity, recording.torque)]
    for row in range(recording.samples):
        time = int(nanoseconds[row])
        message = joint_state(
            header(stamp(time // 10**9, time % 10**9), ""),
            list(names),
            *(values[row] for values in arrays),
        )
        writer.add_message(channel, time, bytes(store.serialize_cdr(message, JOINT_STATE)), time, row)
    writer.finish()  # type: ignore[no-untyped-call]


def _robot(recording: Recording, folder: Path) -> tuple[str | None, str]:
    """The robot as the log in `folder` should name it, and the text of its URDF where it is one."""
    if recording.robot is None or not Path(recording.robot).is_file():
        return recording.robot, ""
    file = Path(recording.robot)
    description = file.read_text(encoding="utf-8") if file.suffix.lower() == ".urdf" else ""
    return os.path.relpath(file.resolve(), folder.resolve()), description


def _metadata(recording: Recording, robot: str | None) -> dict[str, str]:
    metadata = {
        "schema_version": SCHEMA_VERSION,
        "kind": KIND,
        "robot": robot or "",
        "period_s": "" if recording.period_s is None else repr(recording.period_s),
        "samples_per_period": "" if recording.samples_per_period is None else str(recording.samples_per_period),
        "torque_sign_convention": "inverse_dynamics",
        "torque_unit": recording.torque_unit,
        "installation": json.dumps(recording.installation.to_json()),
        "source": Path(recording.source.path).name,
        "source_sha256": recording.source.sha256,
    }
    return {name: value for name, value in metadata.items() if value}
