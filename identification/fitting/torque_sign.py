"""Does the recorded torque have the sign of the inverse dynamics? Asked of gravity at low speed, and of the fit.

A torque with the wrong sign fits exactly as well, with every parameter negated. What cannot be negated is physics: each
joint's own inertia is positive, and friction takes energy out. Called by the fit; nothing is turned silently.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from identification.base_parameters import BaseRegressor
from identification.regressor import torque_regressor
from identification.robots import RobotModel

FloatArray = npt.NDArray[np.float64]

SIGNIFICANT = 3.0
SLOW_SHARE = 0.1
MOST_STATES = 200


@dataclass(frozen=True, slots=True)
class TorqueSign:
    """What speaks for or against the sign of the recorded torque.

    gravity_correlation: correlation of the torque at low speed with gravity on equal masses at the joints; nan if it
    says nothing (no gravity torque, no slow samples). inertia_significance, friction_significance: (n,) each joint's
    own inertia, and the power friction takes out, divided by their standard deviation.
    """

    gravity_correlation: float
    inertia_significance: FloatArray
    friction_significance: FloatArray

    @property
    def inverted_joints(self) -> tuple[int, ...]:
        """Joints (from 1) whose own inertia and friction are both negative, the inertia significantly."""
        wrong = (self.inertia_significance < -SIGNIFICANT) & (self.friction_significance < 0.0)
        return tuple(int(joint) + 1 for joint in np.flatnonzero(wrong))

    @property
    def inverted(self) -> bool:
        """Whether the torque as a whole has the wrong sign: every joint that says anything says so."""
        telling = np.abs(self.inertia_significance) > SIGNIFICANT
        return bool(telling.any() and np.all(self.inertia_significance[telling] < 0.0) and self.inverted_joints)

    def to_json(self) -> dict[str, Any]:
        """The check as plain JSON types."""
        return {
            "gravity_correlation": None if np.isnan(self.gravity_correlation) else self.gravity_correlation,
            "inertia_significance": [float(value) for value in self.inertia_significance],
            "friction_significance": [float(value) for value in self.friction_significance],
            "inverted": self.inverted,
        }


def judge_torque_sign(
    regressor: BaseRegressor,
    values: FloatArray,
    covariance: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    torque: FloatArray,
) -> TorqueSign:
    """Judge the sign from a fit. values: (p,), covariance: (p, p). position, velocity, torque: (S, n) of the motion."""
    chosen = np.linspace(0, len(position) - 1, min(MOST_STATES, len(position))).astype(int)
    q, dq = position[chosen], velocity[chosen]
    zero = np.zeros_like(q)
    at_rest = regressor.matrix(q, zero, zero)
    inertia, friction = [], []
    for joint in range(q.shape[1]):
        unit = zero.copy()
        unit[:, joint] = 1.0
        own = (regressor.matrix(q, zero, unit)[:, joint] - at_rest[:, joint]).mean(axis=0)
        inertia.append(_significance(own, values, covariance))
        power = np.zeros(regressor.size)
        sizes = {"FV": float(np.square(dq[:, joint]).mean()), "FS": float(np.abs(dq[:, joint]).mean())}
        for symbol, size in sizes.items():
            name = f"{symbol}_{joint + 1}"
            if name in regressor.names:
                power[regressor.position_of(name)] = size
        friction.append(_significance(power, values, covariance))
    return TorqueSign(
        gravity_correlation(regressor.robot, position, velocity, torque), np.array(inertia), np.array(friction)
    )


def gravity_correlation(robot: RobotModel, position: FloatArray, velocity: FloatArray, torque: FloatArray) -> float:
    """Correlation of the torque, where the robot is slow, with gravity on equal point masses at every joint; or nan.

    position, velocity, torque: (S, n). The masses are no estimate, they only say which way gravity pulls.
    """
    speed = np.abs(velocity).max(axis=1)
    slow = np.flatnonzero(speed <= SLOW_SHARE * speed.max()) if speed.max() > 0.0 else np.arange(len(speed))
    if slow.size < 10:
        slow = np.argsort(speed)[: max(10, len(speed) // 20)]
    slow = slow[np.linspace(0, slow.size - 1, min(MOST_STATES, slow.size)).astype(int)]
    zero = np.zeros_like(position[slow])
    columns = torque_regressor(robot, position[slow], zero, zero)
    gravity = columns[:, :, ::10].sum(axis=2)
    measured = torque[slow]
    size = float(np.linalg.norm(gravity) * np.linalg.norm(measured))
    if size == 0.0 or np.linalg.norm(gravity) < 1e-6 * np.sqrt(gravity.size):
        return float("nan")
    return float(np.sum(gravity * measured)) / size


def _significance(direction: FloatArray, values: FloatArray, covariance: FloatArray) -> float:
    deviation = float(np.sqrt(max(float(direction @ covariance @ direction), 0.0)))
    return float(direction @ values) / deviation if deviation > 0.0 else 0.0
