"""Rows of a bag's JointState messages: one table a topic, one column for every joint that a message names.

Which columns are the robot's, and which topic is meant, is decided later (`joint_choice`), when the robot is known.
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from identification.arrays import FloatArray
from identification.errors import RecordingError
from identification.recordings.bag import FRI_STATE_TOPIC, JOINT_STATE, Bag, Topic
from identification.recordings.clock import before_a_clock_was_set_back
from identification.recordings.fri_log import installation_in, number_in
from identification.recordings.npz_reader import resolve_robot
from identification.recordings.recording import CLOCK_START, Finding
from identification.recordings.table import RawTable

MOST_JOINTS = 256
"""Named in one topic; more is no robot, and a table of them could be of any size."""
_EARLIEST_S = datetime(2000, 1, 1, tzinfo=UTC).timestamp()
"""Before any ROS: time that a clock counts from its start, and no date."""
_QUANTITIES = ("position", "velocity", "effort")


@dataclass(slots=True)
class _Layout:
    """The messages that name the same joints in the same order: their rows, stamps and values one after the other."""

    names: tuple[str, ...]
    width: int
    rows: array[int] = field(default_factory=lambda: array("q"))
    values: dict[str, array[float]] = field(default_factory=lambda: {name: array("d") for name in _QUANTITIES})

    def add(self, row: int, message: Any) -> None:
        self.rows.append(row)
        for name, values in self.values.items():
            given = np.asarray(getattr(message, name), dtype=np.float64)
            values.frombytes((given if given.size == self.width else np.full(self.width, np.nan)).tobytes())

    def table(self, name: str) -> FloatArray:
        return np.frombuffer(self.values[name]).reshape(-1, self.width)


def read_joint_states(path: Path, bag: Bag) -> list[RawTable]:
    """One table for each JointState topic with effort; torques have the sign of the inverse dynamics as ROS means it.

    Raises RecordingError where there is none, where a message names a joint twice, and for more than 256 joints.
    """
    topics = [topic for topic in bag.topics.values() if topic.messages]
    if not topics:
        raise RecordingError.named(path, f"holds neither {FRI_STATE_TOPIC} nor a topic of type {JOINT_STATE}")
    tables = [_table(path, topic, bag) for topic in topics]
    found = [table for table in tables if not np.isnan(table.torque).all()]
    if not found:
        names = ", ".join(topic.name for topic in topics)
        raise RecordingError.named(path, f"{names} carries no effort (torque)", field="effort")
    return found


def _table(path: Path, topic: Topic, bag: Bag) -> RawTable:
    layouts, stamps, count = _layouts(path, topic)
    names = tuple(dict.fromkeys(name for layout in layouts for name in layout.names))
    width = len(names) or max(layout.width for layout in layouts)
    if width > MOST_JOINTS:
        raise RecordingError.named(path, f"{topic.name} names {width} joints, which is no robot")
    place = {name: column for column, name in enumerate(names)}
    arrays = {name: np.full((count, width), np.nan) for name in _QUANTITIES}
    named = np.zeros((count, width), dtype=np.bool_)
    for layout in layouts:
        if layout.width == 0 or (not names and layout.width != width):
            continue
        if names and not layout.names:
            # It may be any joints' message; its row counts as one that cannot be used.
            named[np.asarray(layout.rows)] = True
            continue
        columns = [place[name] for name in layout.names] if names else list(range(width))
        at = np.ix_(np.asarray(layout.rows), np.asarray(columns))
        named[at] = True
        for name, values in arrays.items():
            values[at] = layout.table(name)
    findings: list[Finding] = []
    if not np.any(stamps):
        stamps = np.array([time for time, _ in topic.messages], dtype=np.int64)
        sentence = f"{topic.name} carries no time stamps; the log's times are used"
        findings.append(Finding.of_all("no_header_stamp", count, sentence))
    # A bag holds messages as they came in; which was measured first is for their stamps to say, unless these went back.
    order, steps = np.argsort(stamps, kind="stable"), np.abs(np.diff(stamps))
    late = int((np.diff(stamps) < 0).sum())
    if late and before_a_clock_was_set_back((stamps - stamps[0]) * 1e-9, 1.5e-9 * float(np.median(steps))).any():
        order = np.arange(count)
    elif late:
        sentence = (
            f"{late} messages on {topic.name} stand after ones with later stamps; rows are in the order of stamps"
        )
        findings.append(Finding("late_messages", 1, count, late, sentence))
    stamps, named = stamps[order], named[order]
    arrays = {name: values[order] for name, values in arrays.items()}
    return RawTable(
        path=path,
        kind="ros2",
        time=(stamps - stamps[0]).astype(np.float64) * 1e-9,
        position=arrays["position"],
        torque=arrays["effort"],
        optional={} if np.isnan(arrays["velocity"]).all() else {"velocity": arrays["velocity"]},
        period_s=number_in(bag.metadata, "period_s"),
        robot=resolve_robot(path, bag.metadata.get("robot", "")),
        joint_names=names or None,
        installation=installation_in(path, bag.metadata),
        named=named,
        topic=topic.name,
        metadata={**_begun(topic), **bag.metadata, CLOCK_START: repr(float(stamps[0]) * 1e-9)},
        findings=findings,
    )


def _begun(topic: Topic) -> dict[str, str]:
    """The date of the first message by the recorder's clock; nothing where that counts from zero, as a simulator's."""
    begun_s = min(time for time, _ in topic.messages) * 1e-9
    return {"date": datetime.fromtimestamp(begun_s, UTC).isoformat()} if begun_s >= _EARLIEST_S else {}


def _layouts(path: Path, topic: Topic) -> tuple[list[_Layout], np.ndarray[Any, np.dtype[np.int64]], int]:
    layouts: dict[tuple[tuple[str, ...], int], _Layout] = {}
    stamps = array("q")
    for row, message in enumerate(topic.decoded(path)):
        stamps.append(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)
        names = tuple(message.name)
        width = len(names) or max(len(message.position), len(message.effort))
        layout = layouts.get((names, width))
        if layout is None:
            twice = sorted({name for name in names if names.count(name) > 1})
            if twice:
                raise RecordingError.named(
                    path, f"message {row + 1} on {topic.name} names joint '{twice[0]}' twice", field=twice[0]
                )
            if len(layouts) >= MOST_JOINTS or width > MOST_JOINTS:
                raise RecordingError.named(
                    path, f"{topic.name} names ever other joints ({width} in message {row + 1}), no robot's"
                )
            layout = layouts[(names, width)] = _Layout(names, width)
        layout.add(row, message)
    return list(layouts.values()), np.frombuffer(stamps, dtype=np.int64), len(stamps)
