"""Controllers of the simulated arm: from the state and the commanded motion to motor torques.

All know the identified rigid-body model with motor inertias and no friction, as in section 4.6 of the paper. Here: the
laws and their gains. Not here: the arm they move (`dynamics`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import pinocchio

from identification.arrays import FloatArray
from identification.errors import ModelFileError


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """time_s: s since the start of the motion. position, velocity: (n,) rad, rad/s (m, m/s)."""

    time_s: float
    position: FloatArray
    velocity: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class SetPoint:
    """The commanded motion at one time: (n,) each, rad, rad/s, rad/s²."""

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray


class Controller(Protocol):
    """What `simulate` asks of a controller; it must not keep a state of its own between runs."""

    def torque(self, model: pinocchio.Model, data: pinocchio.Data, state: State, set_point: SetPoint) -> FloatArray:
        """(n,) motor torque as seen at the joint, Nm. model: rigid body with motor inertias as `armature`."""
        ...

    def sentence(self) -> str:
        """What it is and its gains, for the output."""
        ...


def _critically_damped(bandwidth_hz: float, state: State, set_point: SetPoint) -> FloatArray:
    """(n,) acceleration q̈_r + 2ω(q̇_r − q̇) + ω²(q_r − q)."""
    omega = 2.0 * np.pi * bandwidth_hz
    return np.asarray(
        set_point.acceleration
        + 2.0 * omega * (set_point.velocity - state.velocity)
        + omega**2 * (set_point.position - state.position)
    )


@dataclass(frozen=True, slots=True)
class ComputedTorque:
    """Inverse dynamics with PD: τ = M(q)(q̈_r + 2ω(q̇_r − q̇) + ω²(q_r − q)) + h(q, q̇), friction neglected.

    bandwidth_hz: ω/2π, critically damped. The paper uses this law in Gazebo "to ensure good reference tracking" and
    states no gains; 10 Hz is ours: friction F leaves an error of F / (M ω²).
    """

    bandwidth_hz: float = 10.0

    def torque(self, model: pinocchio.Model, data: pinocchio.Data, state: State, set_point: SetPoint) -> FloatArray:
        """The law above."""
        wanted = _critically_damped(self.bandwidth_hz, state, set_point)
        return np.array(pinocchio.rnea(model, data, state.position, state.velocity, wanted))

    def sentence(self) -> str:
        """What it is and its gains."""
        return f"Inverse dynamics with PD at {self.bandwidth_hz:g} Hz, critically damped, friction neglected."


@dataclass(frozen=True, slots=True)
class PositionLoop:
    """A stiff loop for each joint alone: τ_i = M_ii(q_r)(q̈_r + 2ω(q̇_r − q̇) + ω²(q_r − q)) + g_i(q_r).

    bandwidth_hz: ω/2π, critically damped; 8 Hz by default. It knows gravity and its own inertia, no coupling.
    """

    bandwidth_hz: float = 8.0

    def torque(self, model: pinocchio.Model, data: pinocchio.Data, state: State, set_point: SetPoint) -> FloatArray:
        """The law above."""
        wanted = _critically_damped(self.bandwidth_hz, state, set_point)
        inertia = np.diag(pinocchio.crba(model, data, set_point.position)).copy()
        gravity = pinocchio.computeGeneralizedGravity(model, data, set_point.position)
        return np.asarray(inertia * wanted + gravity, dtype=np.float64)

    def sentence(self) -> str:
        """What it is and its gains."""
        return f"Position loop of each joint alone at {self.bandwidth_hz:g} Hz, critically damped, gravity known."


@dataclass(frozen=True, slots=True)
class JointImpedance:
    """A spring and damper about the set-point, dynamics compensated: τ = K(q_r − q) + D(q̇_r − q̇) + M(q)q̈_r + h(q, q̇).

    stiffness: K of every joint, Nm/rad (N/m); 300 by default. damping_ratio: D = 2ζ√(K M_ii(q)).
    """

    stiffness: float = 300.0
    damping_ratio: float = 0.7

    def torque(self, model: pinocchio.Model, data: pinocchio.Data, state: State, set_point: SetPoint) -> FloatArray:
        """The law above."""
        inertia = np.diag(pinocchio.crba(model, data, state.position)).copy()
        damping = 2.0 * self.damping_ratio * np.sqrt(self.stiffness * inertia)
        forward = pinocchio.rnea(model, data, state.position, state.velocity, set_point.acceleration)
        spring = self.stiffness * (set_point.position - state.position)
        return np.asarray(spring + damping * (set_point.velocity - state.velocity) + forward, dtype=np.float64)

    def sentence(self) -> str:
        """What it is and its gains."""
        return f"Joint impedance, {self.stiffness:g} Nm/rad, damping ratio {self.damping_ratio:g}, dynamics known."


CONTROLLERS = ("computed_torque", "position", "impedance")


def controller_named(name: str, *, bandwidth_hz: float | None = None, stiffness: float | None = None) -> Controller:
    """The controller called "computed_torque", "position" or "impedance", with its default gains unless given."""
    for gain, value in (("bandwidth", bandwidth_hz), ("stiffness", stiffness)):
        if value is not None and not (np.isfinite(value) and value > 0.0):
            raise ModelFileError(f"The controller's {gain} must be positive, not {value:g}.", field=gain)
    if name == "impedance":
        return JointImpedance() if stiffness is None else JointImpedance(stiffness)
    if name in ("computed_torque", "position"):
        kind = ComputedTorque if name == "computed_torque" else PositionLoop
        return kind() if bandwidth_hz is None else kind(bandwidth_hz)
    raise ModelFileError(f"There is no controller '{name}'; known are {', '.join(CONTROLLERS)}.", field="controller")
