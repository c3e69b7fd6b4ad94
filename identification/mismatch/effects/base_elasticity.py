"""A base on something that yields: a table, a cart, a pedestal."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from identification.mismatch.effects.base import CERTAIN, Columns, Effect, Estimate, Parameter, Place
from identification.mismatch.effects.describe import size_of
from identification.mismatch.effects.dynamics import across, chain_of, rigid_torque
from identification.mismatch.effects.time_domain import time_derivative
from identification.mismatch.motion import Motion

_STEP = 1e-7
"""Compliance, rad/Nm, of the difference that stands for the derivative: some 1e-5 rad of lean, far from rounding."""


class BaseElasticity(Effect):
    """The base leans by θ = −(c₁ n₁, c₂ n₂) about two level axes, n the moment by which the ground holds the base.

    Then gravity is g − θ × g in the base's frame, and the base itself turns with θ̇ and θ̈: what ID changes by, to first
    order in the compliances c. n is the moment of the rigid links about the base's origin. What the order leaves out is
    the square of motion over the resonance of arm and stand: 2 % at 2e4 Nm/rad and motion up to 0.5 Hz.
    Usual: 1e5 to 1e6 Nm/rad on a machine bed, 1e4 to 1e5 on a cart or a table, not the same in both directions. Looks
    like: joint_elasticity of a joint that lifts. Source: Featherstone, Rigid Body Dynamics Algorithms, 2008, ch. 9.
    """

    name = "base_elasticity"
    code = "stand"
    units = ("rad/Nm", "rad/Nm")
    one_sided = 2
    separating_experiment = "Set a level or a dial gauge on the base while the arm reaches out and draws in."

    def places(self, motion: Motion) -> Sequence[Place]:
        """The base, if there is gravity."""
        return (Place(),) if np.any(motion.robot.gravity) else ()

    def columns(self, motion: Motion, place: Place, shape: Mapping[str, float]) -> Columns | None:
        """Torque per unit of compliance about the two axes level with the ground (x and y where gravity is along z)."""
        gravity, rigid, chain = motion.robot.gravity, rigid_torque(motion), chain_of(motion)
        values = np.empty((motion.samples, motion.n, 2))
        for number, axis in enumerate(across(gravity / np.linalg.norm(gravity))):
            lean = -_STEP * (axis @ rigid.base_moment)[:, None] * axis
            rate = time_derivative(motion, lean)
            turns = rate.T, time_derivative(motion, rate).T
            seen = gravity - np.cross(lean, gravity)
            links = chain.forward(motion.velocity, motion.acceleration, seen.T, base_turns=turns)
            values[..., number] = (chain.backward(links).torque - rigid.torque) / _STEP
        return Columns(tuple(range(motion.n)), values) if values.any() else None

    def parameters(self, estimate: Estimate) -> tuple[Parameter, ...]:
        """Stiffness in the direction that yields most (std to first order), and the compliance about each axis."""
        deviations = np.sqrt(np.maximum(np.diag(estimate.covariance), 0.0))
        about = [
            Parameter(name, float(value), float(std), "rad/Nm")
            for name, value, std in zip(("about_x", "about_y"), estimate.coefficients, deviations, strict=True)
        ]
        most = max(about, key=lambda item: item.value)
        return (_stiffness(most), *about)

    def sentence(self, estimate: Estimate) -> str:
        """How stiff what yields is, about which axis."""
        _, *about = self.parameters(estimate)
        seen = {axis: each for axis, each in zip("xy", about, strict=True) if each.value > CERTAIN * each.std}
        sizes = " and ".join(f"{size_of(_stiffness(each))} about its {axis} axis" for axis, each in seen.items())
        stiff = "".join(f", not measurably about its {axis} axis" for axis in "xy" if axis not in seen)
        return (
            "The base leans under the arm's own weight and motion: what it stands on yields, stiffness "
            f"{sizes}{stiff} (base elasticity)."
        )


def _stiffness(compliance: Parameter) -> Parameter:
    if compliance.value == 0.0:
        return Parameter("stiffness", math.inf, math.nan, "Nm/rad")
    return Parameter("stiffness", 1.0 / compliance.value, compliance.std / compliance.value**2, "Nm/rad")
