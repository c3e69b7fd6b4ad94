"""A concealed plant for the tests of the diagnosis: Pinocchio's inverse dynamics plus torque written down here.

Nothing of `identification.mismatch` is used, so that the truth comes from outside. No test in here.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from identification.physical_parameters import PhysicalParameters
from identification.recordings import Recording
from identification.robots import RobotModel
from tests.identification.synthetic import fourier_motion, inverse_dynamics, recording_of

FloatArray = npt.NDArray[np.float64]
Hidden = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]

PERIOD_S = 10.0
SAMPLES = 2000
NOISE_NM = 0.05


def no_effect(q: FloatArray, dq: FloatArray, torque: FloatArray) -> FloatArray:
    return np.zeros_like(torque)


def record(
    robot: RobotModel,
    parameters: PhysicalParameters,
    hidden: Hidden = no_effect,
    *,
    periods: int = 8,
    motion: int = 3,
    seed: int = 1,
    position_noise: float = 0.0,
) -> Recording:
    """Recording of the plant with `hidden` (q, dq, torque) → extra torque, white torque noise of 0.05 Nm."""
    random = np.random.default_rng(seed)
    q, dq, ddq = fourier_motion(robot.n, period_s=PERIOD_S, samples=SAMPLES, seed=motion)
    torque = inverse_dynamics(robot, parameters, q, dq, ddq)
    torque = torque + hidden(q, dq, torque)
    shape = (periods * SAMPLES, robot.n)
    return recording_of(
        np.tile(q, (periods, 1)) + position_noise * random.normal(size=shape),
        np.tile(torque, (periods, 1)) + NOISE_NM * random.normal(size=shape),
        period_s=PERIOD_S,
        periods=periods,
    )


def on_joint(joint: int, values: FloatArray) -> FloatArray:
    """(S, 7) with values on one joint, counted from 1."""
    torque = np.zeros((values.size, 7))
    torque[:, joint - 1] = values
    return torque
