"""How recordings are to be read beside a model: degrees, clock, columns and signs of the joints. Pure.

Here: what is read otherwise than it stands, and recordings read so. Not here: how that is found (`misread`, `exchange`,
`turned`, `search`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from identification.arrays import BoolArray, FloatArray, IntArray
from identification.recordings.recording import Recording
from identification.robots.model import RobotModel

MOTION = ("position", "velocity", "command_position", "link_position")
TORQUE = ("torque", "external_torque")
WIDEST_RAD = 4.0 * np.pi
"""No joint of an arm turns that far; in degrees nearly every motion does."""

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

    def in_order(self, order: IntArray) -> Reading:
        """With the torque that stands under joint order[j], from 0, under joint j."""
        return replace(self, torque=tuple(self.torque[column] for column in order))

    def with_positions(self, order: IntArray) -> Reading:
        """With the motion that stands under joint order[j], from 0, under joint j."""
        return replace(self, motion=tuple(self.motion[column] for column in order))

    def turned(self, motion: FloatArray, torque: FloatArray) -> Reading:
        """With those signs, each (n,) ±1, of motion and torque turned besides."""
        motions, torques = (
            tuple(int(sign) * column for sign, column in zip(signs.tolist(), columns, strict=True))
            for signs, columns in ((motion, self.motion), (torque, self.torque))
        )
        return replace(self, motion=motions, torque=torques)

    @property
    def is_other(self) -> bool:
        """Whether anything is read otherwise than it stands."""
        return self != Reading.as_recorded(len(self.torque))

    def of(self, recording: Recording, revolute: BoolArray) -> Recording:
        """The recording read so. revolute: (n,) which joints have angles."""
        if self.degrees:
            recording = in_degrees(recording, revolute) or recording
        if self.ratio != 1.0:
            recording = with_clock(recording, self.ratio)
        changed: dict[str, Any] = {}
        for names, columns in ((MOTION, self.motion), (TORQUE, self.torque)):
            order, signs = np.abs(columns) - 1, np.sign(columns)
            changed |= {name: signs * values[:, order] for name, values in recording.arrays(names).items()}
        return replace(recording, **changed)


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
