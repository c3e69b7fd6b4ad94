"""Closed-loop forward simulation: an identified arm follows a commanded motion under a controller.

Here: the loop over time and its result. Not here: one step (`dynamics`), the laws (`controllers`), comparing with a
recording (`comparison`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import numpy.typing as npt
import pinocchio

from identification.arrays import BoolArray, FloatArray
from identification.base_parameters import Widths, direction_of
from identification.errors import SimulationError
from identification.export.parameters import ModelParameters, refuse_unmovable
from identification.physical_parameters import PhysicalParameters
from identification.robots import RobotModel
from identification.robots.model import refuse_followers
from identification.simulation.controllers import Controller, SetPoint, State
from identification.simulation.dynamics import ArmDynamics, ExtraTorque

_SMALL = 1e-6
"""rad, rad/s (m, m/s), by which a state is moved to see what becomes of a deviation."""
_LARGEST_VELOCITY = 1e3
_PIECE = 1000


class CommandedMotion(Protocol):
    """Anything with q, q̇, q̈ over time: the trajectories of `excitation`, a recording's commanded motion."""

    @property
    def period_s(self) -> float:
        """Its length, s."""
        ...

    def evaluate(self, time_s: npt.ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
        """q, q̇, q̈ at the given times, each (S, n)."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class SimulationSettings:
    """motor_inertia: (n,) kg m², seen at the joints; zeros where None.

    motor_inertia_in_torque: whether the measured torque contains it (sensor at the motor) or not (behind the gear), of
    each joint or of all.
    duration_s: one length of the motion where None. lead_in_s: this long before, the arm already follows the motion, so
    that the controller's transient is over. step_s: of control and integration. offset: (n,) Nm, constant torque.
    coulomb_velocity: rad/s (m/s) over which Coulomb friction turns over, 0: sign(q̇); so too where a step is too long
    to follow the change.
    """

    motor_inertia: FloatArray | None = None
    motor_inertia_in_torque: bool | BoolArray = False
    duration_s: float | None = None
    lead_in_s: float = 0.0
    step_s: float = 0.001
    offset: FloatArray | None = None
    coulomb_velocity: Widths = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class SimulationResult:
    """Rows at step_s from time 0. time: (S,) s. Others (S, n), in rad, rad/s, rad/s², Nm (m, N for prismatic joints).

    reference_position: as commanded. position, velocity, acceleration: of the arm. torque: what the robot's sensor
    would show, sign of eq. (1). motor_torque: what the controller asked for. growth: by which a step of control
    multiplies the worst small deviation at the start, dry friction aside; beyond 1 nothing but that bounds it.
    """

    time: FloatArray
    reference_position: FloatArray
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    torque: FloatArray
    motor_torque: FloatArray
    growth: float

    @property
    def chatter(self) -> str:
        """A sentence where the controller is too stiff to be held over a step, else empty."""
        if self.growth <= 1.0:
            return ""
        return (
            f"WARNING, the controller is too stiff for this arm in steps of {1e3 * (self.time[1] - self.time[0]):.3g} "
            f"ms: a small deviation grows {self.growth:.3g} times in each, and the torque chatters. Choose softer "
            "gains or larger motor inertias."
        )


def simulate(
    robot: RobotModel,
    physical: PhysicalParameters,
    trajectory: CommandedMotion,
    controller: Controller,
    *,
    extra_torque: ExtraTorque | None = None,
    settings: SimulationSettings | None = None,
) -> SimulationResult:
    """Follow the commanded motion from its own position and velocity at −lead_in_s.

    physical: of the arm; the controller knows the same, without friction. extra_torque: State → (n,) Nm, added to the
    right side of eq. (1); the arm feels it and the sensor shows it, the controller knows nothing of it. The motor
    torque is held over each step. Raises SimulationError when a velocity exceeds 1000 rad/s or is not finite,
    InconsistentParametersError for a mass, moment, friction or motor inertia below zero.
    """
    refuse_followers(robot, "simulate")
    chosen = settings if settings is not None else SimulationSettings()
    n = robot.n
    motor = np.zeros(n) if chosen.motor_inertia is None else np.asarray(chosen.motor_inertia, dtype=np.float64)
    offset = np.zeros(n) if chosen.offset is None else np.asarray(chosen.offset, dtype=np.float64)
    parameters = ModelParameters(physical, motor, offset)
    refuse_unmovable(parameters)
    model = parameters.pinocchio_model(robot)
    known, unseen = model.createData(), np.where(chosen.motor_inertia_in_torque, 0.0, motor)
    duration = trajectory.period_s if chosen.duration_s is None else chosen.duration_s
    rows, lead = round(duration / chosen.step_s), round(chosen.lead_in_s / chosen.step_s)
    time: FloatArray = np.arange(-lead, rows, dtype=np.float64) * chosen.step_s
    # In pieces: a trajectory known as a table takes memory for each time and harmonic.
    pieces = [trajectory.evaluate(piece) for piece in np.array_split(time, len(time) // _PIECE + 1)]
    references = [np.concatenate(parts) for parts in zip(*pieces, strict=True)]
    state = State(float(time[0]), references[0][0].copy(), references[1][0].copy())
    mobility = np.diag(pinocchio.computeMinverse(model, known, state.position))
    widths = np.asarray(chosen.coulomb_velocity)
    gentle = (widths > 0.0) & (chosen.step_s * mobility * physical.coulomb <= widths)
    dry, turning = np.where(gentle, 0.0, physical.coulomb), np.where(gentle, physical.coulomb, 0.0)
    smooth = _sum(extra_torque, offset, turning, chosen.coulomb_velocity)
    arm = ArmDynamics(model, model.createData(), physical.viscous, dry, smooth)
    start = SetPoint(*(each[0] for each in references))
    growth = _growth(replace(arm, coulomb=np.zeros(n)), controller, state, start, chosen.step_s)
    series: FloatArray = np.empty((5, rows, n))
    for row, (q, dq, ddq) in enumerate(zip(*references, strict=True), start=-lead):
        torque = controller.torque(model, known, state, SetPoint(q, dq, ddq))
        step = arm.step(state, torque, chosen.step_s)
        if row >= 0:
            rigid = pinocchio.rnea(model, known, state.position, state.velocity, step.acceleration)
            sensed = rigid - unseen * step.acceleration + step.resistance
            series[:, row] = state.position, state.velocity, step.acceleration, sensed, torque
        state = step.state
        if not np.all(np.abs(state.velocity) < _LARGEST_VELOCITY):
            joint = int(np.argmax(~(np.abs(state.velocity) < _LARGEST_VELOCITY))) + 1
            raise SimulationError(
                f"The simulated arm ran away after {state.time_s:.3f} s, joint {joint} first: choose softer gains or "
                "larger motor inertias.",
                time_s=state.time_s,
                joint=joint,
            )
    position, velocity, acceleration, sensed, asked = series
    return SimulationResult(time[lead:], references[0][lead:], position, velocity, acceleration, sensed, asked, growth)


def _growth(arm: ArmDynamics, controller: Controller, state: State, set_point: SetPoint, step_s: float) -> float:
    """Largest eigenvalue, in size, of a step of control as a map of deviations from a state."""
    n, known = len(state.position), arm.model.createData()

    def after(change: FloatArray) -> FloatArray:
        moved = State(state.time_s, state.position + change[:n], state.velocity + change[n:])
        end = arm.step(moved, controller.torque(arm.model, known, moved, set_point), step_s).state
        return np.concatenate([end.position, end.velocity])

    small = _SMALL * np.eye(2 * n)
    slopes = np.array([(after(each) - after(-each)) / (2.0 * _SMALL) for each in small]).T
    return float(np.abs(np.linalg.eigvals(slopes)).max())


def _sum(extra: ExtraTorque | None, offset: FloatArray, coulomb: FloatArray, width: Widths) -> ExtraTorque | None:
    """All torque that is a smooth function of the state but for viscous friction, None for none."""
    if not (offset.any() or coulomb.any()):
        return extra

    def torque(state: State) -> FloatArray:
        own = offset + coulomb * direction_of(state.velocity, width)
        return own if extra is None else own + extra(state)

    return torque
