"""The paper's four reference trajectories (section 4.6), on which identified models are scored.

Here: how waypoints and sines are drawn inside limits, seeded. Not here: the value objects (`fourier`, `polynomials`)
and scoring (`validation`).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from identification.arrays import FloatArray
from identification.base_parameters import BaseRegressor
from identification.errors import DesignError
from identification.excitation.fourier import Trajectory
from identification.excitation.limits import ExcitationLimits
from identification.excitation.objective import achieved_figures
from identification.excitation.polynomials import (
    PEAK_STEP_ACCELERATION,
    PEAK_STEP_VELOCITY,
    PolynomialTrajectory,
    SineSeriesTrajectory,
)
from identification.excitation.trajectory_files import default_trajectory
from identification.robots import RobotModel

REFERENCE_KINDS = ("excitation", "sine_series", "polynomial_10", "polynomial_20")
"""q_ref,1 to q_ref,4 of the paper, in its order."""

_USE = 0.95
"""Part of each limit that reference trajectories use."""
_SINES = 5
_DURATION_S = 10.0
_RETURN_S = 2.0
_ATTEMPTS = 60
_ROUND = 12


def reference_trajectory(
    kind: str,
    limits: ExcitationLimits,
    seed: int = 0,
    *,
    robot: RobotModel | None = None,
    acceptable: Callable[[Trajectory], bool] | None = None,
) -> Trajectory:
    """One of the four, inside the limits on position, velocity and acceleration, starting and ending at rest.

    "excitation": the shipped excitation of `robot` (iiwa14 without one). "sine_series": the best conditioned of
    several random draws when `robot` is given, else the first. "polynomial_10", "polynomial_20": 10 or 20 random
    intervals, 10 s together. All start in the middle of the joints' ranges. acceptable: judges a candidate
    (collisions); draws are repeated until it accepts. Raises DesignError for another kind, or if it accepts none.
    """
    if kind == "excitation":
        return default_trajectory("iiwa14" if robot is None else robot.name)
    if kind not in REFERENCE_KINDS:
        raise DesignError(f"Unknown reference trajectory '{kind}'; known are {', '.join(REFERENCE_KINDS)}.")
    centre = limits.middle
    name = "" if robot is None else robot.name
    regressor = BaseRegressor(robot) if robot is not None and kind == "sine_series" else None
    # A judge that looks at collisions costs seconds: of each round it sees the best conditioned ones first.
    together = _ROUND if regressor is not None else 1
    for first in range(0, _ATTEMPTS, together):
        drawn: list[tuple[float, int, Trajectory]] = []
        for attempt in range(first, first + together):
            generator = np.random.default_rng([seed, REFERENCE_KINDS.index(kind), attempt])
            record = {"seed": seed, "settings": {"kind": kind, "attempt": attempt}, "limits": limits.to_json()}
            candidate: Trajectory
            if kind == "sine_series":
                candidate = _sine_series(limits, centre, generator, name, record)
            else:
                candidate = _polynomial(limits, centre, generator, 10 if kind == "polynomial_10" else 20, name, record)
            figure = 0.0 if regressor is None else achieved_figures(regressor, candidate)["cond"]
            drawn.append((figure, attempt, candidate))
        for _, _, candidate in sorted(drawn, key=lambda entry: entry[:2]):
            if acceptable is None or acceptable(candidate):
                return candidate
    raise DesignError(
        f"None of {_ATTEMPTS} random trajectories of kind '{kind}' was accepted; tighten the position limits."
    )


def _polynomial(
    limits: ExcitationLimits,
    start: FloatArray,
    generator: np.random.Generator,
    intervals: int,
    robot: str,
    record: dict[str, object],
) -> PolynomialTrajectory:
    """Waypoints drawn one after the other from what can be reached in T^k and from which the way back can be made."""
    # Whole milliseconds, so that the table at 1 kHz has a waypoint on a row and a whole number of rows.
    shares = generator.uniform(0.5, 1.5, size=intervals)
    ends = np.round(np.cumsum(shares) / np.sum(shares) * _DURATION_S, 3)
    duration = np.diff(ends, prepend=0.0)
    by_velocity = np.multiply.outer(duration, limits.velocity) / PEAK_STEP_VELOCITY
    by_acceleration = np.multiply.outer(duration**2, limits.acceleration) / PEAK_STEP_ACCELERATION
    reach = _USE * np.minimum(by_velocity, by_acceleration)
    middle = limits.middle
    half = _USE * 0.5 * (limits.position_upper - limits.position_lower)
    waypoints = np.empty((intervals + 1, limits.joints))
    waypoints[0] = waypoints[-1] = start
    for k in range(1, intervals):
        remaining = np.sum(reach[k:], axis=0)
        low = np.maximum.reduce([waypoints[k - 1] - reach[k - 1], start - remaining, np.minimum(middle - half, start)])
        high = np.minimum.reduce([waypoints[k - 1] + reach[k - 1], start + remaining, np.maximum(middle + half, start)])
        waypoints[k] = generator.uniform(low, np.maximum(low, high))
    return PolynomialTrajectory(duration, waypoints, robot, record)


def _sine_series(
    limits: ExcitationLimits, offset: FloatArray, generator: np.random.Generator, robot: str, record: dict[str, object]
) -> SineSeriesTrajectory:
    """Random sines that start at rest (Σ a b = 0), each joint stretched to the first limit it meets."""
    joints = limits.joints
    frequency = generator.uniform(0.4, np.pi, size=(joints, _SINES))
    amplitude = generator.normal(size=(joints, _SINES)) / frequency
    # The nearest amplitudes with zero initial velocity; sines start with zero acceleration anyway.
    excess = np.sum(amplitude * frequency, axis=1) / np.sum(frequency**2, axis=1)
    amplitude = amplitude - excess[:, None] * frequency
    trial = SineSeriesTrajectory(amplitude, frequency, np.zeros(joints), _DURATION_S, _RETURN_S, robot, record)
    times = np.arange(round(trial.period_s * 1000.0)) / 1000.0
    peaks = [np.max(np.abs(value), axis=0) for value in trial.evaluate(times)]
    allowed = (limits.reach(offset), limits.velocity, limits.acceleration)
    stretch = _USE * np.min([limit / peak for limit, peak in zip(allowed, peaks, strict=True)], axis=0)
    return SineSeriesTrajectory(amplitude * stretch[:, None], frequency, offset, _DURATION_S, _RETURN_S, robot, record)
