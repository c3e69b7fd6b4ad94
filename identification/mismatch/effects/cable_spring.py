"""A hose or cable that pulls the joint towards a rest position."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from identification.mismatch.effects.base import Estimate, Parameter
from identification.mismatch.effects.describe import deviation, joint_name, linear, size_of
from identification.mismatch.effects.own_joint import OwnJointEffect
from identification.mismatch.motion import Motion

FloatArray = npt.NDArray[np.float64]


class CableSpring(OwnJointEffect):
    """k (q − q₀) as the two columns q and 1, τ = k q + b with b = −k q₀. The constant alone is a torque offset."""

    name = "cable_spring"
    code = "cable"
    equation = "τ_j = k (q_j − q₀)"
    source = "first-order law of an elastic dress pack; Madsen et al., collaborative robots, 2020"
    units = ("Nm/rad", "Nm")
    plausible = "0.1 to 2 Nm/rad with an external hose"
    look_alikes = ("torque_offset", "position_dependent_torque", "torque_sensor_gain", "joint_elasticity")
    separating_experiment = "Take the hose off, or repeat the same motion about another centre."

    def own_torque(self, motion: Motion, joint: int, shape: Mapping[str, float]) -> FloatArray:
        """Columns q and 1."""
        del shape
        return np.column_stack([motion.position[:, joint], np.ones(motion.samples)])

    def parameters(self, estimate: Estimate) -> tuple[Parameter, ...]:
        """Stiffness k and rest position q₀ = −b/k (std by first order; nan with a stiffness of zero)."""
        stiffness, constant = (float(value) for value in estimate.coefficients)
        rest, rest_std = math.nan, math.nan
        if stiffness != 0.0:
            rest = -constant / stiffness
            slope = np.array([-rest / stiffness, -1.0 / stiffness])
            rest_std = math.sqrt(max(0.0, float(slope @ estimate.covariance @ slope)))
        return (
            Parameter("stiffness", stiffness, deviation(estimate, 0), "Nm/rad"),
            Parameter("rest_position", rest, rest_std, "rad"),
            linear("constant", estimate, "Nm", index=1),
        )

    def sentence(self, estimate: Estimate) -> str:
        """Stiffness and rest position."""
        stiffness, rest, _ = self.parameters(estimate)
        return (
            f"{joint_name(estimate)} is pulled as by a spring of {size_of(stiffness)} with its rest at "
            f"{math.degrees(rest.value):.0f}° (cable or hose)."
        )
