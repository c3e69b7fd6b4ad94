"""Drag that does not grow in proportion to speed."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.effects.base import Estimate, Parameter, Place, ShapeParameter
from identification.mismatch.effects.describe import joint_name, linear, shaped, size_of
from identification.mismatch.effects.own_joint import OwnJointEffect
from identification.mismatch.motion import Motion


class NonlinearViscousFriction(OwnJointEffect):
    """c |q̇|^a sign(q̇): churning drag (c > 0), or friction that levels off as shear-thinning grease does (c < 0).

    a = 2 unless another one explains clearly more. Coulomb and viscous friction take up 93 to 98 % of it; what is left
    is the curvature over speed.
    Usual: 0.02 to 0.2 Nm at 1 rad/s. Looks like: stribeck_friction, presliding_hysteresis. Source: Bittencourt,
    Gunnarsson, Nonlinear friction of robot joints, J. Dyn. Syst. Meas. Control 134, 2012.
    """

    name = "nonlinear_viscous_friction"
    units = ("Nm",)
    everywhere = True
    separating_experiment = "Drive up to the speed limit: curvature grows there, Stribeck friction does not."

    def shape_parameters(self, motion: Motion, place: Place) -> tuple[ShapeParameter, ...]:
        """The exponent a."""
        return (ShapeParameter("exponent", "1", (2.0,), lower=1.3, upper=4.0, textbook=2.0),)

    def own_torque(self, motion: Motion, joint: int, shape: Mapping[str, float]) -> FloatArray:
        """Power of the speed, with the sign of the velocity."""
        velocity = motion.velocity[:, joint, None]
        return np.asarray(np.sign(velocity) * np.abs(velocity) ** shape["exponent"])

    def parameters(self, estimate: Estimate) -> tuple[Parameter, ...]:
        """Torque at 1 rad/s, and the exponent."""
        return (linear("drag_at_1_rad_per_s", estimate, "Nm"), shaped("exponent", estimate, "1"))

    def sentence(self, estimate: Estimate) -> str:
        """Whether friction bends up or down."""
        drag, exponent = self.parameters(estimate)
        bends = "faster" if drag.value > 0.0 else "slower"
        return (
            f"{joint_name(estimate)}'s friction grows {bends} than in proportion to speed: beside the straight "
            f"line it has {size_of(drag)} at 1 rad/s, with power {exponent.value:.2g} of speed (nonlinear viscous "
            "friction)."
        )
