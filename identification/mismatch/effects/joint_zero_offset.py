"""A joint whose zero is not where the kinematic model has it."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from identification.mismatch.effects.base import Columns, Effect, Estimate, Parameter, Place, ShapeParameter
from identification.mismatch.effects.describe import joint_name, linear, size
from identification.mismatch.effects.displacement import torque_of_displacement
from identification.mismatch.effects.own_joint import joint_index
from identification.mismatch.motion import Motion

LARGEST_RAD = 0.1
"""Most that an angle is searched to be off."""


class JointZeroOffset(Effect):
    """ID(q + e_j δ) − ID(q): the true angle is q_j + δ.

    Link parameters that turn with the frame take up nearly all of it; of the first and the last joint everything.
    Usual: 0.05 to 0.5°. Looks like: payload, joint_elasticity, base_tilt. Source: Hollerbach, Khalil, Gautier, Model
    Identification, Springer Handbook of Robotics, 2016.
    """

    name = "joint_zero_offset"
    units = ("rad",)
    revolute_only = True
    separating_experiment = "Calibrate the geometry (laser tracker, reference marks); dynamics hardly shows it."

    def shape_parameters(self, motion: Motion, place: Place) -> tuple[ShapeParameter, ...]:
        """The offset again: the torque is not linear in it."""
        return (ShapeParameter("at_offset", "rad", (0.0,), -LARGEST_RAD, LARGEST_RAD, logarithmic=False, tied=True),)

    def columns(self, motion: Motion, place: Place, shape: Mapping[str, float]) -> Columns | None:
        """Torque on all joints per rad, chord up to the offset of the shape.

        None where torque does not depend on this angle (a vertical first axis).
        """
        still = np.ones(motion.samples)
        values = torque_of_displacement(motion, joint_index(place), still, shape.get("at_offset", 0.0))
        # Differences leave rounding where the derivative is zero.
        if abs(values).max() < 1e-6 * max(float(abs(motion.torque).max()), 1e-12):
            return None
        return Columns(tuple(range(motion.n)), values[..., None])

    def parameters(self, estimate: Estimate) -> tuple[Parameter, ...]:
        """The offset δ."""
        return (linear("zero_offset", estimate, "rad"),)

    def sentence(self, estimate: Estimate) -> str:
        """By what angle."""
        (offset,) = self.parameters(estimate)
        angle = size(math.degrees(offset.value), math.degrees(offset.std), "°").replace(" °", "°")
        return f"{joint_name(estimate)}'s zero is off: the true angle is the measured one plus {angle} (zero offset)."
