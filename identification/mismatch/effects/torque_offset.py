"""A constant torque on one joint: sensor zero, or friction that differs between the directions."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.effects.base import Estimate, Parameter
from identification.mismatch.effects.describe import joint_name, linear, size_of
from identification.mismatch.effects.own_joint import OwnJointEffect
from identification.mismatch.motion import Motion


class TorqueOffset(OwnJointEffect):
    """Constant torque b.

    Coulomb friction F₊ forwards and F₋ backwards is ½(F₊ + F₋) sign(q̇) + ½(F₊ − F₋): asymmetric Coulomb friction is
    this effect and no other, and so is the rest torque of a cable.
    Usual: 0.05 to 2 Nm (0.1 to 1 % of the sensor's full scale). Looks like: cable_spring, asymmetric_viscous_friction,
    position_dependent_torque. Source: Swevers, Verdonck, De Schutter, IEEE Control Systems Magazine 27(5), 2007 (offset
    per joint torque).
    """

    name = "torque_offset"
    units = ("Nm",)
    everywhere = True
    separating_experiment = (
        "Turn the joint in one direction only, then in the other: a sensor offset stays, asymmetric friction changes "
        "sides."
    )

    def own_torque(self, motion: Motion, joint: int, shape: Mapping[str, float]) -> FloatArray:
        """Ones."""
        return np.ones((motion.samples, 1))

    def parameters(self, estimate: Estimate) -> tuple[Parameter, ...]:
        """The offset."""
        return (linear("offset", estimate, "Nm"),)

    def sentence(self, estimate: Estimate) -> str:
        """Size, and that the cause has two readings."""
        (offset,) = self.parameters(estimate)
        return (
            f"{joint_name(estimate)} carries a constant torque of {size_of(offset)}: the zero of its torque sensor is "
            "off, or its friction differs between the two directions (this motion cannot tell which)."
        )
