"""Claims about MCAP bags of ROS 2 with joint states, and what is written of them.

Truth: messages packed by rosbags from ROS's own message definitions; the reader knows them only from the file.
"""

from __future__ import annotations

from pathlib import Path

import mcap_ros2.reader
import numpy as np
import pytest
from mcap.writer import Writer
from rosbags.typesys import Stores, get_typestore

from identification.errors import RecordingError
from identification.recordings import read_recording, write_recording

ROWS, STEP_NS = 1200, 1_000_000
JOINT_STATE = "sensor_msgs/msg/JointState"


def _write_bag(path: Path, *, names: list[list[str]], effort: bool = True, stamped: bool = True) -> Path:
    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    definition, _ = store.generate_msgdef(JOINT_STATE, ros_version=2)
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2", "test")
        schema = writer.register_schema(JOINT_STATE, "ros2msg", definition.encode())
        channel = writer.register_channel("/arm/joint_states", "cdr", schema)
        for row in range(ROWS):
            time = 7 * 10**9 + row * 2 * STEP_NS
            order = names[row % len(names)]
            base = np.array([float(name[-1]) for name in order])
            position = np.sin(0.002 * row + base)
            message = types[JOINT_STATE](
                types["std_msgs/msg/Header"](
                    types["builtin_interfaces/msg/Time"](
                        time // 10**9 if stamped else 0, time % 10**9 if stamped else 0
                    ),
                    "",
                ),
                order,
                position,
                np.zeros(0),
                10.0 * position if effort else np.zeros(0),
            )
            writer.add_message(channel, time, bytes(store.serialize_cdr(message, JOINT_STATE)), time)
        writer.finish()
    return path


def test_joints_of_a_bag_are_matched_by_name(tmp_path: Path) -> None:
    names = [["a1", "a2", "a3"], ["a3", "a1", "a2"]]
    recording = read_recording(_write_bag(tmp_path / "bag.mcap", names=names))
    expected = np.sin(0.002 * np.arange(ROWS)[:, None] + np.array([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(recording.position, expected)
    np.testing.assert_allclose(recording.torque, 10.0 * expected)
    assert recording.joint_names == ("a1", "a2", "a3")
    assert recording.velocity is None
    np.testing.assert_allclose(recording.time, np.arange(ROWS) * 2e-3, atol=1e-12)


def test_a_bag_without_stamps_uses_the_times_of_the_log(tmp_path: Path) -> None:
    recording = read_recording(_write_bag(tmp_path / "bag.mcap", names=[["a1"]], stamped=False))
    np.testing.assert_allclose(recording.time, np.arange(ROWS) * 2e-3, atol=1e-12)
    assert recording.report.of_kind("no_header_stamp")


def test_a_bag_without_effort_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="effort"):
        read_recording(_write_bag(tmp_path / "bag.mcap", names=[["a1"]], effort=False))


def test_an_imported_log_opens_in_another_reader(tmp_path: Path) -> None:
    """mcap_ros2 decodes the embedded schema on its own: four arrays of equal length, the inverse-dynamics sign."""
    recording = read_recording(_write_bag(tmp_path / "bag.mcap", names=[["a1", "a2"]]))
    path = write_recording(recording, tmp_path / "import.mcap")
    messages = [item.ros_msg for item in mcap_ros2.reader.read_ros2_messages(path, topics=["/joint_states"])]
    assert len(messages) == ROWS
    for message in messages[:3]:
        assert len(message.name) == len(message.position) == len(message.velocity) == len(message.effort) == 2
    np.testing.assert_array_equal([message.effort for message in messages], recording.torque)
