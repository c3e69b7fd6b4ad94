"""Do the positions of two joints stand in each other's place? Asked of a recording alone, as gravity is (`mount`).

Of all pairs the exchange is taken that makes the torque likeliest. Which of two exchanged torques or positions is wrong
the torque does not always tell on parallel axes, so the sentence names both. Pure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from identification.arrays import FloatArray
from identification.audit.columns import Geometry
from identification.audit.comparison import LEAST_GAIN
from identification.audit.directions import Directions
from identification.audit.given import Sizes, sizes_of, wide_open
from identification.audit.misread import STAYS
from identification.audit.rows import MOTION, REPEATED, Rows, rows_of
from identification.recordings.recording import Recording
from identification.robots.model import RobotModel

_TURNS = 2
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


def exchanged_positions(
    recordings: Sequence[Recording], robot: RobotModel, least_gain: float = LEAST_GAIN
) -> Exchange | None:
    """The two joints whose positions are exchanged; None where the order holds, or another explains the misfit better.

    least_gain: nats that the best other explanation gains. Joints that follow others are not asked. Raises
    RecordingError for recordings at rest or too short.
    """
    if robot.mimics or robot.n < 2:
        return None
    rows = rows_of(recordings)
    gravity, sizes = np.array(robot.gravity, dtype=np.float64), sizes_of(robot, rows)
    factor = wide_open(sizes)
    stated = Directions.of(Geometry(robot, rows), rows.torque)
    best: Exchange | None = None
    for pair in combinations(range(robot.n), 2):
        other = Directions.of(Geometry(robot, _exchanged(rows, pair)), rows.torque)
        std = noise_left(other, gravity, factor, sizes)
        least = max(least_gain, LEAST_GAIN, 0.0 if best is None else best.gain)
        gain = likelier(other, stated, gravity, std, factor, least)
        if gain is not None:
            best = Exchange((pair[0] + 1, pair[1] + 1), gain)
    return best


def noise_left(other: Directions, gravity: FloatArray, factor: FloatArray, sizes: Sizes) -> FloatArray:
    """(n,) Nm that free parameters leave when the rows are read in another way."""
    std = np.maximum(0.1 * sizes.torque, 1e-9)
    for _ in range(_TURNS):
        std = np.maximum(other.left(gravity, 1.0 / std**2, factor), sizes.least_noise)
    return std


def likelier(
    other: Directions, stated: Directions, gravity: FloatArray, std: FloatArray, factor: FloatArray, least: float
) -> float | None:
    """Nats by which rows read in another way are likelier; None for `least` or fewer, or where much misfit stays."""
    weight, mean = 1.0 / (REPEATED * std**2), np.zeros(len(factor))
    gain = other.evidence(gravity, weight, mean, factor) - stated.evidence(gravity, weight, mean, factor)
    if gain <= least:
        return None
    after, before = (float((item.left(gravity, weight, factor) ** 2 / std**2).sum()) for item in (other, stated))
    return gain if after <= STAYS * before else None


def _exchanged(rows: Rows, pair: tuple[int, int]) -> Rows:
    """The rows with the motion of two joints in each other's place; torques stay."""
    order = np.arange(rows.position.shape[1])
    order[list(pair)] = order[list(pair[::-1])]
    motion: dict[str, Any] = {name: getattr(rows, name)[:, order] for name in MOTION}
    return replace(rows, **motion)
