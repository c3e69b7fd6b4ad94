"""Start and stop ramps in joint space: planned by Ruckig, checked by us, and only then handed out.

Lives here: the plan, its check against position, velocity and acceleration limits, and the cheap evaluation per tick.
Lives elsewhere: when a ramp begins and what follows it (the loop). What Ruckig does not do for us, and this module
does: the velocity interface ignores position and velocity limits; its `position_extrema` assume a target position
that the velocity interface does not have; on an error its output is stale. So every input is judged before, and every
trajectory is taken apart into its phases of constant jerk, whose extrema are exact.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import ClassVar

import numpy as np
import ruckig

from safety.errors import SafetyError
from safety.limits import FloatArray, JointLimits

STOP_FRACTIONS = (0.35, 0.5, 0.7, 0.85, 1.0)
"""Ladder of stops: the acceleration and jerk limits are multiplied by these in turn, the first stop that fits is
taken."""

START_FRACTIONS = (0.15, 0.25, 0.4, 0.6, 0.8, 1.0)
"""Ladder of start ramps: velocity, acceleration and jerk limits multiplied by these; the first ramp that fits is
taken."""

POSITION_TOLERANCE_RAD = 1e-7
"""A ramp may pass a position limit by this much: ten times Ruckig's own precision of 1e-8 rad."""

RELATIVE_TOLERANCE = 1e-6
"""A ramp may pass a velocity or acceleration limit by this fraction."""


class Ramp:
    """A checked motion of n joints from t = 0 to `duration_s`; holds its last state afterwards.

    A stop ends at rest. A start ramp ends on the state it was planned for, exactly; the caller switches to what
    follows at `duration_s`. fraction: the rung of the ladder (share of the limits) that was needed.
    """

    def __init__(
        self,
        trajectory: ruckig.Trajectory,
        duration_s: float,
        fraction: float,
        final: tuple[FloatArray, FloatArray, FloatArray],
    ) -> None:
        self._trajectory = trajectory
        self.duration_s = duration_s
        self.fraction = fraction
        self._final = final

    def at(self, time_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Position (n,) rad, velocity (n,) rad/s and acceleration (n,) rad/s² at `time_s` after the ramp's
        beginning.
        """
        if time_s >= self.duration_s:
            position, velocity, acceleration = self._final
            return position.copy(), velocity.copy(), acceleration.copy()
        position, velocity, acceleration = self._trajectory.at_time(time_s if time_s > 0.0 else 0.0)
        return np.array(position), np.array(velocity), np.array(acceleration)

    def position_at(self, time_s: float) -> list[float]:
        """Position alone, n plain floats, rad: the cheapest form for the loop."""
        if time_s >= self.duration_s:
            resting: list[float] = self._final[0].tolist()
            return resting
        position: list[float] = self._trajectory.at_time(time_s if time_s > 0.0 else 0.0)[0]
        return position


class RampError(SafetyError):
    """No ramp stays inside the limits.

    joint: counted from 1; quantity: "position", "velocity", "acceleration" or "planner"; value and limit in `unit`.
    firmest: for a stop, the firmest ramp there is although it leaves a position limit. A moving arm is better stopped
    late than not at all, so the caller may still follow it; None where no ramp could be computed.
    """

    exit_code: ClassVar[int] = 1

    def __init__(
        self,
        message: str,
        *,
        joint: int | None = None,
        quantity: str = "planner",
        value: float = float("nan"),
        limit: float = float("nan"),
        unit: str = "",
        firmest: Ramp | None = None,
    ) -> None:
        super().__init__(message)
        self.joint = joint
        self.quantity = quantity
        self.value = value
        self.limit = limit
        self.unit = unit
        self.firmest = firmest


def plan_stop_ramp(
    position: Sequence[float] | FloatArray,
    velocity: Sequence[float] | FloatArray,
    acceleration: Sequence[float] | FloatArray,
    limits: JointLimits,
) -> Ramp:
    """Stop of all joints from a moving state, each on its own as fast as the rung of the ladder allows.

    position (n,) rad, velocity (n,) rad/s, acceleration (n,) rad/s²: the state at the last accepted command. The ladder
    STOP_FRACTIONS goes from gentle to the firmest that the acceleration and jerk limits allow; a rung is refused when
    the stop would leave a position limit or raise a velocity above its limit.

    A state beyond the limits can still be stopped: an initial position, velocity or acceleration past its limit widens
    that limit to the initial value (and to the velocity it cannot avoid any more), so the stop never makes it worse and
    is never refused for it. Raises RampError with joint and numbers when even the firmest stop leaves a position limit
    by more than POSITION_TOLERANCE_RAD (never for a state the guard accepted); its attribute `firmest` is that stop.
    """
    q = _state("position", position, limits)
    dq = _state("velocity", velocity, limits)
    ddq = _state("acceleration", acceleration, limits)
    inevitable = np.maximum(np.abs(dq), np.abs(dq + ddq * np.abs(ddq) / (2.0 * limits.jerk)))
    velocity_bound = np.maximum(limits.velocity, inevitable)
    acceleration_bound = np.maximum(limits.acceleration, np.abs(ddq))
    lower, upper = np.minimum(limits.position_lower, q), np.maximum(limits.position_upper, q)
    failure: tuple[str, int, float, float] | None = None
    ramp: Ramp | None = None
    for fraction in STOP_FRACTIONS:
        request = _request(
            q, dq, ddq, velocity_bound, np.maximum(fraction * limits.acceleration, np.abs(ddq)), fraction * limits.jerk
        )
        request.control_interface = ruckig.ControlInterface.Velocity
        request.synchronization = ruckig.Synchronization.No
        request.target_velocity = [0.0] * limits.joint_count
        request.target_acceleration = [0.0] * limits.joint_count
        trajectory = _calculate(ruckig.Ruckig(limits.joint_count), request)
        duration = float(trajectory.duration)
        end = np.array(trajectory.at_time(duration)[0])
        rest = np.zeros(limits.joint_count)
        ramp = Ramp(trajectory, duration, fraction, (end, rest, rest))
        failure = _violation(trajectory, lower, upper, velocity_bound, acceleration_bound)
        if failure is None:
            return ramp
    assert failure is not None
    raise _ramp_error("stop", failure, ramp)


def plan_start_ramp(
    position: Sequence[float] | FloatArray,
    target_position: Sequence[float] | FloatArray,
    target_velocity: Sequence[float] | FloatArray,
    target_acceleration: Sequence[float] | FloatArray,
    limits: JointLimits,
    *,
    command_period_s: float = 0.001,
) -> Ramp:
    """Motion from where the arm stands to a moving target state, all joints arriving together on a command tick.

    position, target_position (n,) rad; target_velocity (n,) rad/s; target_acceleration (n,) rad/s². `duration_s` is a
    whole number of command periods, so the table that follows goes on exactly one period after the ramp's last tick.
    The ladder START_FRACTIONS goes from gentle to the full limits; the gentle rungs are widened per joint to what the
    target state needs.

    Raises RampError when an end state cannot be reached or left within the limits (its position, velocity,
    acceleration, or the velocity that its acceleration implies just before), or when no rung yields a ramp inside them.
    """
    q, rest = _state("position", position, limits), np.zeros(limits.joint_count)
    q_end = _state("target position", target_position, limits)
    dq_end = _state("target velocity", target_velocity, limits)
    ddq_end = _state("target acceleration", target_acceleration, limits)
    _refuse_infeasible("start", q, rest, rest, limits)
    # Seen backwards in time, a target acceleration changes sign: the ramp comes from where its mirror image would go.
    _refuse_infeasible("target", q_end, -dq_end, ddq_end, limits)

    failure: tuple[str, int, float, float] | None = None
    planner_error: RampError | None = None
    for fraction in START_FRACTIONS:
        request = _start_request(q, (q_end, dq_end, ddq_end), limits, fraction)
        try:
            trajectory = _calculate(ruckig.Ruckig(limits.joint_count, command_period_s), request)
        except RampError as error:
            planner_error = error
            continue
        ticks = round(float(trajectory.duration) / command_period_s)
        failure = _violation(
            trajectory, limits.position_lower, limits.position_upper, limits.velocity, limits.acceleration
        )
        arrived = trajectory.at_time(float(trajectory.duration))
        off = max(
            float(np.max(np.abs(np.array(arrived[0]) - q_end))), abs(ticks * command_period_s - trajectory.duration)
        )
        if failure is None and off < POSITION_TOLERANCE_RAD:
            return Ramp(trajectory, ticks * command_period_s, fraction, (q_end, dq_end, ddq_end))
    if failure is not None:
        raise _ramp_error("start", failure, None)
    if planner_error is not None:
        raise planner_error
    raise RampError("The planner found no start ramp that ends on the target state.")


def _state(name: str, given: Sequence[float] | FloatArray, limits: JointLimits) -> FloatArray:
    array = np.array(given, dtype=np.float64)
    if array.shape != (limits.joint_count,):
        raise RampError(
            f"The {name} of the ramp has shape {array.shape}, but the robot has {limits.joint_count} joints."
        )
    for joint, value in enumerate(array.tolist(), start=1):
        if not math.isfinite(value):
            raise RampError(
                f"The {name} of joint {joint} is {value}, which is not a finite number.",
                joint=joint,
                quantity=name,
                value=value,
            )
    return array


def _start_request(
    q: FloatArray, end: tuple[FloatArray, FloatArray, FloatArray], limits: JointLimits, fraction: float
) -> ruckig.InputParameter:
    """From rest to a state (position, velocity, acceleration) on this share of the limits, or what the state needs."""
    (q_end, dq_end, ddq_end), rest = end, np.zeros(limits.joint_count)
    jerk = fraction * limits.jerk
    velocity = np.maximum(fraction * limits.velocity, np.abs(dq_end) + ddq_end**2 / (2.0 * jerk))
    velocity = np.minimum(velocity, limits.velocity * (1.0 + RELATIVE_TOLERANCE))
    request = _request(q, rest, rest, velocity, np.maximum(fraction * limits.acceleration, np.abs(ddq_end)), jerk)
    request.control_interface = ruckig.ControlInterface.Position
    request.synchronization = ruckig.Synchronization.Time
    request.duration_discretization = ruckig.DurationDiscretization.Discrete
    request.target_position = q_end.tolist()
    request.target_velocity = dq_end.tolist()
    request.target_acceleration = ddq_end.tolist()
    return request


def _request(
    q: FloatArray, dq: FloatArray, ddq: FloatArray, velocity: FloatArray, acceleration: FloatArray, jerk: FloatArray
) -> ruckig.InputParameter:
    request = ruckig.InputParameter(int(q.size))
    request.current_position = q.tolist()
    request.current_velocity = dq.tolist()
    request.current_acceleration = ddq.tolist()
    request.max_velocity = velocity.tolist()
    request.max_acceleration = acceleration.tolist()
    request.max_jerk = jerk.tolist()
    return request


def _calculate(planner: ruckig.Ruckig, request: ruckig.InputParameter) -> ruckig.Trajectory:
    """Run the planner; a trajectory is returned only when the planner says that it finished."""
    trajectory = ruckig.Trajectory(request.degrees_of_freedom)
    try:
        result = planner.calculate(request, trajectory)
    except ruckig.RuckigError as error:
        raise RampError(f"The ramp planner refused its input: {error}") from error
    if result not in (ruckig.Result.Working, ruckig.Result.Finished):
        raise RampError(f"The ramp planner gave up ({result.name}).")
    return trajectory


def _refuse_infeasible(end: str, q: FloatArray, dq: FloatArray, ddq: FloatArray, limits: JointLimits) -> None:
    """Raise RampError where a state lies outside the limits or is bound to leave the velocity limit."""
    peak = dq + ddq * np.abs(ddq) / (2.0 * limits.jerk)
    for i in range(limits.joint_count):
        lower, upper = float(limits.position_lower[i]), float(limits.position_upper[i])
        if not lower - POSITION_TOLERANCE_RAD <= q[i] <= upper + POSITION_TOLERANCE_RAD:
            side = lower if q[i] < lower else upper
            raise RampError(
                f"The {end} of the ramp has joint {i + 1} at {q[i]:.5f} rad, beyond its limit of {side:.5f} rad.",
                joint=i + 1,
                quantity="position",
                value=float(q[i]),
                limit=side,
                unit="rad",
            )
        for quantity, value, limit, unit in (
            ("velocity", dq[i], limits.velocity[i], "rad/s"),
            ("acceleration", ddq[i], limits.acceleration[i], "rad/s²"),
            ("velocity", peak[i], limits.velocity[i], "rad/s"),
        ):
            if abs(value) > limit * (1.0 + RELATIVE_TOLERANCE):
                raise RampError(
                    f"The {end} of the ramp needs {abs(value):.4f} {unit} at joint {i + 1}; its {quantity} limit "
                    f"is {limit:.4f} {unit}.",
                    joint=i + 1,
                    quantity=quantity,
                    value=float(abs(value)),
                    limit=float(limit),
                    unit=unit,
                )


def _phases(profile: ruckig.Profile) -> Iterator[tuple[float, float, float, float, float]]:
    """Phases of constant jerk of one joint: duration s, jerk, and acceleration, velocity, position at their
    beginning.
    """
    if profile.brake.duration > 0.0:
        brake = profile.brake
        yield from zip(brake.t, brake.j, brake.a, brake.v, brake.p, strict=True)
    yield from zip(profile.t, profile.j, profile.a, profile.v, profile.p, strict=False)


def _violation(
    trajectory: ruckig.Trajectory, lower: FloatArray, upper: FloatArray, velocity: FloatArray, acceleration: FloatArray
) -> tuple[str, int, float, float] | None:
    """First limit that a trajectory leaves: (quantity, joint from 1, value, limit), or None.

    Within a phase of constant jerk the acceleration is extreme at its ends, the velocity also where a = 0, and the
    position also where v = 0; so the check is exact and knows nothing of the planner's own summary of its extrema.
    """
    worst: tuple[str, int, float, float] | None = None
    for i, profile in enumerate(trajectory.profiles[0]):
        low, high = float(lower[i]) - POSITION_TOLERANCE_RAD, float(upper[i]) + POSITION_TOLERANCE_RAD
        v_limit = float(velocity[i]) * (1.0 + RELATIVE_TOLERANCE)
        a_limit = float(acceleration[i]) * (1.0 + RELATIVE_TOLERANCE)
        for duration, j, a, v, p in _phases(profile):
            if duration <= 0.0:
                continue
            a_end = a + j * duration
            if max(abs(a), abs(a_end)) > a_limit:
                return "acceleration", i + 1, max(abs(a), abs(a_end)), float(acceleration[i])
            times = [0.0, duration]
            if j != 0.0 and 0.0 < -a / j < duration:
                times.append(-a / j)
            for t in times:
                speed = abs(v + t * (a + t * j / 2.0))
                if speed > v_limit:
                    return "velocity", i + 1, speed, float(velocity[i])
            for t in (0.0, duration, *_roots(j / 2.0, a, v)):
                if not 0.0 <= t <= duration:
                    continue
                q = p + t * (v + t * (a / 2.0 + t * j / 6.0))
                if q < low or q > high:
                    limit = float(lower[i]) if q < low else float(upper[i])
                    # Of several excursions the largest is what the operator should read.
                    if worst is None or abs(q - limit) > abs(worst[2] - worst[3]):
                        worst = ("position", i + 1, q, limit)
    return worst


def _roots(a: float, b: float, c: float) -> tuple[float, ...]:
    """Real roots of a t² + b t + c."""
    if a == 0.0:
        return () if b == 0.0 else (-c / b,)
    discriminant = b * b - 4.0 * a * c
    if discriminant < 0.0:
        return ()
    # The form without cancellation: a small root would lose its digits otherwise.
    half = -(b + math.copysign(math.sqrt(discriminant), b)) / 2.0
    return (half / a,) if half == 0.0 else (half / a, c / half)


def _ramp_error(kind: str, failure: tuple[str, int, float, float], firmest: Ramp | None) -> RampError:
    quantity, joint, value, limit = failure
    unit = {"position": "rad", "velocity": "rad/s", "acceleration": "rad/s²"}[quantity]
    how = "even the firmest stop" if kind == "stop" else "every start ramp the planner finds"
    return RampError(
        f"No {kind} ramp fits: {how} takes joint {joint} to {value:.5f} {unit}, and its {quantity} limit is "
        f"{limit:.5f} {unit}.",
        joint=joint,
        quantity=quantity,
        value=value,
        limit=limit,
        unit=unit,
        firmest=firmest,
    )
