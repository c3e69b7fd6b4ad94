"""Does a joint count the other way than its model? Asked of a recording alone, as the places of positions are
(`exchange`), and of a recording beside a model.

Makers and URDF files differ in the direction in which a joint counts. Its position and its torque then have the other
sign together, which no sign of a torque alone shows: inertia and friction of the joint stay positive. Pure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from identification.arrays import FloatArray
from identification.audit.columns import Geometry, SetUp
from identification.audit.comparison import LEAST_GAIN
from identification.audit.directions import Directions
from identification.audit.exchange import Exchange, Stated, exchanged_positions
from identification.audit.given import GivenModel
from identification.audit.misread import beside_friction, least_square
from identification.audit.other_order import OtherOrder, other_order
from identification.audit.rows import REPEATED, Rows
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

    @property
    def against(self) -> str:
        """The same against a model, as the beginning of a sentence."""
        if self.with_torque:
            return (
                f"Joint {self.joint} counts the other way than the model: its position and its torque are turned. Turn "
                "both, or the joint's axis in the model"
            )
        return f"The position of joint {self.joint} has the wrong sign. Turn its column, not its torque's"


def turned_joint(
    recordings: Sequence[Recording], robot: RobotModel, least_gain: float = LEAST_GAIN
) -> TurnedJoint | None:
    """The joint whose position has the wrong sign, with its torque or alone; None where another reason is likelier.

    least_gain: nats that the best other explanation gains. Joints that follow others are not asked. Raises
    RecordingError for recordings at rest or too short.
    """
    stated = Stated.of(recordings, robot)
    if stated is None:
        return None
    rows = stated.rows
    # A torque that alone has the wrong sign is a rival, and `data_faults` names it.
    as_it_stands = Directions.of(Geometry(robot, rows), rows.torque)
    best: TurnedJoint | None = None
    for joint in range(robot.n):
        turned = Directions.of(Geometry(robot, rows.turned(joint, with_torque=False)), rows.torque)
        for with_torque in (False, True):
            other = turned.with_torque_turned(joint) if with_torque else turned
            gain = stated.gain_of(other, max(least_gain, LEAST_GAIN), as_it_stands.with_torque_turned(joint))
            # Readings are held against each other by what each gains on the signs as stated, not on its own rival.
            if gain is not None and (best is None or gain > best.gain):
                best = TurnedJoint(joint + 1, with_torque, gain)
    return best


def misplaced_joints(
    recordings: Sequence[Recording], robot: RobotModel, least_gain: float = LEAST_GAIN
) -> Exchange | TurnedJoint | OtherOrder | None:
    """Two joints whose positions are exchanged, the joint that is turned, or all in another order, as is likeliest.

    As `turned_joint`.
    """
    one = exchanged_positions(recordings, robot, least_gain) or turned_joint(recordings, robot, least_gain)
    return other_order(recordings, robot, least_gain if one is None else max(least_gain, one.gain)) or one


def turned_against(geometry: Geometry, set_up: SetUp, model: GivenModel) -> tuple[Rows, TurnedJoint] | None:
    """The rows with that joint turned which comes nearest to a model, if that makes the recording clearly likelier."""
    rows, n = geometry.rows, geometry.robot.n
    used = rows.used.all(axis=1)
    expected = geometry.columns(set_up.gravity) @ model.values
    # A drawn model says nothing of friction, which turns with its joint: it is taken off both.
    known = expected if model.own else beside_friction(rows, expected)
    floor = least_square(model, known[used])

    def nats(torque: FloatArray, expected: FloatArray) -> float:
        left = torque - expected if model.own else beside_friction(rows, torque - expected)
        return -0.5 / REPEATED * float((left[used] ** 2 / floor).sum())

    stated = nats(rows.torque, expected)
    gain, best = LEAST_GAIN, None
    for joint in range(n if n > 1 else 0):
        both, alone = (rows.turned(joint, with_torque=with_torque) for with_torque in (True, False))
        expected = Geometry(geometry.robot, alone).columns(set_up.gravity) @ model.values
        for other in (both, alone):
            found = nats(other.torque, expected) - stated
            if found > gain:
                gain, best = found, (other, TurnedJoint(joint + 1, other is both, found))
    return best
