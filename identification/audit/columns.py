"""The torque of an arm that stands as one assumes, as columns: fourteen parameters a link, and what may be different.

Torque is linear in the parameters, in gravity, and in powers of the clock's ratio; so another set-up is a product, not
a new computation, but for the zeros of the joints.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from identification.arrays import FloatArray
from identification.audit.rows import Rows
from identification.regressor import INERTIAL_SYMBOLS, rigid_body_columns, torque_regressor
from identification.robots.installation import STANDARD_GRAVITY
from identification.robots.model import RobotModel

SYMBOLS = (*INERTIAL_SYMBOLS, "FV", "FS", "OFF", "IA")
PARAMETERS = len(SYMBOLS)
INERTIAL = len(INERTIAL_SYMBOLS)
HEAVY = 4
"""Of them the mass and the first moments feel gravity."""
GRAVITY = -STANDARD_GRAVITY[2]
_ZERO_STEP = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class SetUp:
    """How the arm stands and how the recording is to be read. gravity: (3,) m/s² in the base frame. delay_s: by how
    much the torque is late. zeros: (n,) rad to be added to the positions. ratio: true rate over stated rate. signs:
    (n,) of the torque.
    """

    gravity: FloatArray
    delay_s: float
    zeros: FloatArray
    ratio: float
    signs: FloatArray

    @classmethod
    def of(cls, robot: RobotModel) -> SetUp:
        """As the robot's description says."""
        return cls(np.array(robot.gravity, dtype=np.float64), 0.0, np.zeros(robot.n), 1.0, np.ones(robot.n))


class Geometry:
    """The rigid-body columns of some rows, without gravity and per unit of gravity along x, y, z of the base."""

    def __init__(self, robot: RobotModel, rows: Rows, zeros: FloatArray | None = None) -> None:
        self.robot, self.rows = robot, rows
        self.zeros = np.zeros(robot.n) if zeros is None else zeros
        position = rows.position + self.zeros
        still = np.zeros_like(position)
        free = replace(robot, gravity=np.zeros(3))
        self.inertial = torque_regressor(free, position, rows.velocity, rows.acceleration)
        heavy = [tuple(range(HEAVY))] * robot.n
        self.heavy = np.empty((3, len(position), robot.n, HEAVY * robot.n))
        for axis in range(3):
            one = replace(robot, gravity=np.eye(3)[axis])
            for part, columns in rigid_body_columns(one, position, still, still, heavy):
                self.heavy[axis, part] = columns.transpose(2, 1, 0)

    def at(self, zeros: FloatArray) -> Geometry:
        """The same rows with other zeros of the joints."""
        return self if np.array_equal(zeros, self.zeros) else Geometry(self.robot, self.rows, zeros)

    def turning_over(self, direction: FloatArray) -> Geometry:
        """The same rows with Coulomb friction by another direction (R, n)."""
        result = copy(self)
        result.rows = replace(self.rows, direction=direction)
        return result

    def columns(self, gravity: FloatArray, ratio: float = 1.0) -> FloatArray:
        """(R, n, 14 n) torque per unit of every parameter."""
        n = self.robot.n
        rigid = ratio**2 * self.inertial.reshape(-1, n, n, INERTIAL)
        rigid[..., :HEAVY] += np.tensordot(gravity, self.heavy, 1).reshape(-1, n, n, HEAVY)
        return _with_drives(rigid, self.rows, ratio)

    def weight(self, values: FloatArray) -> FloatArray:
        """(R, n, 3) torque of (14 n,) parameters per unit of gravity along x, y, z."""
        heavy = values.reshape(-1, PARAMETERS)[:, :HEAVY].ravel()
        return np.moveaxis(self.heavy @ heavy, 0, 2)

    def by_ratio(self, values: FloatArray, ratio: float) -> FloatArray:
        """(R, n) change of the torque of (14 n,) parameters with the logarithm of the clock's ratio."""
        moved = values.reshape(-1, PARAMETERS)
        rigid = self.inertial @ moved[:, :INERTIAL].ravel() + self.rows.acceleration * moved[:, -1]
        return np.asarray(2.0 * ratio**2 * rigid + ratio * self.rows.velocity * moved[:, INERTIAL])

    def by_zero(self, values: FloatArray, gravity: FloatArray, ratio: float) -> FloatArray:
        """(R, n, n) change of the torque of (14 n,) parameters with the zero of each joint, last axis."""
        rows, n = self.rows, self.robot.n
        inertial = values.reshape(-1, PARAMETERS)[:, :INERTIAL].ravel()
        robot = replace(self.robot, gravity=gravity)
        wanted = [tuple(range(INERTIAL))] * n
        result = np.zeros((len(rows.block), n, n))
        motion = ratio * rows.velocity, ratio**2 * rows.acceleration
        for joint in range(n):
            for sign in (-1.0, 1.0):
                position = rows.position + self.zeros
                position[:, joint] += sign * _ZERO_STEP
                for part, columns in rigid_body_columns(robot, position, *motion, wanted):
                    torque = np.tensordot(inertial, columns, 1)
                    result[part, :, joint] += sign / (2.0 * _ZERO_STEP) * torque.T
        return result


def columns_of(robot: RobotModel, rows: Rows, gravity: FloatArray) -> FloatArray:
    """(R, n, 14 n) as `Geometry.columns`, for the one gravity alone: a third of the time."""
    rigid = torque_regressor(replace(robot, gravity=gravity), rows.position, rows.velocity, rows.acceleration)
    return _with_drives(rigid.reshape(-1, robot.n, robot.n, INERTIAL), rows)


def _with_drives(rigid: FloatArray, rows: Rows, ratio: float = 1.0) -> FloatArray:
    """(R, n, 14 n) torque per unit of every parameter, of bodies (R, n, n, 10) and of each joint's own drive."""
    count, n = rows.velocity.shape
    result = np.zeros((count, n, n, PARAMETERS))
    result[..., :INERTIAL] = rigid
    own = np.stack(
        [ratio * rows.velocity, rows.direction, np.ones_like(rows.velocity), ratio**2 * rows.acceleration], axis=2
    )
    result[:, np.arange(n), np.arange(n), INERTIAL:] = own
    return result.reshape(count, n, -1)


def across(gravity: FloatArray) -> FloatArray:
    """(2, 3) two unit vectors at right angles to gravity and to each other."""
    down = gravity / np.linalg.norm(gravity)
    first = np.cross(down, np.eye(3)[int(np.argmin(np.abs(down)))])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(down, first)])
