"""Torque columns of missing physics along a motion with their derivatives, for the search of a motion that shows them.

Here: the laws of the effect library that hold sample by sample, smoothed where they have sign(q̇), and what size of each
is plausible. Not here: the library itself (`identification.mismatch.effects`), with which a test compares every law
here and by which designs are reported.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from identification.arrays import FloatArray
from identification.excitation.objective import Samples
from identification.robots import Kinematics

STRIBECK_VELOCITY = 0.06
"""Rad/s; this and the order are the middle of the library's grids, at which it states what a motion can show."""
ORDER = 4.0


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    """One joint along S samples: position, velocity, smoothed sign s and ds/dq̇, torque; each (S,)."""

    q: FloatArray
    dq: FloatArray
    sign: FloatArray
    slope: FloatArray
    torque: FloatArray


_Partial = FloatArray | float
_Column = tuple[_Partial, _Partial, _Partial, _Partial]
"""A column and its derivatives by q, q̇ and τ, sample by sample."""


def _stribeck(x: _State) -> tuple[_Column, ...]:
    fading = np.exp(-((x.dq / STRIBECK_VELOCITY) ** 2))
    by_velocity = fading * (x.slope - 2.0 * x.dq / STRIBECK_VELOCITY**2 * x.sign)
    return ((fading * x.sign, 0.0, by_velocity, 0.0),)


def _position_dependent_friction(x: _State) -> tuple[_Column, ...]:
    sine, cosine = np.sin(x.q), np.cos(x.q)
    return (
        (sine * x.sign, cosine * x.sign, sine * x.slope, 0.0),
        (cosine * x.sign, -sine * x.sign, cosine * x.slope, 0.0),
    )


def _position_dependent_torque(x: _State) -> tuple[_Column, ...]:
    sine, cosine = np.sin(ORDER * x.q), np.cos(ORDER * x.q)
    return (sine, ORDER * cosine, 0.0, 0.0), (cosine, -ORDER * sine, 0.0, 0.0)


_LAWS: dict[str, Callable[[_State], tuple[_Column, ...]]] = {
    "torque_offset": lambda _: ((1.0, 0.0, 0.0, 0.0),),
    "stribeck_friction": _stribeck,
    "torque_sensor_gain": lambda x: ((x.torque, 0.0, 0.0, 1.0),),
    "joint_crosstalk": lambda x: ((x.torque, 0.0, 0.0, 1.0),),
    "asymmetric_viscous_friction": lambda x: ((x.dq * x.sign, 0.0, x.sign + x.dq * x.slope, 0.0),),
    "nonlinear_viscous_friction": lambda x: ((np.abs(x.dq) * x.dq, 0.0, 2.0 * np.abs(x.dq), 0.0),),
    "load_dependent_friction": lambda x: (
        (np.abs(x.torque) * x.sign, 0.0, np.abs(x.torque) * x.slope, np.sign(x.torque) * x.sign),
    ),
    "position_dependent_friction": _position_dependent_friction,
    "position_dependent_torque": _position_dependent_torque,
    "cable_spring": lambda x: ((x.q, 1.0, 0.0, 0.0),),
}

PLAUSIBLE_SIZES = {
    "torque_offset": 0.1,
    "stribeck_friction": 0.1,
    "torque_sensor_gain": 0.01,
    "joint_crosstalk": 0.005,
    "asymmetric_viscous_friction": 0.05,
    "nonlinear_viscous_friction": 0.05,
    "load_dependent_friction": 0.01,
    "position_dependent_friction": 0.05,
    "position_dependent_torque": 0.1,
    "cable_spring": 0.3,
}
"""Size of each effect that a design shall show, in the unit of its coefficients (Nm, Nm s/rad, Nm/rad or 1): near the
lower end of what the library calls plausible."""


@dataclass(frozen=True, slots=True)
class Where:
    """One column: its effect, the joint whose torque it touches and the joint whose torque it reads, from 0."""

    effect: str
    joint: int
    source: int


def columns_of(kinematics: Kinematics) -> tuple[Where, ...]:
    """All columns of a robot: both of a pair follow each other. Laws of an angle are left out at prismatic joints."""
    found = []
    for effect in _LAWS:
        if effect == "joint_crosstalk":
            pairs = [(joint, int(kinematics.parent[joint])) for joint in range(kinematics.n)]
            found += [Where(effect, a, b) for pair in pairs if pair[1] >= 0 for a, b in (pair, pair[::-1])]
            continue
        of_angle = effect.startswith("position_dependent")
        joints = [joint for joint in range(kinematics.n) if kinematics.revolute[joint] or not of_angle]
        found += [Where(effect, joint, joint) for joint in joints for _ in range(1 + int(of_angle))]
    return tuple(found)


def evaluate_columns(where: tuple[Where, ...], samples: Samples, torque: FloatArray) -> FloatArray:
    """Values and derivatives by q, q̇ (of `joint`) and τ (of `source`) per plausible size, (4, S, M). torque: (S, n)."""
    out = np.zeros((4, len(torque), len(where)))
    slope = (1.0 - samples.sign**2) / samples.sign_width_rad_s
    for index, place in enumerate(where):
        if index and where[index - 1] == place:
            continue
        j = place.joint
        state = _State(
            samples.position[:, j], samples.velocity[:, j], samples.sign[:, j], slope[:, j], torque[:, place.source]
        )
        for offset, column in enumerate(_LAWS[place.effect](state)):
            for kind, value in enumerate(column):
                out[kind, :, index + offset] = PLAUSIBLE_SIZES[place.effect] * value
    return out
