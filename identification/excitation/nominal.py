"""What is taken to be known of an arm before it is measured: parameters near enough to foresee its torque.

Here: where the prior comes from, and the limit on torque as a term of the search. Not here: the final check at 1 kHz
(`constraints.verify`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from identification.arrays import FloatArray
from identification.base_parameters import BaseRegressor, RegressorOptions
from identification.errors import DesignError
from identification.excitation.objective import Samples
from identification.physical_parameters import PhysicalParameters
from identification.robots import RobotModel
from identification.robots.table_three import table_three

_ROOM = 0.97
"""Part of the torque limit that the search keeps to at its samples; between them the torque is a little larger."""
_STEEPNESS = 100.0
"""A torque 5 % above its limit at a single sample costs 0.6, more than any 5 % of motion can gain."""


def nominal_parameters(robot: RobotModel, model_file: Path | None = None) -> PhysicalParameters | None:
    """The prior: of a model.json, else of the robot's URDF (no friction), else the paper's Table 3 for the iiwa 14.

    None where none of them is there. Raises DesignError for a model without physical parameters or of another number
    of joints, ModelFileError for a file that is none.
    """
    if model_file is not None:
        from identification.model_file import read_model

        physical = read_model(model_file).physical
        if physical is None or physical.n != robot.n:
            raise DesignError(f"{model_file} holds no physical parameters of a robot with {robot.n} joints")
        return physical
    bodies = [robot.pinocchio_model.inertias[joint + 1] for joint in range(robot.n)]
    if any(body.mass > 0.0 for body in bodies):
        still = np.zeros(robot.n)
        return PhysicalParameters(
            np.array([body.mass for body in bodies]),
            np.array([body.lever for body in bodies]),
            np.array([0.5 * (body.inertia + body.inertia.T) for body in bodies]),
            still,
            still.copy(),
        )
    return table_three() if robot.name == "iiwa14" else None


def searched_base_values(robot: RobotModel, nominal: PhysicalParameters) -> FloatArray:
    """(p,) base parameters in the order of the search's columns: inertial ones, then FV_1..n, then FS_1..n."""
    inertial = BaseRegressor(robot, RegressorOptions(viscous=False, coulomb=False)).base_from_physical(nominal)
    return np.concatenate([inertial, nominal.viscous, nominal.coulomb])


def foreseen_torque(
    regressor: BaseRegressor, nominal: PhysicalParameters
) -> Callable[[FloatArray, FloatArray, FloatArray], FloatArray]:
    """The torque (S, n) Nm of the nominal arm as a function of q, q̇, q̈ (S, n), true sign of the velocity."""
    values = regressor.base_from_physical(nominal)
    return lambda q, dq, ddq: np.asarray(regressor.matrix(q, dq, ddq) @ values)


@dataclass(frozen=True, slots=True, eq=False)
class TorqueLimit:
    """Penalty on foreseen torque near its limit, a term of the search.

    values: (p,) nominal base parameters as `searched_base_values`; limit: (n,) Nm, infinite where none is known.
    """

    values: FloatArray
    limit: FloatArray

    def __call__(self, samples: Samples) -> tuple[float, FloatArray, FloatArray, FloatArray]:
        """Value, and gradients in Y (S, n, p), q and q̇ (S, n): k Σ max(0, |τ|/τ_max − 0.97)²."""
        ratio = (samples.matrix @ self.values) / self.limit
        beyond = np.maximum(np.abs(ratio) - _ROOM, 0.0)
        by_torque = 2.0 * _STEEPNESS * beyond * np.sign(ratio) / self.limit
        nothing = np.zeros_like(ratio)
        value = _STEEPNESS * float(np.sum(beyond**2))
        return value, by_torque[..., None] * self.values, nothing, nothing
