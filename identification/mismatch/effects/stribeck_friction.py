"""Extra friction near standstill that fades with speed."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.effects.base import Estimate, Parameter, Place, ShapeParameter
from identification.mismatch.effects.describe import joint_name, linear, shaped, size_of
from identification.mismatch.effects.own_joint import OwnJointEffect, friction_sign
from identification.mismatch.motion import Motion


class StribeckFriction(OwnJointEffect):
    """A · exp(−(|q̇|/v_s)^a) · sign(q̇): friction above the Coulomb level while the joint creeps.

    Seen on the own joint where |q̇| < 2 v_s, in both directions alike. a = 2 unless another one explains clearly more.
    On the shipped excitation a = 1 and 0.5 have cosines of 0.98 and 0.94 with their nearest Gaussian once the nominal
    friction is fitted again, and no exponent comes closer than 0.7 to a pre-sliding loop.
    Usual: A 0.05 to 0.4 Nm beside the link, v_s 0.02 to 0.1 rad/s. Looks like: presliding_hysteresis,
    nonlinear_viscous_friction. Source: Armstrong-Hélouvry, Control of Machines with Friction, Kluwer 1991; Bittencourt
    et al., IROS 2010.
    """

    name = "stribeck_friction"
    units = ("Nm",)
    one_sided = True
    everywhere = True
    separating_experiment = (
        "Drive the same path at two speeds: Stribeck friction follows the speed, pre-sliding follows the distance "
        "since the reversal. Slow constant-speed sweeps from 0.01 to 0.3 rad/s show the curve itself."
    )

    def shape_parameters(self, motion: Motion, place: Place) -> tuple[ShapeParameter, ...]:
        """The Stribeck velocity v_s and the exponent a.

        A smaller v_s would live in the samples around a reversal, which do not count, and seize on what they leave.
        """
        grid = (0.01, 0.02, 0.035, 0.06, 0.1, 0.17, 0.3)
        return (
            ShapeParameter("stribeck_velocity", "rad/s", grid, lower=0.008, upper=0.5),
            ShapeParameter("exponent", "1", (2.0,), lower=0.4, upper=4.0, textbook=2.0),
        )

    def own_torque(self, motion: Motion, joint: int, shape: Mapping[str, float]) -> FloatArray:
        """Per Nm of A."""
        speed = np.abs(motion.velocity[:, joint]) / shape["stribeck_velocity"]
        return (np.exp(-(speed ** shape["exponent"])) * friction_sign(motion, joint))[:, None]

    def parameters(self, estimate: Estimate) -> tuple[Parameter, ...]:
        """The amplitude A, the Stribeck velocity, the exponent."""
        return (
            linear("amplitude", estimate, "Nm"),
            shaped("stribeck_velocity", estimate, "rad/s"),
            shaped("exponent", estimate, "1"),
        )

    def sentence(self, estimate: Estimate) -> str:
        """How much more, and up to what speed."""
        amplitude, velocity, _ = self.parameters(estimate)
        more = "more" if amplitude.value > 0.0 else "less"
        return (
            f"{joint_name(estimate)} has {more} friction near standstill than at speed, by {size_of(amplitude)}, "
            f"fading over {size_of(velocity)} (Stribeck friction)."
        )
