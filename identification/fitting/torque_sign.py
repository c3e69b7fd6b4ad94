"""Does the recorded torque have the sign of the inverse dynamics? Asked of gravity at low speed, and of the fit.

A torque with the wrong sign fits exactly as well, with every parameter negated. What cannot be negated is physics: each
joint's own inertia is positive, and friction takes energy out. Nothing is turned silently.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from identification.arrays import FloatArray, evenly
from identification.base_parameters import BaseRegressor
from identification.json_values import plain
from identification.regressor import torque_regressor
from identification.robots import RobotModel

SIGNIFICANT = 3.0
DECISIVE = 16.0
"""Squares in σ by which one sign must break physics less than the other: odds of 3000 to 1."""
SLOW_SHARE = 0.1
MOST_STATES = 200
SINGULAR = 1e-8
"""Share of the largest variance of correlated quantities below which a combination of them is rounding."""


@dataclass(frozen=True, slots=True)
class TorqueSign:
    """What speaks for or against the sign of the recorded torque.

    gravity_correlation: correlation of the torque at low speed with gravity on equal masses at the joints; nan if it
    says nothing (no gravity torque, no slow samples). inertia_significance, friction_significance: (n,) each joint's
    own inertia, and the power friction takes out, divided by their standard deviation. inverted: whether the torque as
    a whole has the wrong sign: turned, it breaks physics by DECISIVE less than as it stands.
    """

    gravity_correlation: float
    inertia_significance: FloatArray
    friction_significance: FloatArray
    inverted: bool

    @property
    def inverted_joints(self) -> tuple[int, ...]:
        """Joints (from 1) whose own inertia or friction is significantly negative."""
        least = np.minimum(self.inertia_significance, self.friction_significance)
        return tuple(int(joint) + 1 for joint in np.flatnonzero(least < -SIGNIFICANT))

    def to_json(self) -> dict[str, Any]:
        """The check as plain JSON types."""
        return dict(plain(self))


def notes_on_signs(sign: TorqueSign) -> tuple[str, ...]:
    """A warning where single joints break physics: turning all torques would mend nothing, so the fit goes on."""
    joints = sign.inverted_joints
    if sign.inverted or not joints:
        return ()
    listed = ", ".join(map(str, joints))
    return (
        f"WARNING, inertia or friction of joint{'s' * (len(joints) > 1)} {listed} came out below zero by more than "
        f"{SIGNIFICANT:g} σ, which no arm has: a torque has the wrong sign or is another joint's, or much is left "
        "out; `iiwa-ident doctor --log` asks the recording",
    )


def judge_torque_sign(
    regressor: BaseRegressor,
    values: FloatArray,
    covariance: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    torque: FloatArray,
) -> TorqueSign:
    """Judge the sign from a fit. values: (p,), covariance: (p, p). position, velocity, torque: (S, n) of the motion."""
    directions = positive_quantities(regressor, position, velocity)
    values, covariance = directions @ values, directions @ covariance @ directions.T
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    significance = np.divide(values, deviation, out=np.zeros_like(values), where=deviation > 0.0)
    inertia, friction = significance.reshape(2, -1)
    broken = broken_squares(values, covariance)
    return TorqueSign(
        gravity_correlation(regressor.robot, position, velocity, torque),
        inertia,
        friction,
        broken > DECISIVE and broken - broken_squares(-values, covariance) > DECISIVE,
    )


def positive_quantities(regressor: BaseRegressor, position: FloatArray, velocity: FloatArray) -> FloatArray:
    """(2 n, p) what is positive on every real arm, as linear functions of the base parameters.

    First each joint's own inertia, then the power its friction takes out, both averaged over a motion (S, n).
    """
    chosen = evenly(len(position), MOST_STATES)
    q, dq = position[chosen], velocity[chosen]
    zero = np.zeros_like(q)
    at_rest = regressor.matrix(q, zero, zero)
    joints = q.shape[1]
    directions = np.zeros((2 * joints, regressor.size))
    for joint in range(joints):
        unit = zero.copy()
        unit[:, joint] = 1.0
        directions[joint] = (regressor.matrix(q, zero, unit)[:, joint] - at_rest[:, joint]).mean(axis=0)
        sizes = {"FV": float(np.square(dq[:, joint]).mean()), "FS": float(np.abs(dq[:, joint]).mean())}
        for symbol, size in sizes.items():
            name = f"{symbol}_{joint + 1}"
            if name in regressor.names:
                directions[joints + joint, regressor.position_of(name)] = size
    return directions


def broken_squares(values: FloatArray, covariance: FloatArray) -> float:
    """Squared distance in σ from quantities (m,) to the nearest that are all positive (nonnegative least squares)."""
    known = np.diag(covariance) > 0.0
    if not np.any(values[known] < 0.0):
        return 0.0
    from scipy.optimize import nnls  # slow to load, and a sound fit does without

    deviation = np.sqrt(np.diag(covariance)[known])
    scaled = values[known] / deviation
    size, axes = np.linalg.eigh(covariance[np.ix_(known, known)] / np.outer(deviation, deviation))
    kept = size > SINGULAR * size[-1]
    whitened = (axes[:, kept] / np.sqrt(size[kept])).T
    return float(nnls(whitened, whitened @ scaled)[1] ** 2)


def gravity_correlation(robot: RobotModel, position: FloatArray, velocity: FloatArray, torque: FloatArray) -> float:
    """Correlation of the torque, where the robot is slow, with gravity on equal point masses at every joint; or nan.

    position, velocity, torque: (S, n). The masses are no estimate, they only say which way gravity pulls.
    """
    speed = np.abs(velocity).max(axis=1)
    slow = np.flatnonzero(speed <= SLOW_SHARE * speed.max()) if speed.max() > 0.0 else np.arange(len(speed))
    if slow.size < 10:
        slow = np.argsort(speed)[: max(10, len(speed) // 20)]
    slow = slow[evenly(slow.size, MOST_STATES)]
    zero = np.zeros_like(position[slow])
    columns = torque_regressor(robot, position[slow], zero, zero)
    gravity = columns[:, :, ::10].sum(axis=2)
    measured = torque[slow]
    size = float(np.linalg.norm(gravity) * np.linalg.norm(measured))
    if size == 0.0 or np.linalg.norm(gravity) < 1e-6 * np.sqrt(gravity.size):
        return float("nan")
    return float(np.sum(gravity * measured)) / size
