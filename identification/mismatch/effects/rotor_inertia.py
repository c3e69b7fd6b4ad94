"""The inertia of a joint's own motor, seen where torque is measured on the motor side."""

from __future__ import annotations

from collections.abc import Mapping

from identification.arrays import FloatArray
from identification.mismatch.effects.base import Estimate, Parameter
from identification.mismatch.effects.describe import joint_name, linear, size_of
from identification.mismatch.effects.own_joint import OwnJointEffect
from identification.mismatch.motion import Motion


class RotorInertia(OwnJointEffect):
    """N² J_r q̈ on the own joint. A torque sensor behind the gear, as in the iiwa, does not see it.

    Usual: 0 where torque is measured behind the gear (the iiwa); 0.5 to 4 kg m² seen from the motor. Looks like:
    distal_rotor_reaction, torque_sensor_gain. Source: Khalil, Dombre, Modeling, Identification and Control of Robots,
    2002, section 9.3 (IA_j).
    """

    name = "rotor_inertia"
    units = ("kg m²",)
    one_sided = True
    separating_experiment = "Move joint after joint alone with high acceleration, with the arm folded and stretched."

    def own_torque(self, motion: Motion, joint: int, shape: Mapping[str, float]) -> FloatArray:
        """q̈."""
        return motion.acceleration[:, joint, None]

    def parameters(self, estimate: Estimate) -> tuple[Parameter, ...]:
        """The reflected inertia."""
        return (linear("reflected_inertia", estimate, "kg m²"),)

    def sentence(self, estimate: Estimate) -> str:
        """The inertia, and what it says about the sensor."""
        (inertia,) = self.parameters(estimate)
        return (
            f"{joint_name(estimate)} carries an inertia of {size_of(inertia)} that turns with it and with no other "
            "joint: its own motor's, so this torque is measured on the motor side of the gear."
        )
