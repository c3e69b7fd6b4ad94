"""Does a joint count the other way than its model? Asked of a recording alone, as the places of positions (`exchange`).

Makers and URDF files differ in the direction in which a joint counts. Its position and its torque then have the other
sign together, which no sign of a torque alone shows: inertia and friction of the joint stay positive. Pure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.arrays import FloatArray
from identification.audit.columns import Geometry
from identification.audit.comparison import LEAST_GAIN
from identification.audit.directions import Directions
from identification.audit.exchange import likelier, noise_left
from identification.audit.given import sizes_of, wide_open
from identification.audit.rows import Rows, rows_of
from identification.recordings.recording import Recording
from identification.robots.model import RobotModel


@dataclass(frozen=True, slots=True)
class TurnedJoint:
    """joint: from 1. with_torque: its torque has the other sign too. gain: nats against the signs as they stand."""

    joint: int
    with_torque: bool
    gain: float

    @property
    def sentence(self) -> str:
        """What an operator reads."""
        if self.with_torque:
            return (
                f"Joint {self.joint} counts the other way than the robot's model: with its position and its torque "
                "turned, the recording goes far better with one rigid body. Turn both, or the joint's axis in the URDF."
            )
        return (
            f"The position of joint {self.joint} has the wrong sign: turned, the recording goes far better with one "
            "rigid body. Turn its column, not its torque's."
        )


def turned_joint(
    recordings: Sequence[Recording], robot: RobotModel, least_gain: float = LEAST_GAIN
) -> TurnedJoint | None:
    """The joint whose position has the wrong sign, with its torque or alone; None where another reason is likelier.

    least_gain: nats that the best other explanation gains. Joints that follow others are not asked. Raises
    RecordingError for recordings at rest or too short.
    """
    if robot.mimics or robot.n < 2:
        return None
    rows = rows_of(recordings)
    gravity, sizes = np.array(robot.gravity, dtype=np.float64), sizes_of(robot, rows)
    factor = wide_open(sizes)
    stated = Directions.of(Geometry(robot, rows), rows.torque)
    # A torque that alone has the wrong sign is a rival, and `data_faults` names it.
    torques = [_turned(rows.torque, joint) for joint in range(robot.n)]
    rivals = [stated, *(Directions.of(Geometry(robot, rows), torque) for torque in torques)]
    best: TurnedJoint | None = None
    for joint in range(robot.n):
        geometry = Geometry(robot, _mirrored(rows, joint))
        for with_torque in (False, True):
            other = Directions.of(geometry, torques[joint] if with_torque else rows.torque)
            std = noise_left(other, gravity, factor, sizes)
            least = max(least_gain, LEAST_GAIN, 0.0 if best is None else best.gain)
            gains = [likelier(other, rival, gravity, std, factor, least) for rival in (stated, rivals[1 + joint])]
            if all(gain is not None for gain in gains):
                best = TurnedJoint(joint + 1, with_torque, float(gains[0] or 0.0))
    return best


def _turned(values: FloatArray, joint: int) -> FloatArray:
    """The columns with the other sign for one joint, counted from 0."""
    return values * np.where(np.arange(values.shape[1]) == joint, -1.0, 1.0)


def _mirrored(rows: Rows, joint: int) -> Rows:
    """The rows with the motion of one joint turned round; torques stay."""
    return replace(
        rows,
        position=_turned(rows.position, joint),
        velocity=_turned(rows.velocity, joint),
        acceleration=_turned(rows.acceleration, joint),
        direction=_turned(rows.direction, joint),
    )
