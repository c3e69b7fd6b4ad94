"""A joint that winds up between the position sensor and the link."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from identification.mismatch.effects.base import Columns, Effect, Estimate, Parameter, Place, ShapeParameter
from identification.mismatch.effects.describe import joint_name, linear, size_of
from identification.mismatch.effects.dynamics import rigid_torque, torque_of_displacement
from identification.mismatch.effects.own_joint import joint_index
from identification.mismatch.motion import Motion


class JointElasticity(Effect):
    """ID(q − τ̂_j/K) − ID(q), with the velocity and the acceleration of the wind-up.

    Only where position is measured before the spring. A coefficient of zero says that the sensor sits at the link.
    The wind-up is that of the rigid links' torque, which is smooth.
    """

    name = "joint_elasticity"
    code = "elastic"
    equation = "τ = ID(q − e_j τ̂_j/K) − ID(q)"
    source = "Spong, J. Dyn. Syst. Meas. Control 109, 1987; Madsen et al., flexible-joint cobots, 2020"
    units = ("rad/Nm",)
    plausible = "K 5000 to 20000 Nm/rad"
    look_alikes = ("cable_spring", "joint_zero_offset", "backlash", "payload")
    separating_experiment = "Repeat with a payload: wind-up moves gravity in proportion to the square of the load."

    def places(self, motion: Motion) -> Sequence[Place]:
        """Every joint."""
        return tuple(Place(joint=joint + 1) for joint in range(motion.n))

    def shape_parameters(self, motion: Motion, place: Place) -> tuple[ShapeParameter, ...]:
        """The compliance again: the torque is not linear in it."""
        del motion, place
        return (ShapeParameter("at_compliance", "rad/Nm", (0.0,), -5e-3, 5e-3, logarithmic=False, tied=True),)

    def columns(self, motion: Motion, place: Place, shape: Mapping[str, float]) -> Columns | None:
        """Torque on all joints per unit of compliance 1/K, chord up to the compliance of the shape."""
        joint = joint_index(place)
        wind_up = -rigid_torque(motion).torque[:, joint]
        values = torque_of_displacement(motion, joint, wind_up, shape.get("at_compliance", 0.0))
        return Columns(tuple(range(motion.n)), values[..., None]) if values.any() else None

    def parameters(self, estimate: Estimate) -> tuple[Parameter, ...]:
        """Stiffness K (std to first order) and the compliance it comes from."""
        compliance = linear("compliance", estimate, "rad/Nm")
        stiffness = Parameter("stiffness", math.inf, math.nan, "Nm/rad")
        if compliance.value != 0.0:
            stiffness = Parameter("stiffness", 1.0 / compliance.value, compliance.std / compliance.value**2, "Nm/rad")
        return (stiffness, compliance)

    def sentence(self, estimate: Estimate) -> str:
        """The stiffness, and what it says about the position sensor."""
        stiffness, _ = self.parameters(estimate)
        return (
            f"{joint_name(estimate)} winds up under load between its position sensor and the link, stiffness "
            f"{size_of(stiffness)}: the measured position is that of the motor (joint elasticity)."
        )
