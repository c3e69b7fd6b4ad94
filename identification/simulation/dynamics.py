"""One time step of an arm with joint friction: Pinocchio's forward dynamics, dry friction that really sticks.

While every joint slides, friction is smooth and a step is a classical Runge-Kutta step. When a joint starts, stops or
turns, the step is implicit: velocity and friction forces are found together such that each force is F_s sign(q̇) where
the joint moves and anything in ±F_s where it rests (a box-constrained complementarity problem, solved by projected
Gauss-Seidel). No smoothing width has to be chosen, and a joint at rest stays there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pinocchio

from identification.arrays import FloatArray
from identification.simulation.controllers import State

ExtraTorque = Callable[[State], FloatArray]
"""(n,) Nm that an effect adds to the right side of eq. (1), as its column in a fit would: friction-like is positive."""

_MOST_SWEEPS = 500
_SETTLED = 1e-13


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """acceleration, resistance: (n,) at the start of the step, or their means over it where a joint stuck or turned.

    resistance: torque that friction and effects take, Nm. state: at the end of the step.
    """

    acceleration: FloatArray
    resistance: FloatArray
    state: State


@dataclass(frozen=True, slots=True, eq=False)
class ArmDynamics:
    """M(q) q̈ + h(q, q̇) + F_v q̇ + F_s sign(q̇) + extra = τ, eq. (1) with the motors' inertias in M.

    model: rigid body with motor inertias as `armature`. viscous, coulomb: (n,). extra: of an effect, None for none.
    """

    model: pinocchio.Model
    data: pinocchio.Data
    viscous: FloatArray
    coulomb: FloatArray
    extra: ExtraTorque | None

    def step(self, state: State, torque: FloatArray, step_s: float) -> Step:
        """The arm after step_s with the motor torque held."""
        sign = np.sign(state.velocity)
        if np.all((sign != 0.0) | (self.coulomb == 0.0)):
            step = self._sliding_step(state, torque, step_s, sign)
            turned = (np.sign(step.state.velocity) != sign) & (self.coulomb > 0.0)
            if not turned.any():
                return step
        return self._sticking_step(state, torque, step_s)

    def _smooth_resistance(self, state: State) -> FloatArray:
        smooth = self.viscous * state.velocity
        return smooth if self.extra is None else smooth + self.extra(state)

    def _sliding_step(self, state: State, torque: FloatArray, h: float, sign: FloatArray) -> Step:
        dry = self.coulomb * sign
        q, v, t = state.position, state.velocity, state.time_s

        def acceleration(at: State) -> tuple[FloatArray, FloatArray]:
            resistance = self._smooth_resistance(at) + dry
            return pinocchio.aba(
                self.model, self.data, at.position, at.velocity, torque - resistance
            ).copy(), resistance

        a1, resistance = acceleration(state)
        v2 = v + 0.5 * h * a1
        a2, _ = acceleration(State(t + 0.5 * h, q + 0.5 * h * v, v2))
        v3 = v + 0.5 * h * a2
        a3, _ = acceleration(State(t + 0.5 * h, q + 0.5 * h * v2, v3))
        v4 = v + h * a3
        a4, _ = acceleration(State(t + h, q + h * v3, v4))
        after = State(t + h, q + h / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4), v + h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4))
        return Step(a1, resistance, after)

    def _sticking_step(self, state: State, torque: FloatArray, h: float) -> Step:
        q, v = state.position, state.velocity
        inertia = pinocchio.crba(self.model, self.data, q)
        inertia = np.triu(inertia) + np.triu(inertia, 1).T
        bias = pinocchio.nonLinearEffects(self.model, self.data, q, v)
        extra = np.zeros_like(v) if self.extra is None else self.extra(state)
        # Viscous friction at the end of the step: it can then never reverse a joint.
        inverse = np.linalg.inv(inertia + h * np.diag(self.viscous))
        free = inverse @ (inertia @ v + h * (torque - bias - extra))
        dry = _dry_friction(free, h * inverse, self.coulomb)
        after = free - h * inverse @ dry
        after[np.abs(after) < 1e-15] = 0.0
        resting = np.abs(dry) < self.coulomb
        after[resting] = 0.0
        resistance = self.viscous * after + dry + extra
        return Step((after - v) / h, resistance, State(state.time_s + h, q + 0.5 * h * (v + after), after))


def _dry_friction(free: FloatArray, response: FloatArray, coulomb: FloatArray) -> FloatArray:
    """(n,) forces λ with v = free − response · λ, |λ| ≤ F_s, and λ = F_s sign(v) wherever v is not zero.

    response: (n, n), velocity taken away per Nm, positive definite; projected Gauss-Seidel then converges.
    """
    force = np.where(coulomb > 0.0, coulomb * np.sign(free), 0.0)
    scale = np.abs(free).max() + _SETTLED
    for _ in range(_MOST_SWEEPS):
        change = 0.0
        for joint in np.flatnonzero(coulomb):
            velocity = free[joint] - response[joint] @ force
            wanted = force[joint] + velocity / response[joint, joint]
            wanted = min(max(wanted, -coulomb[joint]), coulomb[joint])
            change = max(change, abs(wanted - force[joint]) * response[joint, joint])
            force[joint] = wanted
        if change <= _SETTLED * scale:
            break
    return force
