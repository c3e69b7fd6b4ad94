"""Do the positions of two joints stand in each other's place? Asked of a recording alone, as gravity is (`mount`).

Of all pairs the exchange is taken that makes the torque likeliest. Which of two exchanged torques or positions is wrong
the torque does not always tell on parallel axes, so the sentence names both. Pure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import combinations
from typing import Any

import numpy as np

from identification.arrays import FloatArray, IntArray
from identification.audit.columns import Geometry
from identification.audit.comparison import LEAST_GAIN
from identification.audit.directions import Directions
from identification.audit.given import Sizes, sizes_of, wide_open
from identification.audit.misread import STAYS
from identification.audit.rows import MOTION, REPEATED, Rows, rows_of
from identification.recordings.recording import Recording
from identification.robots.model import RobotModel

TURNS = 2
"""In which the noise that an order of joints leaves and its parameters settle."""


@dataclass(frozen=True, slots=True)
class Exchange:
    """joints: the two, from 1. gain: nats against the order as it stands."""

    joints: tuple[int, int]
    gain: float

    @property
    def sentence(self) -> str:
        """What an operator reads."""
        first, second = self.joints
        return (
            f"The positions of joints {first} and {second} stand in each other's place, or their torques do: "
            "exchanged, the recording goes far better with one rigid body. Put the columns in the robot's order."
        )

    @property
    def against(self) -> str:
        """The same against a model, as the beginning of a sentence."""
        first, second = self.joints
        return (
            f"The positions of joints {first} and {second} stand in each other's place, or their torques do. Put the "
            "columns in the robot's order"
        )

    def order(self, n: int) -> IntArray:
        """(n,) the column from 0 that belongs to each joint."""
        order, (first, second) = np.arange(n), self.joints
        order[[first - 1, second - 1]] = second - 1, first - 1
        return order

    def undone(self, rows: Rows) -> Rows:
        """Rows with the motion of the two in each other's place; torques stay."""
        order = self.order(rows.position.shape[1])
        motion: dict[str, Any] = {name: getattr(rows, name)[:, order] for name in MOTION}
        return replace(rows, **motion)


@dataclass(frozen=True, slots=True, eq=False)
class Stated:
    """Rows as they are stated, which another reading of them is held against. gravity: (3,) m/s². factor: (14 n,) width
    of parameters that nobody knows. directions: the rows with their torque, wherever gravity points.
    """

    rows: Rows
    gravity: FloatArray
    sizes: Sizes
    factor: FloatArray
    directions: Directions

    @classmethod
    def of(cls, recordings: Sequence[Recording], robot: RobotModel) -> Stated | None:
        """Of some recordings; None for one joint, and for joints that follow others. Raises RecordingError for
        recordings at rest or too short.
        """
        return None if robot.mimics or robot.n < 2 else _stated(tuple(recordings), robot)

    @classmethod
    def of_rows(cls, rows: Rows, robot: RobotModel) -> Stated:
        """Of rows, read as they are."""
        sizes = sizes_of(robot, rows)
        stated = Directions.of(Geometry(robot, rows), rows.torque)
        return cls(rows, np.array(robot.gravity, dtype=np.float64), sizes, wide_open(sizes), stated)

    def left_by(self, other: Directions) -> FloatArray:
        """(n,) Nm RMS that free parameters leave of rows read in another way."""
        std = self.sizes.first_noise
        for _ in range(TURNS):
            std = np.maximum(other.left(self.gravity, 1.0 / std**2, self.factor), self.sizes.least_noise)
        return std

    def under(self, std: FloatArray) -> tuple[float, float]:
        """Log evidence of these rows, and the squares that stay of them, both by a noise (n,) Nm."""
        weight, mean = 1.0 / (REPEATED * std**2), np.zeros(len(self.factor))
        squares = float((self.directions.left(self.gravity, weight, self.factor) ** 2 / std**2).sum())
        return self.directions.evidence(self.gravity, weight, mean, self.factor), squares

    def gain_of(self, other: Directions, least: float, *rivals: Directions) -> float | None:
        """Nats by which rows read in another way are likelier; None for `least` or fewer, or where much misfit stays.

        rivals: other readings, which the same holds against.
        """
        std = self.left_by(other)
        gains = [self._likelier(other, rival, std, least) for rival in (self.directions, *rivals)]
        return None if None in gains else gains[0]

    def _likelier(self, other: Directions, rival: Directions, std: FloatArray, least: float) -> float | None:
        gravity, factor = self.gravity, self.factor
        weight, mean = 1.0 / (REPEATED * std**2), np.zeros(len(factor))
        gain = other.evidence(gravity, weight, mean, factor) - rival.evidence(gravity, weight, mean, factor)
        if gain <= least:
            return None
        after, before = (float((item.left(gravity, weight, factor) ** 2 / std**2).sum()) for item in (other, rival))
        return gain if after <= STAYS * before else None


@lru_cache(maxsize=1)
def _stated(recordings: tuple[Recording, ...], robot: RobotModel) -> Stated:
    """One reading after the other is held against it."""
    return Stated.of_rows(rows_of(recordings), robot)


def exchanged_positions(
    recordings: Sequence[Recording], robot: RobotModel, least_gain: float = LEAST_GAIN
) -> Exchange | None:
    """The two joints whose positions are exchanged; None where the order holds, or another explains the misfit better.

    least_gain: nats that the best other explanation gains. Joints that follow others are not asked. Raises
    RecordingError for recordings at rest or too short.
    """
    stated = Stated.of(recordings, robot)
    if stated is None:
        return None
    best: Exchange | None = None
    for first, second in combinations(range(1, robot.n + 1), 2):
        pair = Exchange((first, second), 0.0 if best is None else best.gain)
        other = Directions.of(Geometry(robot, pair.undone(stated.rows)), stated.rows.torque)
        gain = stated.gain_of(other, max(least_gain, LEAST_GAIN, pair.gain))
        if gain is not None:
            best = replace(pair, gain=gain)
    return best
