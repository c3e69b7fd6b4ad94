"""A joint that winds up between the position sensor and the link."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.effects.base import Columns, Effect, Estimate, Parameter, Place, ShapeParameter
from identification.mismatch.effects.describe import joint_name, linear, size_of
from identification.mismatch.effects.displacement import torque_behind_spring
from identification.mismatch.effects.dynamics import rigid_torque
from identification.mismatch.effects.own_joint import joint_index
from identification.mismatch.motion import Motion

LINEAR_NM = 1e5
"""Hardening torque of a spring that shows none, the textbook's: the same for all motions."""


class JointElasticity(Effect):
    """ID(link) − ID(q) with the link at q − φ(τ_j(link)), with the velocity and the acceleration of the wind-up φ.

    Only where position is measured before the spring. A coefficient of zero says that the sensor sits at the link.
    The spring carries the torque of the link's own motion (`torque_behind_spring`), not that of the motor's: at a sixth
    of their resonance the two differ by 3 %. Friction acts before the spring (friction_behind 0) or behind it (1), as
    the bearings of a link do; then it winds the spring too, and turns round with the link. Harmonic gears harden:
    τ = K φ + k₃ φ³, K their stiffness without load, k₃ = K³/τ_h². Base parameters take up most of what a linear spring
    does, but not of what a hardening one leaves beside it.
    Usual: K 5000 to 20000 Nm/rad. Looks like: cable_spring, joint_zero_offset, backlash, payload, base_elasticity.
    Source: Spong, J. Dyn. Syst. Meas. Control 109, 1987; Taghirad, Bélanger, J. Dyn. Syst. Meas. Control 120, 1998.
    """

    name = "joint_elasticity"
    units = ("rad/Nm",)
    one_sided = True
    separating_experiment = "Repeat with a payload: wind-up moves gravity in proportion to the square of the load."

    def shape_parameters(self, motion: Motion, place: Place) -> tuple[ShapeParameter, ...]:
        """The compliance again (the torque is not linear in it), where the spring is hard, where friction acts."""
        largest = max(float(np.abs(rigid_torque(motion).torque[:, joint_index(place)]).max()), 1e-9)
        return (
            ShapeParameter("at_compliance", "rad/Nm", (1e-4,), -5e-3, 5e-3, logarithmic=False, tied=True),
            ShapeParameter("friction_behind", "", (0.0,), 0.0, 1.0, integer=True, logarithmic=False, textbook=0.0),
            ShapeParameter(
                "hardening_torque", "Nm", (largest, LINEAR_NM), 0.2 * largest, LINEAR_NM, textbook=LINEAR_NM
            ),
        )

    def columns(self, motion: Motion, place: Place, shape: Mapping[str, float]) -> Columns | None:
        """Torque on all joints per unit of compliance 1/K, chord up to the compliance of the shape."""
        joint, hardening = joint_index(place), shape.get("hardening_torque", math.inf)

        def wind_up(load: FloatArray) -> FloatArray:
            return load if math.isinf(hardening) else hardening * _cubic_spring(load / hardening)

        compliance, friction = shape.get("at_compliance", 0.0), shape.get("friction_behind", 0.0) > 0.5
        values = torque_behind_spring(motion, joint, wind_up, compliance, carries_friction=friction)
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


def _cubic_spring(load: FloatArray) -> FloatArray:
    """The one real u of u + u³ = load."""
    return np.asarray(2.0 / math.sqrt(3.0) * np.sinh(np.arcsinh(1.5 * math.sqrt(3.0) * load) / 3.0))
