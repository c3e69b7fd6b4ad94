"""A torque sensor that also reads the moments that bend the joint."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from identification.mismatch.effects.base import Estimate, Parameter
from identification.mismatch.effects.describe import joint_name, linear, size_of
from identification.mismatch.effects.dynamics import across, rigid_torque
from identification.mismatch.effects.own_joint import OwnJointEffect
from identification.mismatch.motion import Motion

FloatArray = npt.NDArray[np.float64]


class BendingCrosstalk(OwnJointEffect):
    """c₁ M_x + c₂ M_y, the moments across the axis of the wrench between the joint's two links, in the link's frame.

    Columns follow the link parameters of the fit; what these leave undetermined (a mass on the axis, say) shifts the
    moments by little more than a constant.
    """

    name = "bending_crosstalk"
    code = "bend"
    equation = "τ_j = c₁ M_x,j + c₂ M_y,j"
    source = "Lee, Kim, Song, calibration of joint torque sensors with crosstalk compensation, 2010"
    units = ("1", "1")
    plausible = "0.2 to 2 %"
    look_alikes = ("joint_crosstalk", "torque_sensor_gain")
    separating_experiment = "Press on the arm at rest with a known force and lever, so that one moment acts at a time."
    revolute_only = True

    def own_torque(self, motion: Motion, joint: int, shape: Mapping[str, float]) -> FloatArray:
        """The two moments."""
        del shape
        moment = rigid_torque(motion).moment[:, joint]
        return np.asarray(moment @ across(motion.robot.kinematics.axis[joint]).T)

    def parameters(self, estimate: Estimate) -> tuple[Parameter, ...]:
        """Both sensitivities in per cent."""
        return (
            linear("sensitivity_x", estimate, "%", scale=100.0),
            linear("sensitivity_y", estimate, "%", index=1, scale=100.0),
        )

    def sentence(self, estimate: Estimate) -> str:
        """How much of each bending moment is read."""
        x, y = self.parameters(estimate)
        return (
            f"{joint_name(estimate)}'s torque sensor also reads the moments that bend the joint: {size_of(x)} of the "
            f"one about the link's x axis, {size_of(y)} of the one about y (bending crosstalk)."
        )
