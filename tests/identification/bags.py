"""Bags of ROS 2 for tests, written by rosbags and by the MCAP library: any joint names in any order."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as BagWriter
from rosbags.typesys import Stores, get_typestore

JOINT_STATE = "sensor_msgs/msg/JointState"
STORE = get_typestore(Stores.ROS2_HUMBLE)


@dataclass(frozen=True)
class JointMessage:
    """One message: values by joint name, in the order in which they are given; names=() sends them without names."""

    time_s: float
    position: dict[str, float]
    effort: dict[str, float]
    velocity: dict[str, float] = field(default_factory=dict)
    named: bool = True
    topic: str = "/joint_states"
    stamped: bool = True

    @property
    def nanoseconds(self) -> int:
        return round(self.time_s * 1e9)

    def pack(self) -> bytes:
        types = STORE.types
        stamp = self.nanoseconds if self.stamped else 0
        message = types[JOINT_STATE](
            types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9), ""),
            list(self.position) if self.named else [],
            np.array(list(self.position.values())),
            np.array(list(self.velocity.values())),
            np.array(list(self.effort.values())),
        )
        return bytes(STORE.serialize_cdr(message, JOINT_STATE))


def messages_of(
    time: Any, names: Iterable[str], position: Any, effort: Any, *, order: Any = None, **options: Any
) -> list[JointMessage]:
    """One message a row; order(row) → the order of the joints in it, by place."""
    names = list(names)
    result = []
    for row, moment in enumerate(time):
        places = list(range(len(names))) if order is None else list(order(row))
        result.append(
            JointMessage(
                float(moment),
                {names[place]: float(position[row, place]) for place in places},
                {names[place]: float(effort[row, place]) for place in places},
                **options,
            )
        )
    return result


def write_mcap(
    path: Path, messages: Iterable[JointMessage], compression: CompressionType = CompressionType.ZSTD
) -> Path:
    definition, _ = STORE.generate_msgdef(JOINT_STATE, ros_version=2)
    with path.open("wb") as file:
        writer = Writer(file, compression=compression)
        writer.start("ros2", "test")
        schema = writer.register_schema(JOINT_STATE, "ros2msg", definition.encode())
        channels: dict[str, int] = {}
        for message in messages:
            if message.topic not in channels:
                channels[message.topic] = writer.register_channel(message.topic, "cdr", schema)
            writer.add_message(channels[message.topic], message.nanoseconds, message.pack(), message.nanoseconds)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def write_bag(
    folder: Path,
    messages: Iterable[JointMessage],
    *,
    storage: StoragePlugin = StoragePlugin.SQLITE3,
    compression: CompressionMode | None = None,
) -> Path:
    """A bag's folder as `ros2 bag record` leaves it: metadata.yaml and one data file."""
    writer = BagWriter(folder, version=9, storage_plugin=storage)
    if compression is not None:
        writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer:
        connections: dict[str, Any] = {}
        for message in messages:
            if message.topic not in connections:
                connections[message.topic] = writer.add_connection(message.topic, JOINT_STATE, typestore=STORE)
            writer.write(connections[message.topic], message.nanoseconds, message.pack())
    return folder
