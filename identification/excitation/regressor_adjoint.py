"""The torque regressor of a chain of joints for many samples at once, and its exact reverse derivative.

Here: chosen columns of Y(q, q̇, q̈), eq. (5), and, for any scalar φ of Y given through Ȳ = ∂φ/∂Y, the gradients
∂φ/∂q, ∂φ/∂q̇, ∂φ/∂q̈ at the cost of about two evaluations. Not here: the regressor that fits use
(`identification.regressor`, which the tests compare this one with), friction, and any objective. Only the excitation
designer calls it: it needs derivatives, and keeps the intermediate values for them.

Notation: spatial vectors (linear, angular) in world axes with the world origin as reference point, as in Featherstone
2008. S_i is the screw of joint i, A[j, i] = 1 where joint i moves link j. With δξ_j = Σ A[j, i] S_i δq_i the shift of
link j's frame, a screw varies by δS_i = δξ_i × S_i, which is all that differentiating the kinematics takes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identification.arrays import FloatArray
from identification.regressor import INERTIAL_SYMBOLS, skew
from identification.robots import Kinematics

PARAMETERS_PER_LINK = len(INERTIAL_SYMBOLS)


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cross product over the last axis; numpy's own costs several times as much on arrays this small."""
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    out[..., 0] = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    out[..., 1] = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    out[..., 2] = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return out


def _motion_cross(v: FloatArray, s: FloatArray) -> FloatArray:
    """V × s of two motion vectors (linear, angular)."""
    return np.concatenate(
        [_cross(v[..., 3:], s[..., :3]) + _cross(v[..., :3], s[..., 3:]), _cross(v[..., 3:], s[..., 3:])], axis=-1
    )


def _force_cross(v: FloatArray, f: FloatArray) -> FloatArray:
    """V ×* f of a motion and a force vector, so that (v ×* f)·s = -f·(v × s)."""
    return np.concatenate(
        [_cross(v[..., 3:], f[..., :3]), _cross(v[..., 3:], f[..., 3:]) + _cross(v[..., :3], f[..., :3])], axis=-1
    )


def _rotate(rotation: FloatArray, vector: FloatArray) -> FloatArray:
    """R v for stacks of rotations (..., 3, 3) and vectors (..., 3)."""
    return (rotation @ vector[..., None])[..., 0]


def _rotate_back(rotation: FloatArray, vector: FloatArray) -> FloatArray:
    """Rᵀ v for stacks of rotations (..., 3, 3) and vectors (..., 3)."""
    return (vector[..., None, :] @ rotation)[..., 0, :]


def _skew_adjoint(matrix: FloatArray) -> FloatArray:
    """Gradient of <M, [x]> in x for stacks (..., 3, 3), [x] being the cross-product matrix."""
    return np.stack(
        [
            matrix[..., 2, 1] - matrix[..., 1, 2],
            matrix[..., 0, 2] - matrix[..., 2, 0],
            matrix[..., 1, 0] - matrix[..., 0, 1],
        ],
        axis=-1,
    )


def _inertia_columns(x: FloatArray) -> FloatArray:
    """K(x) with I x = K(x) (XX, XY, XZ, YY, YZ, ZZ): (..., 3) -> (..., 3, 6)."""
    out = np.zeros((*x.shape, 6))
    out[..., 0, :3] = x
    out[..., 1, 1] = x[..., 0]
    out[..., 1, 3:5] = x[..., 1:]
    out[..., 2, 2] = x[..., 0]
    out[..., 2, 4:] = x[..., 1:]
    return out


def _inertia_adjoint(n: FloatArray) -> FloatArray:
    """Gradient of <N, K(x)> in x: (..., 3, 6) -> (..., 3)."""
    return np.stack(
        [
            n[..., 0, 0] + n[..., 1, 1] + n[..., 2, 2],
            n[..., 0, 1] + n[..., 1, 3] + n[..., 2, 4],
            n[..., 0, 2] + n[..., 1, 4] + n[..., 2, 5],
        ],
        axis=-1,
    )


@dataclass(frozen=True, slots=True)
class ChainMotion:
    """Intermediate values of one evaluation, kept for the reverse pass. S samples, n links.

    rotation (S, n, 3, 3), origin (S, n, 3): link frames in the world; screw, screw_rate, velocity, acceleration
    (S, n, 6) spatial, the acceleration with gravity's -g; wrench_columns (S, n, 6, 10): world wrench of each link per
    unit of each of its parameters.
    """

    joint_velocity: FloatArray
    joint_acceleration: FloatArray
    rotation: FloatArray
    origin: FloatArray
    screw: FloatArray
    screw_rate: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    wrench_columns: FloatArray


class ChainRegressor:
    """Columns of the torque regressor of a fixed-base robot whose joints have one degree of freedom each.

    kinematics: joint tree, revolute and prismatic joints; gravity: (3,) m/s² in the base frame.
    """

    def __init__(self, kinematics: Kinematics, gravity: FloatArray) -> None:
        n = kinematics.n
        self.n = n
        self._parent = [int(parent) for parent in kinematics.parent]
        self._fixed_rotation = kinematics.rotation
        self._fixed_translation = kinematics.translation
        revolute = kinematics.revolute[:, None]
        self._local_screw = np.concatenate(
            [np.where(revolute, 0.0, kinematics.axis), np.where(revolute, kinematics.axis, 0.0)], axis=1
        )
        self._gravity = np.asarray(gravity, dtype=np.float64)
        self._moves = np.zeros((n, n))
        for j in range(n):
            self._moves[j, list(kinematics.upstream(j))] = 1.0

    def motion(self, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> ChainMotion:
        """Kinematics of all links and their wrench columns. q, dq, ddq: (S, n) rad, rad/s, rad/s² (or m)."""
        rotation, origin = self._frames(q)
        linear = _rotate(rotation, np.broadcast_to(self._local_screw[:, :3], origin.shape))
        angular = _rotate(rotation, np.broadcast_to(self._local_screw[:, 3:], origin.shape))
        screw = np.concatenate([linear + _cross(origin, angular), angular], axis=-1)
        velocity = self._moves @ (screw * dq[..., None])
        screw_rate = _motion_cross(velocity, screw)
        acceleration = self._moves @ (screw * ddq[..., None] + screw_rate * dq[..., None])
        acceleration[..., :3] -= self._gravity
        columns = self._wrench_columns(rotation, origin, velocity, acceleration)
        return ChainMotion(dq, ddq, rotation, origin, screw, screw_rate, velocity, acceleration, columns)

    def matrix(self, motion: ChainMotion) -> FloatArray:
        """The inertial regressor Y, (S, n, 10 n): torque rows of joint k, columns of link j in eq. (3)'s order."""
        samples = len(motion.screw)
        columns = motion.wrench_columns.transpose(0, 2, 1, 3).reshape(samples, 6, self.n * PARAMETERS_PER_LINK)
        matrix = motion.screw @ columns
        return matrix * np.repeat(self._moves.T, PARAMETERS_PER_LINK, axis=1)

    def gradient(self, motion: ChainMotion, weights: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """∂φ/∂q, ∂φ/∂q̇, ∂φ/∂q̈, each (S, n), from weights = ∂φ/∂Y of shape (S, n, 10 n)."""
        samples, n, p = len(motion.screw), self.n, PARAMETERS_PER_LINK
        weights = weights * np.repeat(self._moves.T, p, axis=1)
        columns = motion.wrench_columns.transpose(0, 2, 1, 3).reshape(samples, 6, n * p)
        screw_weight = weights @ columns.transpose(0, 2, 1)
        # Motion-type vectors dual to the wrench columns: φ = Σ_j <dual_j, wrench_columns_j>.
        dual = (motion.screw.transpose(0, 2, 1) @ weights).reshape(samples, 6, n, p).transpose(0, 2, 1, 3)
        shift, velocity_weight, acceleration_weight = self._wrench_column_gradient(motion, dual)

        below = self._moves.T @ acceleration_weight
        dq, ddq = motion.joint_velocity[..., None], motion.joint_acceleration[..., None]
        velocity_weight = self._moves.T @ (velocity_weight + dq * _force_cross(motion.screw, below))
        screw_weight = screw_weight + ddq * below + dq * (velocity_weight - _force_cross(motion.velocity, below))
        shift = shift + _force_cross(motion.screw, screw_weight)
        by_acceleration = np.sum(motion.screw * below, axis=-1)
        by_velocity = np.sum(motion.screw * velocity_weight + motion.screw_rate * below, axis=-1)
        by_position = np.sum(motion.screw * (self._moves.T @ shift), axis=-1)
        return by_position, by_velocity, by_acceleration

    def _frames(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """World rotation (S, n, 3, 3) and origin (S, n, 3) of every link frame."""
        samples = len(q)
        rotation = np.empty((samples, self.n, 3, 3))
        origin = np.empty((samples, self.n, 3))
        own_rotation = self._joint_rotations(q)
        for j, parent in enumerate(self._parent):
            placed = self._fixed_rotation[j] @ own_rotation[:, j]
            moved = self._fixed_translation[j] + np.multiply.outer(
                q[:, j], self._fixed_rotation[j] @ self._local_screw[j, :3]
            )
            if parent < 0:
                rotation[:, j], origin[:, j] = placed, moved
            else:
                rotation[:, j] = rotation[:, parent] @ placed
                origin[:, j] = origin[:, parent] + _rotate(rotation[:, parent], moved)
        return rotation, origin

    def _joint_rotations(self, q: FloatArray) -> FloatArray:
        """Rotation of every joint about its own axis (identity for a prismatic one), (S, n, 3, 3)."""
        axis = self._local_screw[:, 3:]
        cross = skew(axis)
        sin, cos = np.sin(q)[..., None, None], np.cos(q)[..., None, None]
        return np.eye(3) + sin * cross + (1.0 - cos) * (cross @ cross)

    @staticmethod
    def _wrench_columns(
        rotation: FloatArray, origin: FloatArray, velocity: FloatArray, acceleration: FloatArray
    ) -> FloatArray:
        """World wrench of each link per unit parameter, (S, n, 6, 10): f = m a + …, n = I ω̇ + ω × I ω + h × a."""
        w, wd, classical = ChainRegressor._link_motion(rotation, origin, velocity, acceleration)
        force = np.zeros((*w.shape, PARAMETERS_PER_LINK))
        moment = np.zeros((*w.shape, PARAMETERS_PER_LINK))
        eye = np.eye(3)
        force[..., 0] = classical
        squared = w[..., :, None] * w[..., None, :] - np.sum(w * w, axis=-1)[..., None, None] * eye
        force[..., 1:4] = skew(wd) + squared
        moment[..., 1:4] = -skew(classical)
        own = _inertia_columns(w)
        moment[..., 4:] = _inertia_columns(wd) + skew(w) @ own
        force = rotation @ force
        moment = rotation @ moment + skew(origin) @ force
        return np.concatenate([force, moment], axis=-2)

    @staticmethod
    def _link_motion(
        rotation: FloatArray, origin: FloatArray, velocity: FloatArray, acceleration: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """ω, ω̇ and the classical acceleration of the link's origin (gravity included), all in the link frame."""
        w, wd = velocity[..., 3:], acceleration[..., 3:]
        point_velocity = velocity[..., :3] + _cross(w, origin)
        classical = acceleration[..., :3] + _cross(wd, origin) + _cross(w, point_velocity)
        return _rotate_back(rotation, w), _rotate_back(rotation, wd), _rotate_back(rotation, classical)

    @staticmethod
    def _wrench_column_gradient(motion: ChainMotion, dual: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Gradients of <dual, wrench columns> in each link's shift ξ, velocity and acceleration, each (S, n, 6).

        dual: (S, n, 6, 10), motion-type columns held constant.
        """
        rotation, origin = motion.rotation, motion.origin
        w = _rotate_back(rotation, motion.velocity[..., 3:])
        back = rotation.transpose(0, 1, 3, 2)
        dual_angular = back @ dual[..., 3:, :]
        dual_linear = back @ (dual[..., :3, :] - skew(origin) @ dual[..., 3:, :])

        first_moment_force, first_moment_moment = dual_linear[..., 1:4], dual_angular[..., 1:4]
        inertia_moment = dual_angular[..., 4:]
        by_classical = dual_linear[..., 0] - _skew_adjoint(first_moment_moment)
        by_wd = _skew_adjoint(first_moment_force) + _inertia_adjoint(inertia_moment)
        symmetric = first_moment_force + first_moment_force.transpose(0, 1, 3, 2)
        trace = np.trace(first_moment_force, axis1=-2, axis2=-1)
        own = _inertia_columns(w)
        # Σ_c a_c × b_c over columns is the skew part of A Bᵀ, a matrix product where crosses would fill memory.
        gyroscopic = -_skew_adjoint(own @ inertia_moment.swapaxes(-1, -2))
        by_w = (
            _rotate(symmetric, w)
            - 2.0 * trace[..., None] * w
            + gyroscopic
            + _inertia_adjoint(-skew(w) @ inertia_moment)
        )
        # Classical acceleration of the origin = spatial part + ω × v; bring all to world forces about the world origin.
        link_velocity = _rotate_back(rotation, motion.velocity[..., :3] + _cross(motion.velocity[..., 3:], origin))
        velocity_weight = _world_force(
            rotation, origin, _cross(by_classical, w), by_w + _cross(link_velocity, by_classical)
        )
        acceleration_weight = _world_force(rotation, origin, by_classical, by_wd)
        products = dual @ motion.wrench_columns.swapaxes(-1, -2)
        by_columns = np.concatenate(
            [_skew_adjoint(products[..., 3:, :3]), _skew_adjoint(products[..., 3:, 3:] + products[..., :3, :3])],
            axis=-1,
        )
        shift = by_columns - (
            _force_cross(motion.velocity, velocity_weight) + _force_cross(motion.acceleration, acceleration_weight)
        )
        return shift, velocity_weight, acceleration_weight


def _world_force(rotation: FloatArray, origin: FloatArray, force: FloatArray, moment: FloatArray) -> FloatArray:
    """A force vector given at the link's origin in link axes, moved to the world origin and axes, (..., 6)."""
    force = _rotate(rotation, force)
    return np.concatenate([force, _rotate(rotation, moment) + _cross(origin, force)], axis=-1)
