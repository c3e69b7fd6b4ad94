"""Viscous friction that differs between the two directions."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.effects.base import Estimate, Parameter
from identification.mismatch.effects.describe import joint_name, linear, size_of
from identification.mismatch.effects.own_joint import OwnJointEffect
from identification.mismatch.motion import Motion


class AsymmetricViscousFriction(OwnJointEffect):
    """b |q̇|: with viscous coefficients F₊ and F₋ of the two directions, b = ½(F₊ − F₋). Even in the velocity.

    Usual: 0.02 to 0.2 Nm s/rad. Looks like: torque_offset, cable_spring. Source: Armstrong-Hélouvry, Dupont, Canudas de
    Wit, Automatica 30(7), 1994 (direction-dependent friction).
    """

    name = "asymmetric_viscous_friction"
    units = ("Nm s/rad",)
    everywhere = True
    separating_experiment = "Use a wider range of speeds in both directions; an offset does not grow with speed."

    def own_torque(self, motion: Motion, joint: int, shape: Mapping[str, float]) -> FloatArray:
        """|q̇|."""
        return np.abs(motion.velocity[:, joint, None])

    def parameters(self, estimate: Estimate) -> tuple[Parameter, ...]:
        """Half the difference of the two viscous coefficients."""
        return (linear("half_difference", estimate, "Nm s/rad"),)

    def sentence(self, estimate: Estimate) -> str:
        """Which direction brakes more."""
        (half,) = self.parameters(estimate)
        direction = "positive" if half.value > 0.0 else "negative"
        return (
            f"{joint_name(estimate)} brakes more in the {direction} direction: its viscous coefficients of the two "
            f"directions differ from their mean by {size_of(half)} (asymmetric viscous friction)."
        )
