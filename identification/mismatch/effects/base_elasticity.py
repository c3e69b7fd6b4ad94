"""A base on something that yields: a table, a cart, a pedestal."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.effects.base import CERTAIN, Columns, Effect, Estimate, Parameter, Place, ShapeParameter
from identification.mismatch.effects.describe import linear, shaped, size_of
from identification.mismatch.effects.dynamics import across, chain_of, rigid_torque
from identification.mismatch.effects.time_domain import (
    ComplexArray,
    filtered,
    frequencies_of,
    lines_of,
    time_derivative,
)
from identification.mismatch.motion import Motion
from identification.remembered import once_per_object

_STEP = 1e-6
"""Angular velocity of the base, rad/s, of the difference that stands for the derivative: far from rounding."""
_LEFT_OUT = 1e-6
"""Share of the power of the moment on the base, its fastest part, that the lean does not follow."""


class BaseElasticity(Effect):
    """The base leans by θ = −C n about the two level axes, n the moment by which the ground holds it about a pivot.

    C = [[c₁, c₃], [c₃, c₂]]: a stand need not be as soft in both directions, nor stand along the base's axes. Gravity
    is then g − θ × g in the base's frame, the base turns with θ̇ and θ̈, and its origin, pivot_depth above the pivot,
    sways with θ̈: what ID changes by, to first order in C. What the order leaves out is the square of motion over the
    resonance of arm and stand: 2 % at 2e4 Nm/rad and motion up to 0.5 Hz.
    Usual: 1e5 to 1e6 Nm/rad on a machine bed, 1e4 to 1e5 on a cart or a table. Looks like: joint_elasticity of a joint
    that lifts. Source: Featherstone, Rigid Body Dynamics Algorithms, 2008, ch. 9.
    """

    name = "base_elasticity"
    units = ("rad/Nm", "rad/Nm", "rad/Nm")
    one_sided = True
    separating_experiment = "Set a level or a dial gauge on the base while the arm reaches out and draws in."

    def places(self, motion: Motion) -> Sequence[Place]:
        """The base, if there is gravity and an arm that turns."""
        return (Place(),) if np.any(motion.robot.gravity) and any(motion.robot.kinematics.revolute) else ()

    def shape_parameters(self, motion: Motion, place: Place) -> tuple[ShapeParameter, ...]:
        """How far below the origin of the base's frame the pivot lies: at the shoulder, the plate or the floor."""
        return (ShapeParameter("pivot_depth", "m", (0.0, 0.4, 0.9), -0.5, 1.5, logarithmic=False),)

    def columns(self, motion: Motion, place: Place, shape: Mapping[str, float]) -> Columns | None:
        """Torque per unit of c₁, c₂ and c₃; axes x and y where gravity is along z."""
        values = np.tensordot(shape["pivot_depth"] ** np.arange(3), _by_power_of_depth(motion), axes=1)
        return Columns(tuple(range(motion.n)), values) if values.any() else None

    def is_impossible(self, coefficients: FloatArray, std: FloatArray | None = None) -> bool:
        """Whether the stand would drive the lean in some direction more than it yields in any."""
        stiffest, softest = np.linalg.eigvalsh(_matrix(coefficients))
        return bool(-stiffest >= softest)

    def parameters(self, estimate: Estimate) -> tuple[Parameter, ...]:
        """Stiffness where the stand is softest (std to first order), the compliances, and where the pivot lies."""
        names = ("about_x", "about_y", "about_xy")
        about = [linear(name, estimate, "rad/Nm", index=index) for index, name in enumerate(names)]
        return (_stiffness(estimate, 1), *about, shaped("pivot_depth", estimate, "m"))

    def sentence(self, estimate: Estimate) -> str:
        """How stiff what yields is, about which axis."""
        soft, stiff = _stiffness(estimate, 1), _stiffness(estimate, 0)
        vector = _axis(estimate, 1)
        angle = math.degrees(math.atan2(vector[1], vector[0])) % 180.0
        other = size_of(stiff) if stiff.value > 0.0 and CERTAIN < stiff.certainty < math.inf else "no yielding seen"
        return (
            "The base leans under the arm's own weight and motion: what it stands on yields, stiffness "
            f"{size_of(soft)} about the axis at {angle:.0f}° from the base's first level axis (x of an upright base), "
            f"where it is softest, across it {other} (base elasticity)."
        )


@once_per_object
def _by_power_of_depth(motion: Motion) -> FloatArray:
    """The columns' parts that go with the pivot's depth to the power of 0, 1 and 2, (3, S, n, 3)."""
    gravity, rigid = motion.robot.gravity, rigid_torque(motion)
    upward = -gravity / np.linalg.norm(gravity)
    level = across(-upward)
    first, second = level
    matrices = [np.outer(one, other) for one, other in ((first, first), (second, second), (first, second))]
    matrices[2] = matrices[2] + matrices[2].T
    moments = rigid.base_moment.T, np.cross(upward, rigid.base_force.T)
    by_gravity, by_rate, by_growth = _by_the_base(motion, level)
    result = np.zeros((3, motion.samples, motion.n, 3))
    for power, moment in enumerate(moments):
        slow = filtered(motion, moment, _slow_lines(motion))
        for column, matrix in enumerate(matrices):
            lean = -slow @ matrix
            rate = time_derivative(motion, lean)
            growth = time_derivative(motion, rate)
            parts = (by_gravity, -np.cross(lean, gravity)), (by_rate, rate), (by_growth, growth)
            result[power, ..., column] += sum(_along(units, level, vectors) for units, vectors in parts)
            result[power + 1, ..., column] += _along(by_gravity, level, -np.cross(growth, upward))
    return result


def _by_the_base(motion: Motion, level: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Torques (2, S, n) per unit of gravity, and of the base's angular velocity and acceleration, along two level axes.

    level: (2, 3) these axes. The lean, its rate and growth and what it does to gravity are level, and act linearly.
    """
    gravity, chain, still = motion.robot.gravity, chain_of(motion), np.zeros_like(motion.velocity)
    none, axes = np.zeros(3), [np.tile(axis[:, None], motion.samples) for axis in level]
    at_rest = np.zeros_like(axes[0])
    by_gravity = [chain.forward(still, still, axis) for axis in level]
    by_growth = [chain.forward(still, still, none, base_turns=(at_rest, axis)) for axis in axes]
    turning = [
        chain.forward(motion.velocity, motion.acceleration, gravity, base_turns=(_STEP * axis, at_rest))
        for axis in axes
    ]
    weighed, turned, grown = (
        np.array([chain.backward(links).torque for links in states]) for states in (by_gravity, turning, by_growth)
    )
    return weighed, (turned - rigid_torque(motion).torque) / _STEP, grown


def _along(units: FloatArray, level: FloatArray, vectors: FloatArray) -> FloatArray:
    """(S, n) of torques (2, S, n) per unit along level axes (2, 3), for level vectors (S, 3)."""
    return np.asarray(np.einsum("ksn,sk->sn", units, vectors @ level.T))


@once_per_object
def _slow_lines(motion: Motion) -> ComplexArray:
    """A low pass (L,) over the lines of the moment on the base, all but a millionth of its power.

    What the position's noise and the jolts of friction have above them lies beyond the stand's resonance, where a lean
    does not follow from the moment; two derivatives would make most of the torque of it.
    """
    power = (np.abs(lines_of(motion, rigid_torque(motion).base_moment.T)[1:]) ** 2).sum(axis=1)
    faster = np.cumsum(power[::-1])[::-1]
    frequency = np.abs(frequencies_of(motion))
    highest = frequency[1 + int(np.flatnonzero(faster >= _LEFT_OUT * faster[0])[-1])]
    return np.asarray(1.0 / (1.0 + (frequency / (2.0 * highest)) ** 8) + 0.0j)


def _matrix(coefficients: FloatArray) -> FloatArray:
    return np.array([[coefficients[0], coefficients[2]], [coefficients[2], coefficients[1]]])


def _axis(estimate: Estimate, number: int) -> FloatArray:
    """Direction (2,) of the stiffest (0) or the softest (1) axis in the base's x and y."""
    return np.asarray(np.linalg.eigh(_matrix(estimate.coefficients))[1][:, number])


def _stiffness(estimate: Estimate, number: int) -> Parameter:
    """Along `_axis`, to first order: the compliance is v_x² c₁ + v_y² c₂ + 2 v_x v_y c₃."""
    x, y = _axis(estimate, number)
    weights = np.array([x * x, y * y, 2.0 * x * y])
    compliance = float(weights @ estimate.coefficients)
    std = math.sqrt(max(0.0, float(weights @ estimate.covariance @ weights)))
    if compliance == 0.0:
        return Parameter("stiffness", math.inf, math.nan, "Nm/rad")
    return Parameter("stiffness", 1.0 / compliance, std / compliance**2, "Nm/rad")
