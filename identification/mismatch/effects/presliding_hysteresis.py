"""Friction that builds up over a small distance after each reversal."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.effects.base import Estimate, Parameter, Place, ShapeParameter
from identification.mismatch.effects.describe import joint_name, linear, shaped, size_of
from identification.mismatch.effects.own_joint import OwnJointEffect, friction_sign
from identification.mismatch.motion import Motion


class PreslidingHysteresis(OwnJointEffect):
    """F (z − sign(q̇)) with Dahl's state dz/dt = q̇ (1 − z sign(q̇))ⁱ/δ: z reaches the Coulomb level over the distance δ.

    A function of the distance since the reversal, not of speed. The exponent i (1 for Dahl's usual form, searched by
    refinement alone) bends the curve; LuGre and generalised Maxwell-slip friction come out as this effect with an
    average δ.
    Usual: δ 1 to 30 mrad, F up to the Coulomb friction, 0.05 to 0.5 Nm. Looks like: stribeck_friction, torque_delay,
    load_dependent_friction. Source: Dahl, AIAA J. 14(12), 1976; Canudas de Wit et al., IEEE Trans. Autom. Control
    40(3), 1995.
    """

    name = "presliding_hysteresis"
    units = ("Nm",)
    one_sided = True
    separating_experiment = (
        "Drive the same path at two speeds: pre-sliding follows the distance since the reversal, Stribeck friction "
        "the speed, a delay the time."
    )

    def shape_parameters(self, motion: Motion, place: Place) -> tuple[ShapeParameter, ...]:
        """The distance δ and Dahl's exponent i."""
        grid = (0.001, 0.002, 0.004, 0.008, 0.015, 0.03)
        return (
            ShapeParameter("distance", "rad", grid, lower=0.0003, upper=0.1),
            ShapeParameter("exponent", "1", (1.0,), lower=0.05, upper=3.0, textbook=1.0),
        )

    def own_torque(self, motion: Motion, joint: int, shape: Mapping[str, float]) -> FloatArray:
        """State minus sign, per Nm of F."""
        state = dahl_state(motion, joint, shape["distance"], shape["exponent"])
        return (state - friction_sign(motion, joint))[:, None]

    def parameters(self, estimate: Estimate) -> tuple[Parameter, ...]:
        """Friction level F, distance δ, exponent."""
        return (
            linear("friction", estimate, "Nm"),
            shaped("distance", estimate, "mrad", scale=1000.0),
            shaped("exponent", estimate, "1"),
        )

    def sentence(self, estimate: Estimate) -> str:
        """How much friction builds up over what distance."""
        friction, distance, _ = self.parameters(estimate)
        return (
            f"{joint_name(estimate)}'s friction does not jump at a reversal: {size_of(friction)} of it build up over "
            f"about {size_of(distance)} of travel (pre-sliding hysteresis)."
        )


def dahl_state(motion: Motion, joint: int, distance: float, exponent: float = 1.0) -> FloatArray:
    """Dahl's state z along the motion, (S,), in [−1, 1].

    Between two reversals the equation is solved exactly, x the distance since the reversal: z = s + (z₀ − s) exp(−x/δ)
    for the exponent 1, else |z − s|^(1 − i) = |z₀ − s|^(1 − i) − (1 − i) x/δ while that is positive. A periodic
    motion is walked through twice, so that the second pass is the steady state; others start at 0.
    """
    position = motion.position[:, joint]
    if motion.periodic:
        position = np.concatenate([position, position, position[:1]])
    step = np.diff(position)
    direction = np.sign(step)
    moving = np.flatnonzero(direction)
    state = np.zeros(position.size)
    if moving.size == 0:
        return state[: motion.samples]
    turns = moving[np.flatnonzero(np.diff(direction[moving])) + 1]
    start = 0.0
    # Rows before the first step stay where they started.
    for first, last in zip([int(moving[0]), *turns], [*turns, position.size - 1], strict=True):
        way = direction[first]
        travel = np.abs(position[first : last + 1] - position[first])
        state[first : last + 1] = way * (1.0 - _gap(abs(way - start), travel / distance, exponent))
        start = float(state[last])
    return state[motion.samples : 2 * motion.samples] if motion.periodic else state


def _gap(start: float, travel: FloatArray, exponent: float) -> FloatArray:
    """Solution of dw/dx = −wⁱ from w(0) = start ≥ 0 at the distances `travel`.

    As a factor on the start: the root of a difference of powers would multiply their rounding by 1/(1 − i).
    """
    power = 1.0 - exponent
    if power == 0.0 or start == 0.0:
        return start * np.exp(-travel)
    spent = np.minimum(power * travel * start**-power, 1.0)
    with np.errstate(divide="ignore"):
        return np.asarray(start * np.exp(np.log1p(-spent) / power))
