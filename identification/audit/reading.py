"""How recordings are to be read: degrees, clock, columns and signs of the joints. Pure.

Here: what is read otherwise than it stands, recordings read so, and what is said of it. Not here: how that is found
(`places`, `misread`, `search`).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from identification.arrays import BoolArray, FloatArray
from identification.audit import rows as audit_rows
from identification.recordings.recording import Recording
from identification.robots.model import RobotModel

MOTION = ("position", "velocity", "command_position", "link_position")
TORQUE = ("torque", "external_torque")
WIDEST_RAD = 4.0 * np.pi
"""No joint of an arm turns that far; in degrees nearly every motion does."""
IN_ORDER = "Put the columns in the robot's order"

Columns = tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Reading:
    """motion, torque: of each joint the recorded column that is its own, from 1, below zero where its sign is turned.

    ratio: true rate over stated rate. degrees: whether positions are in degrees.
    """

    motion: Columns
    torque: Columns
    ratio: float = 1.0
    degrees: bool = False

    @classmethod
    def as_recorded(cls, n: int) -> Reading:
        """Of n joints, everything as it stands."""
        return cls(tuple(range(1, n + 1)), tuple(range(1, n + 1)))

    @classmethod
    def with_signs(cls, signs: FloatArray) -> Reading:
        """With torques times (n,) ±1."""
        columns = np.arange(1, len(signs) + 1)
        return cls(tuple(columns.tolist()), tuple((signs * columns).astype(int).tolist()))

    def then(self, further: Reading) -> Reading:
        """With what is read otherwise besides in recordings that are read so."""
        motion, torque = (
            tuple(own[abs(place) - 1] * (1 if place > 0 else -1) for place in places)
            for own, places in ((self.motion, further.motion), (self.torque, further.torque))
        )
        return Reading(motion, torque, self.ratio * further.ratio, self.degrees or further.degrees)

    @property
    def is_other(self) -> bool:
        """Whether anything is read otherwise than it stands."""
        return self != Reading.as_recorded(len(self.torque))

    @property
    def moves_motion(self) -> bool:
        """Whether a position stands under another joint, or has another sign."""
        return self.motion != Reading.as_recorded(len(self.motion)).motion

    @property
    def places(self) -> Reading:
        """Without signs of torques alone, which are another question than where columns stand and how joints count."""
        pairs = zip(self.motion, self.torque, strict=True)
        return replace(self, torque=tuple(column if motion < 0 else abs(column) for motion, column in pairs))

    @property
    def joints(self) -> Columns:
        """Those that have another column or sign than their own, from 1."""
        each = enumerate(zip(self.motion, self.torque, strict=True), start=1)
        return tuple(joint for joint, columns in each if columns != (joint, joint))

    @property
    def faults(self) -> tuple[tuple[str, str], ...]:
        """What is wrong with places and turns of the joints, each with what puts it right."""
        motion, torque = (tuple(map(abs, columns)) for columns in (self.motion, self.torque))
        moved, found = [joint for joint in self.joints if motion[joint - 1] != joint], list[tuple[str, str]]()
        if moved and motion == torque:
            each = ", ".join(f"joint {joint} under joint {motion[joint - 1]}" for joint in moved)
            order = f"Put them in its order, --joints {','.join(map(str, motion))} where they have no names"
            found.append((f"Positions and torques stand in another order than the robot's joints: {each}", order))
        elif len(moved) == 2:
            pair = f"The positions of joints {moved[0]} and {moved[1]} stand in each other's place"
            found.append((f"{pair}, or their torques do", IN_ORDER))
        elif moved:
            found.append((f"The positions are in the order of other joints: {_under(motion)}", IN_ORDER))
        if motion != torque != tuple(range(1, len(torque) + 1)):
            found.append((f"The torques are in the order of other joints: {_under(torque)}", IN_ORDER))
        for joint in (joint for joint in self.joints if self.motion[joint - 1] < 0):
            what, remedy = f"The position of joint {joint} has the wrong sign", "Turn its column, not its torque's"
            if self.torque[joint - 1] < 0:
                what = (
                    f"Joint {joint} counts the other way than the robot's model: its position and its torque are turned"
                )
                remedy = "Turn both, or the joint's axis in the model"
            found.append((what, remedy))
        return tuple(found)

    @property
    def sentence(self) -> str:
        """What an operator reads of recordings by themselves."""
        better = "so read, the recording goes far better with one rigid body"
        return " ".join(f"{what}; {better}. {remedy}." for what, remedy in self.faults)

    def of(self, recording: Recording, revolute: BoolArray) -> Recording:
        """The recording read so. revolute: (n,) which joints have angles."""
        if self.degrees:
            recording = in_degrees(recording, revolute) or recording
        if self.ratio != 1.0:
            recording = with_clock(recording, self.ratio)
        changed: dict[str, Any] = {}
        for names, columns in ((MOTION, self.motion), (TORQUE, self.torque)):
            changed |= {name: placed(columns, values) for name, values in recording.arrays(names).items()}
        return replace(recording, **changed)

    def of_rows(self, rows: audit_rows.Rows) -> audit_rows.Rows:
        """Rows with their columns read so; clock and units stay."""
        changed: dict[str, Any] = {"used": rows.used[:, np.abs(self.motion) - 1]}
        for names, columns in ((audit_rows.MOTION, self.motion), (("torque", "torque_rate"), self.torque)):
            changed |= {name: placed(columns, getattr(rows, name)) for name in names}
        smooth = tuple(
            replace(each, torque=placed(self.torque, each.torque), rate=placed(self.torque, each.rate))
            for each in rows.smooth
        )
        return replace(rows, **changed, smooth=smooth)


def placed(columns: Columns, values: FloatArray) -> FloatArray:
    """(…, n) every recorded column under its joint, with its sign."""
    return np.asarray(np.sign(columns) * values[..., np.abs(columns) - 1])


def _under(columns: Iterable[int]) -> str:
    each = enumerate(columns, start=1)
    return ", ".join(f"that of joint {joint} stands under joint {column}" for joint, column in each if column != joint)


def read_so(reading: Reading | None, recordings: Sequence[Recording], robot: RobotModel) -> list[Recording]:
    """The recordings read so; as they stand for None."""
    if reading is None or not reading.is_other:
        return list(recordings)
    return [reading.of(item, robot.kinematics.revolute) for item in recordings]


def in_degrees(recording: Recording, revolute: BoolArray) -> Recording | None:
    """The recording with its positions taken for degrees, None where they can be radians."""
    span = np.abs(recording.position[:, revolute]).max(initial=0.0)
    if span < WIDEST_RAD:
        return None
    taken: dict[str, Any] = recording.arrays(MOTION)
    return replace(recording, **{name: np.where(revolute, np.radians(each), each) for name, each in taken.items()})


def with_clock(recording: Recording, ratio: float) -> Recording:
    """The recording with times that run so many times faster. A recorded velocity is its sensor's, and stays."""
    return replace(
        recording,
        time=recording.time / ratio,
        sampling_period_s=recording.sampling_period_s / ratio,
        period_s=None if recording.period_s is None else recording.period_s / ratio,
    )
