"""A hose or cable that pulls the joint towards a rest position."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.effects.base import Estimate, Parameter, Place, ShapeParameter
from identification.mismatch.effects.describe import deviation, joint_name, linear, shaped, size_of
from identification.mismatch.effects.own_joint import OwnJointEffect
from identification.mismatch.motion import Motion

FORM = {"hardening": "1/rad²", "softest_at": "rad"}


class CableSpring(OwnJointEffect):
    """k (q − q₀) as the two columns q and 1, τ = k q + b with b = −k q₀. The constant alone is a torque offset.

    A hose that is drawn tight hardens: k (q + κ (q − r)³ − q₀) with κ ≥ 0, r where it is softest; κ = 0 unless another
    one explains clearly more.
    Usual: 0.1 to 2 Nm/rad with an external hose. Looks like: torque_offset, position_dependent_torque,
    torque_sensor_gain, joint_elasticity. Source: first-order law of an elastic dress pack; Madsen et al., collaborative
    robots, 2020.
    """

    name = "cable_spring"
    units = ("Nm/rad", "Nm")
    one_sided = True
    separating_experiment = "Take the hose off, or repeat the same motion about another centre."

    def shape_parameters(self, motion: Motion, place: Place) -> tuple[ShapeParameter, ...]:
        """The hardening κ, too small for a stop that is felt at the end of the range only, and its centre r."""
        return (
            ShapeParameter("hardening", "1/rad²", (0.0,), 0.0, 0.5, logarithmic=False, textbook=0.0),
            ShapeParameter("softest_at", "rad", (0.0,), -1.5, 1.5, logarithmic=False, textbook=0.0),
        )

    def own_torque(self, motion: Motion, joint: int, shape: Mapping[str, float]) -> FloatArray:
        """Columns q, with what it hardens by, and 1."""
        position = motion.position[:, joint]
        stretch = position + shape.get("hardening", 0.0) * (position - shape.get("softest_at", 0.0)) ** 3
        return np.column_stack([stretch, np.ones(motion.samples)])

    def parameters(self, estimate: Estimate) -> tuple[Parameter, ...]:
        """Stiffness k and rest position q₀ = −b/k (std by first order; nan with a stiffness of zero)."""
        stiffness, constant = (float(value) for value in estimate.coefficients)
        rest, rest_std = math.nan, math.nan
        if stiffness != 0.0:
            rest = -constant / stiffness
            slope = np.array([-rest / stiffness, -1.0 / stiffness])
            rest_std = math.sqrt(max(0.0, float(slope @ estimate.covariance @ slope)))
        return (
            Parameter("stiffness", stiffness, deviation(estimate, 0), "Nm/rad"),
            Parameter("rest_position", rest, rest_std, "rad"),
            linear("constant", estimate, "Nm", index=1),
            *(shaped(name, estimate, unit) for name, unit in FORM.items() if estimate.shape.get("hardening")),
        )

    def sentence(self, estimate: Estimate) -> str:
        """Stiffness and rest position."""
        stiffness, rest, *_ = self.parameters(estimate)
        return (
            f"{joint_name(estimate)} is pulled as by a spring of {size_of(stiffness)} with its rest at "
            f"{math.degrees(rest.value):z.0f}° (cable or hose)."
        )
