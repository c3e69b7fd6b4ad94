"""Reference trajectories without a Fourier series: fifth-order polynomials between waypoints, and sine series.

Here: the two value objects of section 4.6, closed so that they can be run over and over. Not here: how waypoints and
sines are chosen (`reference`). Read from files by `trajectory_files`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from identification.arrays import FloatArray
from identification.errors import TrajectoryError
from identification.excitation.fourier import Trajectory, check_amplitude, number, number_table, told_with


def quintic(share: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The rest-to-rest step 10 s³ - 15 s⁴ + 6 s⁵ of section 4.6 and its first two derivatives in s ∈ [0, 1]."""
    return (
        share**3 * (10.0 - 15.0 * share + 6.0 * share**2),
        30.0 * share**2 * (1.0 - share) ** 2,
        60.0 * share * (1.0 - share) * (1.0 - 2.0 * share),
    )


PEAK_STEP_VELOCITY = 15.0 / 8.0
"""Largest first derivative of the rest-to-rest step, at s = 1/2."""
PEAK_STEP_ACCELERATION = 10.0 / np.sqrt(3.0)
"""Largest second derivative of the rest-to-rest step, at s = 1/2 ± √3/6."""


@dataclass(frozen=True, slots=True)
class PolynomialTrajectory(Trajectory):
    """Rest-to-rest fifth-order polynomials through waypoints, section 4.6 with D^k - D^(k-1) in place of D^k.

    duration_s: (K,) lengths T^k of the intervals in s. waypoints: (K + 1, n) rad; the last equals the first, so that
    periods follow each other without a jump. Raises TrajectoryError otherwise.
    """

    kind: ClassVar[str] = "polynomial"
    duration_s: FloatArray
    waypoints: FloatArray
    robot: str = ""
    record: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Bring the arrays to float64 and check them once."""
        self._hold("duration_s", "waypoints")
        duration, waypoints = self.duration_s, self.waypoints
        if duration.ndim != 1 or len(duration) == 0 or not np.all(duration > 0.0):
            raise TrajectoryError("the field 'duration_s' must hold positive numbers", field="duration_s")
        if waypoints.ndim != 2 or len(waypoints) != len(duration) + 1:
            raise TrajectoryError(
                f"the field 'waypoints' must hold {len(duration) + 1} rows of finite numbers", field="waypoints"
            )
        if not np.allclose(waypoints[0], waypoints[-1], rtol=0.0, atol=1e-12):
            raise TrajectoryError("the last waypoint must equal the first, so that periods join", field="waypoints")

    @property
    def joints(self) -> int:
        """Number of joints n."""
        return int(self.waypoints.shape[1])

    @property
    def period_s(self) -> float:
        """Length of one period in s, Σ T^k."""
        return float(np.sum(self.duration_s))

    def evaluate(self, time_s: npt.ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
        """q, q̇, q̈ at the given times (taken modulo the period), each (S, n)."""
        ends = np.cumsum(self.duration_s)
        time = np.mod(np.atleast_1d(np.asarray(time_s, dtype=np.float64)), ends[-1])
        k = np.minimum(np.searchsorted(ends, time, side="right"), len(ends) - 1)
        length = self.duration_s[k][:, None]
        share = np.clip((time - (ends[k] - self.duration_s[k]))[:, None] / length, 0.0, 1.0)
        step = self.waypoints[k + 1] - self.waypoints[k]
        position, velocity, acceleration = quintic(share)
        return self.waypoints[k] + position * step, velocity * step / length, acceleration * step / length**2

    def scaled(self, amplitude: float) -> PolynomialTrajectory:
        """The same path with its amplitude about its first waypoint multiplied."""
        check_amplitude(amplitude)
        start = self.waypoints[0]
        return replace(self, waypoints=start + amplitude * (self.waypoints - start))

    @classmethod
    def from_json(cls, document: Mapping[str, Any]) -> PolynomialTrajectory:
        """Read what `to_json` wrote. Raises TrajectoryError naming the field."""
        duration = number_table(document, "duration_s", dimensions=1)
        return cls(duration, number_table(document, "waypoints"), *told_with(document))


@dataclass(frozen=True, slots=True)
class SineSeriesTrajectory(Trajectory):
    """q_i(t) = offset_i + Σ_l a_il sin(b_il t), section 4.6, for `duration_s`, then a smooth way back in `return_s`.

    amplitude a: (n, L) rad; angular_frequency b: (n, L) rad/s, not multiples of anything; offset: (n,) rad. The way
    back is the fifth-order polynomial that joins position, velocity and acceleration at both ends, so periods follow
    each other without a jump. Raises TrajectoryError on unusable numbers.
    """

    kind: ClassVar[str] = "sine_series"
    amplitude: FloatArray
    angular_frequency: FloatArray
    offset: FloatArray
    duration_s: float
    return_s: float
    robot: str = ""
    record: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Bring the arrays to float64 and check them once."""
        self._hold("amplitude", "angular_frequency", "offset")
        if self.amplitude.size == 0:
            raise TrajectoryError("the field 'amplitude' must hold finite numbers", field="amplitude")
        if self.amplitude.ndim != 2 or self.amplitude.shape != self.angular_frequency.shape:
            raise TrajectoryError("'amplitude' and 'angular_frequency' differ in shape", field="amplitude")
        if self.offset.shape != self.amplitude.shape[:1]:
            raise TrajectoryError("the field 'offset' needs one number for each joint", field="offset")
        if not (np.isfinite(self.duration_s + self.return_s) and self.duration_s > 0.0 and self.return_s > 0.0):
            raise TrajectoryError("'duration_s' and 'return_s' must be positive numbers", field="duration_s")

    @property
    def joints(self) -> int:
        """Number of joints n."""
        return int(self.amplitude.shape[0])

    @property
    def period_s(self) -> float:
        """Length of one period in s, with the way back."""
        return self.duration_s + self.return_s

    def evaluate(self, time_s: npt.ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
        """q, q̇, q̈ at the given times (taken modulo the period), each (S, n)."""
        time = np.mod(np.atleast_1d(np.asarray(time_s, dtype=np.float64)), self.period_s)
        q, dq, ddq = self._sines(np.minimum(time, self.duration_s))
        back = time > self.duration_s
        if np.any(back):
            from scipy.interpolate import BPoly  # slow to load, and other motions do without

            ends = [np.concatenate(self._sines(np.array([at]))) for at in (self.duration_s, 0.0)]
            way = BPoly.from_derivatives([0.0, self.return_s], ends)
            q[back], dq[back], ddq[back] = (way(time[back] - self.duration_s, order) for order in range(3))
        return q + self.offset, dq, ddq

    def scaled(self, amplitude: float) -> SineSeriesTrajectory:
        """The same path with its amplitude about its offset multiplied."""
        check_amplitude(amplitude)
        return replace(self, amplitude=self.amplitude * amplitude)

    @classmethod
    def from_json(cls, document: Mapping[str, Any]) -> SineSeriesTrajectory:
        """Read what `to_json` wrote. Raises TrajectoryError naming the field."""
        duration, way_back = number(document, "duration_s"), number(document, "return_s")
        amplitude, frequency = (number_table(document, name) for name in ("amplitude", "angular_frequency"))
        offset = number_table(document, "offset", dimensions=1)
        return cls(amplitude, frequency, offset, duration, way_back, *told_with(document))

    def _sines(self, time: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        phase = time[:, None, None] * self.angular_frequency
        sin, cos = np.sin(phase), np.cos(phase)
        a, b = self.amplitude, self.angular_frequency
        return np.sum(a * sin, axis=2), np.sum(a * b * cos, axis=2), -np.sum(a * b * b * sin, axis=2)
