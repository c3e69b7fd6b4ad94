"""A torque sensor that also reads the moments that bend the joint."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.effects.base import Estimate, Parameter, Place, ShapeParameter
from identification.mismatch.effects.describe import joint_name, linear, size_of
from identification.mismatch.effects.dynamics import bending_moments
from identification.mismatch.effects.own_joint import OwnJointEffect
from identification.mismatch.motion import Motion


class BendingCrosstalk(OwnJointEffect):
    """c₁ M_x + c₂ M_y, the moments across the axis of the wrench between the joint's two links, in the link's frame.

    Two parameters of the link are hidden from every joint torque but not from these moments: its first moment along
    the joint's axis and its equal inertia across it, which the fit may as well give to the link before. They are
    searched on top of what the fitted parameters have: without them the columns of an iiwa's joint 5 have a cosine of
    0.5 with the truth, with them of 1.
    Usual: 0.2 to 2 %. Looks like: joint_crosstalk, torque_sensor_gain. Source: Lee, Kim, Song, calibration of joint
    torque sensors with crosstalk compensation, 2010.
    """

    name = "bending_crosstalk"
    sees_torque = True
    units = ("1", "1")
    separating_experiment = "Press on the arm at rest with a known force and lever, so that one moment acts at a time."
    revolute_only = True

    def shape_parameters(self, motion: Motion, place: Place) -> tuple[ShapeParameter, ...]:
        """The hidden first moment and the hidden inertia; their range follows the links' largest first moment."""
        first_moments = motion.full_parameters.reshape(motion.n, -1)[:, 1:4]
        largest = max(float(np.abs(first_moments).max()), 1e-3)
        grid = tuple(share * largest for share in (-1.0, -0.5, -0.15, 0.0, 0.15, 0.5, 1.0))
        widest = 0.25 * largest
        return (
            ShapeParameter("hidden_moment", "kg m", grid, -1.5 * largest, 1.5 * largest, logarithmic=False),
            ShapeParameter("hidden_inertia", "kg m²", (0.0,), -widest, widest, logarithmic=False),
        )

    def own_torque(self, motion: Motion, joint: int, shape: Mapping[str, float]) -> FloatArray:
        """The two moments."""
        weights = np.array([1.0, shape["hidden_moment"], shape["hidden_inertia"]])
        return np.asarray(bending_moments(motion)[:, joint] @ weights)

    def parameters(self, estimate: Estimate) -> tuple[Parameter, ...]:
        """Both sensitivities in per cent."""
        return (
            linear("sensitivity_x", estimate, "%", scale=100.0),
            linear("sensitivity_y", estimate, "%", index=1, scale=100.0),
        )

    def certainty(self, estimate: Estimate) -> float:
        """Of both together: one moment may be as good as zero, or not shown by the motion, and the other is clear."""
        std = np.maximum(estimate.std, 1e-300)
        sure, alike = estimate.coefficients / std, estimate.covariance / np.outer(std, std)
        return float(np.sqrt(max(0.0, float(sure @ np.linalg.pinv(alike, hermitian=True) @ sure))))

    def sentence(self, estimate: Estimate) -> str:
        """How much of each bending moment is read."""
        x, y = self.parameters(estimate)
        return (
            f"{joint_name(estimate)}'s torque sensor also reads the moments that bend the joint: {size_of(x)} of the "
            f"one about the link's x axis, {size_of(y)} of the one about y (bending crosstalk)."
        )
