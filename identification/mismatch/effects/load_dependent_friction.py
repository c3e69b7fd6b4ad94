"""Friction that grows with the torque the joint carries."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.effects.base import Estimate, Parameter, Place, ShapeParameter
from identification.mismatch.effects.describe import joint_name, linear, shaped, size_of
from identification.mismatch.effects.own_joint import OwnJointEffect, friction_sign
from identification.mismatch.motion import Motion

REFERENCE_NM = 10.0
"""Load τ₀ at which the friction per load is given where it is not in proportion."""


class LoadDependentFriction(OwnJointEffect):
    """c |τ̂_j| sign(q̇_j): tooth and bearing friction in proportion to the load.

    In another power p of it, c τ₀ (|τ̂_j|/τ₀)ᵖ sign(q̇_j), where that explains clearly more.
    Usual: 0.2 to 3 % of the load. Looks like: position_dependent_friction, stribeck_friction, presliding_hysteresis.
    Source: Hamon, Gautier, Garrec, Janot, AIM 2010 (hal-00583169).
    """

    name = "load_dependent_friction"
    sees_torque = True
    units = ("1",)
    one_sided = True
    separating_experiment = "Drive the same path with and without a known payload: only this friction grows with it."

    def shape_parameters(self, motion: Motion, place: Place) -> tuple[ShapeParameter, ...]:
        """The power p."""
        return (ShapeParameter("power", "1", (1.0,), 0.5, 2.0, textbook=1.0),)

    def own_torque(self, motion: Motion, joint: int, shape: Mapping[str, float]) -> FloatArray:
        """Load times direction."""
        load = REFERENCE_NM * (np.abs(motion.torque[:, joint]) / REFERENCE_NM) ** shape.get("power", 1.0)
        return (load * friction_sign(motion, joint))[:, None]

    def parameters(self, estimate: Estimate) -> tuple[Parameter, ...]:
        """Friction per load in per cent."""
        power = (shaped("power", estimate, "1"),) if estimate.shape.get("power", 1.0) != 1.0 else ()
        return (linear("friction_per_load", estimate, "%", scale=100.0), *power)

    def sentence(self, estimate: Estimate) -> str:
        """Friction as a share of the load; where it is not in proportion, at which load, and with what power."""
        share, *power = self.parameters(estimate)
        bent = "".join(f" at {REFERENCE_NM:g} Nm, with power {each.value:.2g} of the load" for each in power)
        return (
            f"{joint_name(estimate)}'s friction changes with the torque it carries, by {size_of(share)} of the load"
            f"{bent} (load-dependent friction)."
        )
