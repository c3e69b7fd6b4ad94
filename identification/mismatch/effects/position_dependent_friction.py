"""Friction that changes over the turn of the joint."""

from __future__ import annotations

import math
from collections.abc import Mapping

from identification.arrays import FloatArray
from identification.mismatch.effects.base import Estimate, Parameter, Place, ShapeParameter
from identification.mismatch.effects.describe import harmonic, joint_name, size_of
from identification.mismatch.effects.own_joint import OwnJointEffect, friction_sign
from identification.mismatch.effects.second_harmonic import harmonic_share, second_harmonic, waves
from identification.mismatch.motion import Motion


class PositionDependentFriction(OwnJointEffect):
    """(a sin q + b cos q) sign(q̇): a bearing or seal that is tighter on one side.

    It need not be a pure sine: the second harmonic may go along, at most half as large, where it shows.
    Usual: 10 to 50 % of the Coulomb friction, 0.01 to 0.2 Nm. Looks like: load_dependent_friction. Source:
    Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30(7), 1994 (position-dependent friction).
    """

    name = "position_dependent_friction"
    units = ("Nm", "Nm")
    separating_experiment = (
        "Repeat the path with another load, or with the base axis turned: friction that follows the angle stays where "
        "it was."
    )
    revolute_only = True

    def shape_parameters(self, motion: Motion, place: Place) -> tuple[ShapeParameter, ...]:
        """The share of the second harmonic."""
        return second_harmonic()

    def own_torque(self, motion: Motion, joint: int, shape: Mapping[str, float]) -> FloatArray:
        """Sine and cosine of the angle, each times the direction."""
        return waves(motion.position[:, joint], shape) * friction_sign(motion, joint)[:, None]

    def parameters(self, estimate: Estimate) -> tuple[Parameter, ...]:
        """Amplitude, and the angle at which friction is highest."""
        amplitude, phase = harmonic(estimate)
        angle = Parameter("angle_of_maximum", math.pi / 2.0 - phase.value, phase.std, "rad")
        return (amplitude, angle, *harmonic_share(estimate))

    def sentence(self, estimate: Estimate) -> str:
        """By how much, and where it is tightest."""
        amplitude, angle, *_ = self.parameters(estimate)
        return (
            f"{joint_name(estimate)}'s friction changes over its turn by ± {size_of(amplitude)}, highest at "
            f"{math.degrees(angle.value):z.0f}° (position-dependent friction)."
        )
