"""The verdict on one command, each cycle, before it leaves for the robot.

Judged is what we command, never what the sensors measure: measured velocities are noisy, and a guard that trips on
noise stops arms that do nothing wrong. The measured position enters only through its distance to the command, with a
generous limit. Lives elsewhere: planning the stop after a verdict (ramps.py).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from safety.braking import stopping_state, stopping_travel
from safety.errors import TrajectoryShapeError
from safety.limits import FloatArray, JointLimits

POSITION_TOLERANCE_RAD = 1e-9
"""Slack on position limits: above the round-off of a double at 3 rad (4e-16), far below an encoder step (1e-6 rad)."""

VELOCITY_TOLERANCE = 1e-6
"""Relative slack on step and velocity: round-off of a difference at 1 ms is 1e-12 rad/s."""

ACCELERATION_TOLERANCE = 1e-3
"""Relative slack on accelerations: a second difference at 1 ms turns a planner's 1e-9 rad into 1e-3 rad/s²."""


class Judged(NamedTuple):
    """A command, (n,) rad, that a guard found good after the last one it accepted: the only thing it will accept.

    velocity, acceleration: rad/s and rad/s², what the guard remembers once the command went out. generation: of the
    guard's state it was judged against; after any other command or anchor it is worth nothing.
    """

    command: Sequence[float]
    velocity: list[float]
    acceleration: list[float]
    generation: int


@dataclass(frozen=True, slots=True)
class GuardVerdict:
    """Why a command was refused.

    criterion: "anchor", "finite", "position", "distance_to_measured", "velocity", "acceleration", "stopping_velocity"
    or "stopping_position". joint: counted from 1. value, limit: in `unit`; a limit of an interval is the side that
    was passed.
    """

    criterion: str
    joint: int
    value: float
    limit: float
    unit: str

    def sentence(self) -> str:
        """One sentence for the operator."""
        return _SENTENCES[self.criterion].format(joint=self.joint, value=self.value, limit=self.limit, unit=self.unit)


_SENTENCES = {
    "anchor": "The guard has not been told where the arm is, so it refuses every command.",
    "shape": "The command holds {value:.0f} numbers, but the robot has {limit:.0f} joints.",
    "finite": "The command of joint {joint} is {value}, which is not a finite number.",
    "position": "The command of joint {joint} is {value:.5f} {unit}, beyond its position limit of {limit:.5f} {unit}.",
    "distance_to_measured": "The command of joint {joint} is {value:.5f} {unit} away from its measured position; "
    "{limit:.5f} {unit} are allowed.",
    "velocity": "The command of joint {joint} asks for {value:.4f} {unit}; its velocity limit is {limit:.4f} {unit}.",
    "acceleration": "The command of joint {joint} asks for {value:.3f} {unit}; its acceleration limit is "
    "{limit:.3f} {unit}.",
    "stopping_velocity": "After this command joint {joint} could not avoid {value:.4f} {unit}; its velocity limit is "
    "{limit:.4f} {unit}.",
    "stopping_position": "After this command joint {joint} could not stop before {value:.5f} {unit}; its position "
    "limit is {limit:.5f} {unit}.",
}


class CommandGuard:
    """Judges a stream of joint position commands, one per command period.

    limits: what the commands have to keep to. command_period_s: time from one command to the next, s.
    maximum_distance_to_measured: rad, one number or one per joint. The arm follows its command with a lag of some 10 ms
    (15 to 25 mrad at full velocity), so 0.1 rad is generous and still stops an arm that is held or does not follow.

    `examine` a command; once it went out, `accept` it, and it becomes the reference of the next one. What was refused,
    or never went out, leaves no trace. Between the first acceptance and the last the guard keeps this promise: from
    `position`, `velocity`, `acceleration` the stop of `plan_stop_ramp` under the same limits stays inside every limit.

    generation: counts what changed the guard's state.
    """

    def __init__(
        self, limits: JointLimits, command_period_s: float, *, maximum_distance_to_measured: ArrayLike = 0.1
    ) -> None:
        if not (math.isfinite(command_period_s) and command_period_s > 0.0):
            raise TrajectoryShapeError(f"The command period is {command_period_s} s, but it has to be above 0 s.")
        n = limits.joint_count
        distance = np.asarray(maximum_distance_to_measured, dtype=np.float64)
        if distance.shape not in {(), (n,)} or not np.all(distance > 0.0):
            raise TrajectoryShapeError(
                f"The largest distance to the measured position has to be one number above 0 or "
                f"{n} of them, not {maximum_distance_to_measured!r}."
            )
        self._limits = limits
        self._n = n
        self._period = command_period_s
        self._rate = 1.0 / command_period_s
        velocity = limits.velocity * (1.0 + VELOCITY_TOLERANCE)
        acceleration = limits.acceleration * (1.0 + ACCELERATION_TOLERANCE)
        # Where the jerk changes between two ticks, the extrapolated velocity is off by up to jerk T².
        peak = velocity + limits.jerk * command_period_s**2
        room = list(map(_longest_travel, peak.tolist(), acceleration.tolist(), limits.jerk.tolist()))
        lower, upper = limits.position_lower, limits.position_upper
        columns = (
            lower - POSITION_TOLERANCE_RAD, upper + POSITION_TOLERANCE_RAD, np.broadcast_to(distance, (n,)), velocity,
            acceleration, peak, limits.jerk, lower + room, upper - room,
        )  # fmt: skip
        # One row per joint: everything the inner loop needs, in the order it is unpacked.
        self._rows = tuple(map(tuple, np.stack(columns, axis=1).tolist()))
        self.generation = 0
        self._anchored = False
        self._position: Sequence[float] = [0.0] * n
        self._velocity = [0.0] * n  # (q_k - q_{k-1}) / T, the velocity half a period before the tick
        self._acceleration = [0.0] * n  # (q_k - 2 q_{k-1} + q_{k-2}) / T²
        self.distances = tuple(row[2] for row in self._rows)
        """Largest distance of a command to the measured position, rad, per joint."""

    @property
    def position(self) -> FloatArray:
        """Last accepted command, (n,) rad."""
        return np.array(self._position)

    @property
    def velocity(self) -> FloatArray:
        """Velocity, (n,) rad/s, from which a stop after the last accepted command is planned (stopping_state)."""
        return np.array([velocity for velocity, _ in self._stopping_states()])

    @property
    def acceleration(self) -> FloatArray:
        """Acceleration, (n,) rad/s², from which a stop after the last accepted command is planned (stopping_state)."""
        return np.array([acceleration for _, acceleration in self._stopping_states()])

    def _stopping_states(self) -> list[tuple[float, float]]:
        return [
            stopping_state(v, a, row[4], row[6], self._period)
            for v, a, row in zip(self._velocity, self._acceleration, self._rows, strict=True)
        ]

    @property
    def anchored(self) -> bool:
        """Whether the guard knows where the arm was commanded to."""
        return self._anchored

    def anchor(self, position: Sequence[float] | FloatArray) -> None:
        """Take `position`, (n,) rad, as commanded and at rest: the IPO position when the robot begins to command.

        Raises TrajectoryShapeError for a wrong number of joints or a value that is not finite.
        """
        values = [float(value) for value in position]
        if len(values) != self._n:
            raise TrajectoryShapeError(f"The anchor holds {len(values)} numbers, but the robot has {self._n} joints.")
        for joint, value in enumerate(values, start=1):
            if not math.isfinite(value):
                raise TrajectoryShapeError(f"The anchor of joint {joint} is {value}, which is not a finite number.")
        self._position = values
        self._velocity = [0.0] * self._n
        self._acceleration = [0.0] * self._n
        self._anchored = True
        self.generation += 1

    @property
    def at_rest(self) -> bool:
        """Whether the commands stand still: no velocity and no acceleration are left."""
        return not (any(self._velocity) or any(self._acceleration))

    @property
    def command(self) -> tuple[float, ...]:
        """Last accepted command, rad, to the bit."""
        return tuple(self._position)

    def repeats(self, command: Sequence[float], within_rad: float = 0.0) -> bool:
        """Whether a command is the last accepted one, to the bit or within so much per joint."""
        return all(abs(a - b) <= within_rad for a, b in zip(command, self._position, strict=True))

    def come_to_rest(self) -> None:
        """The robot stands on the last accepted command: velocity and acceleration are gone."""
        self.anchor(self._position)

    def release(self) -> None:
        """Forget where the arm is: every command is refused until the next anchor."""
        self._anchored = False
        self.generation += 1

    def accept(self, judged: Judged) -> None:
        """The command went out: it is the reference of the next one.

        Raises ValueError for one that was judged against another state than the present one.
        """
        if judged.generation != self.generation:
            raise ValueError("a command was accepted that had been judged after another one")
        self.generation += 1
        self._position, self._velocity, self._acceleration = judged.command, judged.velocity, judged.acceleration

    def examine(
        self,
        command: Sequence[float] | FloatArray,
        measured_position: Sequence[float] | FloatArray | None,
        *,
        stopping: bool = False,
    ) -> Judged | GuardVerdict:
        """Judge one command, (n,) rad, against the last accepted one and the measured position, (n,) rad.

        Returns what `accept` takes, or the first criterion the command fails; the guard's state stays as it is.
        measured_position: None where the distance to it is judged elsewhere. stopping: the command belongs to a stop
        that was planned from an accepted state, or repeats the last one. Such a stop is itself the proof that the arm
        can be stopped, so the two stopping criteria are not asked again (near a limit their finite differences lag one
        period behind a stop at full jerk, and would refuse the very stop they demand); nor is the position limit,
        since an arm beyond it has to stop as well.
        """
        if not self._anchored:
            return GuardVerdict("anchor", 0, math.nan, math.nan, "")
        # float64 arrays are turned into lists once: indexing them element by element is five times slower.
        wanted = command.tolist() if isinstance(command, np.ndarray) else command
        measured = measured_position.tolist() if isinstance(measured_position, np.ndarray) else measured_position
        if measured is None:
            measured = wanted
        if len(wanted) != self._n or len(measured) != self._n:
            wrong = len(wanted) if len(wanted) != self._n else len(measured)
            return GuardVerdict("shape", 0, float(wrong), float(self._n), "")
        rate = self._rate
        period = self._period
        velocities: list[float] = []
        accelerations: list[float] = []
        for joint, (q, last, last_v, actual, row) in enumerate(
            zip(wanted, self._position, self._velocity, measured, self._rows, strict=True), start=1
        ):
            lower, upper, gap, v_limit, a_limit, peak_limit, jerk, inner_lower, inner_upper = row
            # Every comparison is written so that a NaN fails it.
            if not (lower <= q <= upper):
                if not math.isfinite(q):
                    return GuardVerdict("finite", joint, float(q), math.nan, "rad")
                if not stopping:
                    side = self._limits.position_lower if q < lower else self._limits.position_upper
                    return GuardVerdict("position", joint, float(q), float(side[joint - 1]), "rad")
            if not (-gap <= q - actual <= gap):
                return GuardVerdict("distance_to_measured", joint, float(q - actual), gap, "rad")
            v = (q - last) * rate
            if not (-v_limit <= v <= v_limit):
                return GuardVerdict("velocity", joint, v, float(self._limits.velocity[joint - 1]), "rad/s")
            a = (v - last_v) * rate
            if not (-a_limit <= a <= a_limit):
                return GuardVerdict("acceleration", joint, a, float(self._limits.acceleration[joint - 1]), "rad/s²")
            if not stopping:
                now, onset = stopping_state(v, a, a_limit, jerk, period)
                peak = now + onset * abs(onset) / (2.0 * jerk)
                if not (-peak_limit <= peak <= peak_limit):
                    limit = float(self._limits.velocity[joint - 1])
                    return GuardVerdict("stopping_velocity", joint, peak, limit, "rad/s")
                if not (inner_lower <= q <= inner_upper):
                    verdict = self._stopping_position(joint, q, now, onset)
                    if verdict is not None:
                        return verdict
            velocities.append(v)
            accelerations.append(a)
        return Judged(wanted, velocities, accelerations, self.generation)

    def _stopping_position(self, joint: int, q: float, velocity: float, acceleration: float) -> GuardVerdict | None:
        row = self._rows[joint - 1]
        limit, jerk = float(self._limits.acceleration[joint - 1]), row[6]
        limit = max(limit, abs(acceleration))
        highest = q + stopping_travel(velocity, acceleration, limit, jerk)
        if highest > row[1]:
            return GuardVerdict(
                "stopping_position", joint, highest, float(self._limits.position_upper[joint - 1]), "rad"
            )
        lowest = q - stopping_travel(-velocity, -acceleration, limit, jerk)
        if lowest < row[0]:
            return GuardVerdict(
                "stopping_position", joint, lowest, float(self._limits.position_lower[joint - 1]), "rad"
            )
        return None


def _longest_travel(velocity: float, acceleration: float, jerk: float) -> float:
    """Upper bound, rad, of the travel of any stop whose inevitable velocity is at most `velocity`.

    A state accelerating at a reaches the peak velocity after a / jerk at most and brakes from there.
    """
    return velocity * acceleration / jerk + stopping_travel(velocity, 0.0, acceleration, jerk)
