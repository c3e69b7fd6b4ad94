"""Fourier excitation trajectories, eq. (12): the value object, its closed-form derivatives and its table.

Here: coefficients in, positions, velocities and accelerations out. Not here: how the coefficients are chosen
(`design`), which bounds they obey (`constraints`), and how trajectories are read from files (`trajectory_files`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from identification.arrays import FloatArray
from identification.errors import TrajectoryError
from identification.json_values import plain

FORMAT = "iiwa-ident/trajectory/1"


class Trajectory(ABC):
    """A periodic motion of n joints, as `run`, `check` and the demo ask for it.

    robot: name of the robot it was made for, or empty. record: what the designer noted (limits, achieved figures, seed,
    settings); it travels with the file and changes nothing about the motion. kind: what a file calls it.
    """

    __slots__ = ()
    kind: ClassVar[str]
    robot: str
    record: Mapping[str, Any]

    @property
    @abstractmethod
    def joints(self) -> int:
        """Number of joints n."""

    @property
    @abstractmethod
    def period_s(self) -> float:
        """Length of one period in s."""

    @abstractmethod
    def evaluate(self, time_s: npt.ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Position, velocity and acceleration at the given times, each (S, n) in rad, rad/s, rad/s²."""

    @abstractmethod
    def scaled(self, amplitude: float) -> Trajectory:
        """The same path with its amplitude multiplied. Raises TrajectoryError for one that is not positive."""

    def numbers(self) -> dict[str, Any]:
        """What describes the motion in a file, as plain JSON types."""
        told = plain(self)
        del told["record"]
        return {"kind": self.kind, "robot": told.pop("robot"), **told}

    def sample_times(self, rate_hz: float) -> FloatArray:
        """Times of the samples of exactly one period, (N,) s; the last one is a step before the next period."""
        count = samples_per_period(self.period_s, rate_hz)
        return np.arange(count, dtype=np.float64) * (self.period_s / count)

    def table(self, rate_hz: float = 1000.0) -> FloatArray:
        """Positions of exactly one period, (rate · T, n) rad; row N would equal row 0."""
        return self.evaluate(self.sample_times(rate_hz))[0]

    def to_json(self, *, table_rate_hz: float | None = None) -> dict[str, Any]:
        """The file's content (`iiwa-ident/trajectory/1`); with a rate also the table of one period."""
        document = {"format": FORMAT, **self.numbers(), **self.record}
        if table_rate_hz is not None:
            document["table"] = {"rate_hz": table_rate_hz, "position": self.table(table_rate_hz).tolist()}
        return document

    def _hold(self, *names: str) -> None:
        """Bring these fields to read-only float64 arrays. Raises TrajectoryError for a number that is not finite."""
        for name in names:
            array = np.array(getattr(self, name), dtype=np.float64)
            if not np.all(np.isfinite(array)):
                raise TrajectoryError(f"the trajectory's field '{name}' holds a number that is not finite", field=name)
            array.setflags(write=False)
            object.__setattr__(self, name, array)


def samples_per_period(period_s: float, rate_hz: float) -> int:
    """Number of samples of exactly one period, rate · T.

    Raises TrajectoryError when rate · T is no whole number: a table of such a period would jump at its seam.
    """
    count = round(period_s * rate_hz)
    if count < 1 or abs(count - period_s * rate_hz) > 1e-6 * max(1.0, count):
        raise TrajectoryError(
            f"a period of {period_s:g} s holds no whole number of samples at {rate_hz:g} Hz; choose a period that does"
        )
    return count


def fourier_basis(
    time_s: FloatArray, fundamental_frequency_hz: float, harmonics: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Linear maps from (a_1..a_L, b_1..b_L) of one joint to q, q̇, q̈ at the given times, eq. (12).

    time_s: (S,) s. Returns three arrays (S, 2 L): q - offset = Φ c, q̇ = Φ' c, q̈ = Φ'' c with c = (a, b) in rad/s.
    """
    w = 2.0 * np.pi * fundamental_frequency_hz * np.arange(1, harmonics + 1)
    phase = np.multiply.outer(time_s, w)
    sin, cos = np.sin(phase), np.cos(phase)
    position = np.concatenate([sin / w, -cos / w], axis=1)
    velocity = np.concatenate([cos, sin], axis=1)
    acceleration = np.concatenate([-w * sin, w * cos], axis=1)
    return position, velocity, acceleration


@dataclass(frozen=True, slots=True)
class FourierTrajectory(Trajectory):
    """One periodic motion of n joints, eq. (12) with a constant offset per joint.

    q_i(t) = offset_i + Σ_l a_il / (ω l) sin(ω l t) - b_il / (ω l) cos(ω l t), with ω = 2π · fundamental_frequency_hz.
    a, b: (n, L) rad/s; offset: (n,) rad. Raises TrajectoryError on non-finite numbers or shapes that do not fit
    together.
    """

    fundamental_frequency_hz: float
    a: FloatArray
    b: FloatArray
    offset: FloatArray
    robot: str = ""
    record: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._hold("a", "b", "offset")
        if self.a.ndim != 2 or self.a.size == 0 or self.a.shape != self.b.shape:
            raise TrajectoryError(
                f"the fields 'a' and 'b' must be tables of joints × harmonics of equal shape, not {self.a.shape} and "
                f"{self.b.shape}",
                field="a",
            )
        if self.offset.shape != (self.joints,):
            raise TrajectoryError(
                f"the field 'offset' must hold {self.joints} numbers, one for each joint, not {self.offset.shape}",
                field="offset",
            )
        if not (np.isfinite(self.fundamental_frequency_hz) and self.fundamental_frequency_hz > 0.0):
            raise TrajectoryError(
                f"the field 'fundamental_frequency_hz' must be positive, not {self.fundamental_frequency_hz}",
                field="fundamental_frequency_hz",
            )

    @property
    def joints(self) -> int:
        """Number of joints n."""
        return int(self.a.shape[0])

    @property
    def harmonics(self) -> int:
        """Number of harmonics L."""
        return int(self.a.shape[1])

    @property
    def period_s(self) -> float:
        """Length of one period in s."""
        return 1.0 / self.fundamental_frequency_hz

    def evaluate(self, time_s: npt.ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Position, velocity and acceleration at the given times, each (S, n) in rad, rad/s, rad/s²."""
        time = np.atleast_1d(np.asarray(time_s, dtype=np.float64))
        position, velocity, acceleration = fourier_basis(time, self.fundamental_frequency_hz, self.harmonics)
        c = np.concatenate([self.a, self.b], axis=1).T
        return position @ c + self.offset, velocity @ c, acceleration @ c

    def scaled(self, amplitude: float) -> FourierTrajectory:
        """The same path about the same offset with its amplitude multiplied (first runs on a robot go slower so)."""
        check_amplitude(amplitude)
        return replace(self, a=self.a * amplitude, b=self.b * amplitude)

    def numbers(self) -> dict[str, Any]:
        """Kind fourier."""
        return {
            "kind": "fourier",
            "robot": self.robot,
            "fundamental_frequency_hz": self.fundamental_frequency_hz,
            "harmonics": self.harmonics,
            "a": self.a.tolist(),
            "b": self.b.tolist(),
            "offset": self.offset.tolist(),
        }

    @classmethod
    def from_json(cls, document: Mapping[str, Any]) -> FourierTrajectory:
        """Read what `to_json` wrote. Raises TrajectoryError naming the field that is missing or unusable."""
        a = number_table(document, "a")
        harmonics = document.get("harmonics", a.shape[1])
        if harmonics != a.shape[1]:
            raise TrajectoryError(
                f"the field 'harmonics' says {harmonics}, but 'a' has {a.shape[1]} columns", field="harmonics"
            )
        b = number_table(document, "b")
        frequency = number(document, "fundamental_frequency_hz")
        offset = np.zeros(a.shape[0])
        if document.get("offset") is not None:
            offset = number_table(document, "offset", dimensions=1)
        return cls(frequency, a, b, offset, *told_with(document))


def told_with(document: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    """Robot and record of a trajectory file."""
    record = {key: document[key] for key in ("limits", "achieved", "seed", "settings", "note") if key in document}
    return str(document.get("robot", "")), record


def check_amplitude(amplitude: float) -> None:
    """Raises TrajectoryError for an amplitude that is not positive."""
    if not (np.isfinite(amplitude) and amplitude > 0.0):
        raise TrajectoryError(f"the amplitude must be a positive number, not {amplitude}", field="amplitude")


def number(document: Mapping[str, Any], name: str) -> float:
    """The field as a float; raises TrajectoryError where it is missing or no number."""
    value = document.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TrajectoryError(f"the field '{name}' is missing or no number", field=name)
    return float(value)


_AXES = {
    "q": ("row", "joint"),
    "position": ("row", "joint"),
    "a": ("joint", "harmonic"),
    "b": ("joint", "harmonic"),
    "offset": ("joint",),
    "t": ("row",),
}  # what the axes of a field are called in sentences


def number_table(document: Mapping[str, Any], name: str, *, dimensions: int = 2) -> FloatArray:
    """The field as a finite array of the wanted dimensions; raises TrajectoryError naming field and place."""
    if name not in document:
        raise TrajectoryError(f"the field '{name}' is missing", field=name)
    try:
        array = np.array(document[name], dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise TrajectoryError(
            f"the field '{name}' must hold numbers only, in rows of equal length", field=name
        ) from error
    if array.ndim != dimensions or array.size == 0:
        raise TrajectoryError(
            f"the field '{name}' must be an array of {dimensions} dimension(s), not of shape {array.shape}", field=name
        )
    bad = np.argwhere(~np.isfinite(array))
    if len(bad):
        axes = _AXES.get(name, ("place",) * dimensions)
        place = ", ".join(f"{axis} {int(i) + 1}" for axis, i in zip(axes, bad[0], strict=True))
        raise TrajectoryError(f"the field '{name}' holds a number that is not finite at {place}", field=name)
    return array
