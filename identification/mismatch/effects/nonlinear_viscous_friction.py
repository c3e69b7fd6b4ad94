"""Drag that does not grow in proportion to speed."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from identification.mismatch.effects.base import Estimate, Parameter
from identification.mismatch.effects.describe import joint_name, linear, size_of
from identification.mismatch.effects.own_joint import OwnJointEffect
from identification.mismatch.motion import Motion

FloatArray = npt.NDArray[np.float64]


class NonlinearViscousFriction(OwnJointEffect):
    """c q̇ |q̇|: churning drag (c > 0), or friction that levels off with speed as shear-thinning grease does (c < 0).

    Coulomb and viscous friction take up 93 to 98 % of it; what is left is the curvature over speed.
    """

    name = "nonlinear_viscous_friction"
    code = "quadv"
    equation = "τ_j = c q̇_j |q̇_j|"
    source = "Bittencourt, Gunnarsson, Nonlinear friction of robot joints, J. Dyn. Syst. Meas. Control 134, 2012"
    units = ("Nm s²/rad²",)
    plausible = "0.02 to 0.2 Nm s²/rad²"
    look_alikes = ("stribeck_friction", "presliding_hysteresis")
    separating_experiment = "Drive up to the speed limit: curvature grows there, Stribeck friction does not."

    def own_torque(self, motion: Motion, joint: int, shape: Mapping[str, float]) -> FloatArray:
        """q̇ |q̇|."""
        del shape
        velocity = motion.velocity[:, joint, None]
        return velocity * np.abs(velocity)

    def parameters(self, estimate: Estimate) -> tuple[Parameter, ...]:
        """The quadratic coefficient."""
        return (linear("quadratic_drag", estimate, "Nm s²/rad²"),)

    def sentence(self, estimate: Estimate) -> str:
        """Whether friction bends up or down."""
        (drag,) = self.parameters(estimate)
        bends = "faster" if drag.value > 0.0 else "slower"
        return (
            f"{joint_name(estimate)}'s friction grows {bends} than in proportion to speed, by {size_of(drag)} "
            "(nonlinear viscous friction)."
        )
