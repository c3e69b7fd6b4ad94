"""Friction over a series of recordings of one arm: its numbers by date, and whether and when it changed at once.

Each recording is fitted alone. A joint's friction at its usual speed, FS + FV |q̇|, is one number that both parts of it
make, so that they cannot trade. A change point is one step against none: both by their evidence, with the scatter
between runs unknown. Pure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from identification.audit.between import fitted_to
from identification.errors import RecordingError
from identification.fitting.result import FitResult
from identification.recordings.recording import Recording
from identification.robots.model import RobotModel

__all__ = [
    "LEAST",
    "ChangePoint",
    "JointTrend",
    "Trend",
    "change_point",
    "date_of",
    "hours_of",
    "trend_of",
    "with_hours",
]

FloatArray = npt.NDArray[np.float64]

LEAST = 4
"""Recordings that make a series."""
ODDS_SAID = 20.0
STEP_WIDTH = 0.5
"""Of the friction's size: what a step may be, one standard deviation."""
SCATTERS = np.geomspace(0.005, 0.3, 25)
"""Of the friction's size, from run to run; all alike likely."""


@dataclass(frozen=True, slots=True)
class ChangePoint:
    """A step before the recording `at` (from 0). odds: of a step against none. size: Nm with its deviation."""

    at: int
    odds: float
    size: float
    std: float


@dataclass(frozen=True, slots=True, eq=False)
class JointTrend:
    """One joint (from 1). friction, std: (r,) Nm at `speed` rad/s; temperature: (r,) °C, nan where not known."""

    joint: int
    speed: float
    friction: FloatArray
    std: FloatArray
    temperature: FloatArray
    change: ChangePoint

    def sentence(self, names: Sequence[str]) -> str:
        """What an operator reads."""
        change = self.change
        mean = float(self.friction.mean())
        if change.odds < ODDS_SAID:
            return (
                f"Joint {self.joint}: friction {mean:.3g} Nm at {self.speed:.2g} rad/s, no change at once (odds of one "
                f"{change.odds:.2g} : 1)."
            )
        return (
            f"Joint {self.joint}: friction changed by {change.size:+.3g} ± {1.96 * change.std:.2g} Nm at "
            f"{self.speed:.2g} rad/s before {names[change.at]} (odds {min(change.odds, 1e6):.0f} : 1)."
        )


@dataclass(frozen=True, slots=True, eq=False)
class Trend:
    """names: of the recordings by date. dates: where known, else None for all. hours: of operation of the arm, alike.
    joints: their friction.
    """

    names: tuple[str, ...]
    dates: tuple[datetime, ...] | None
    hours: tuple[float, ...] | None
    joints: tuple[JointTrend, ...]

    @property
    def sentences(self) -> tuple[str, ...]:
        """One a joint."""
        return tuple(item.sentence(self.names) for item in self.joints)

    def to_json(self) -> dict[str, Any]:
        """As plain JSON types."""
        return {
            "recordings": list(self.names),
            "dates": None if self.dates is None else [date.isoformat() for date in self.dates],
            "operating_hours": None if self.hours is None else list(self.hours),
            "joints": [
                {
                    "joint": item.joint,
                    "speed_rad_s": item.speed,
                    "friction_nm": item.friction.tolist(),
                    "std_nm": item.std.tolist(),
                    "temperature_c": [float(v) if np.isfinite(v) else None for v in item.temperature],
                    "change": {"before": self.names[item.change.at], "odds": item.change.odds,
                               "size_nm": item.change.size, "std_nm": item.change.std},
                    "sentence": item.sentence(self.names),
                }
                for item in self.joints
            ],
        }  # fmt: skip


def date_of(recording: Recording) -> datetime | None:
    """When a run was made: by its identifier (20261121T103000123Z), or metadata `date` (ISO 8601); else None."""
    tags = recording.source.metadata
    for text, form in ((tags.get("run_id", "")[:15], "%Y%m%dT%H%M%S"), (tags.get("date", "")[:19], "")):
        try:
            date = datetime.strptime(text, form) if form else datetime.fromisoformat(text)
        except ValueError:
            continue
        return date.replace(tzinfo=UTC)
    return None


def with_hours(recordings: Sequence[Recording], hours: Sequence[float]) -> list[Recording]:
    """The recordings with hours of operation as read off the arm. Raises RecordingError where one is left over."""
    if len(hours) != len(recordings):
        raise RecordingError(f"{len(hours)} hours of operation are given for {len(recordings)} recordings.")
    return [
        replace(item, source=replace(item.source, metadata={**item.source.metadata, "operating_hours": repr(each)}))
        for item, each in zip(recordings, hours, strict=True)
    ]


def hours_of(recording: Recording) -> float | None:
    """Hours of operation of the arm when it was recorded: metadata `operating_hours`, as the cabinet shows them."""
    try:
        hours = float(recording.source.metadata.get("operating_hours", ""))
    except ValueError:
        return None
    return hours if np.isfinite(hours) and hours >= 0.0 else None


def trend_of(recordings: Sequence[Recording], robot: RobotModel) -> Trend:
    """The friction of a series, by its dates where every recording has one, else by hours of operation, else as given.

    Raises RecordingError for fewer than LEAST recordings, and the errors of a fit.
    """
    if len(recordings) < LEAST:
        raise RecordingError(f"A trend needs {LEAST} recordings or more, not {len(recordings)}.")
    dates = [date_of(item) for item in recordings]
    known = [date for date in dates if date is not None]
    if len(known) == len(recordings):
        order = sorted(range(len(recordings)), key=lambda place: known[place])
        recordings, known = [recordings[place] for place in order], [known[place] for place in order]
    hours = _hours(recordings)
    if hours is not None and len(known) < len(recordings):
        recordings = [recordings[place] for place in np.argsort(hours, kind="stable")]
        hours = _hours(recordings)
    fits = [fitted_to(item, robot) for item in recordings]
    joints = []
    for joint in range(1, robot.n + 1):
        speed = float(np.mean([_usual_speed(item, joint) for item in recordings]))
        pairs = [_friction_at(fit, joint, speed) for fit in fits]
        friction, std = np.array([pair[0] for pair in pairs]), np.array([pair[1] for pair in pairs])
        heat = np.array([_temperature(item, joint) for item in recordings])
        joints.append(JointTrend(joint, speed, friction, std, heat, change_point(friction, std)))
    names = _names(recordings)
    return Trend(names, tuple(known) if len(known) == len(recordings) else None, hours, tuple(joints))


def _hours(recordings: Sequence[Recording]) -> tuple[float, ...] | None:
    """Of every recording, None where one does not say."""
    found = [hours for hours in map(hours_of, recordings) if hours is not None]
    return tuple(found) if len(found) == len(recordings) else None


def change_point(values: FloatArray, std: FloatArray) -> ChangePoint:
    """One step in a series (r,) with deviations (r,), and the odds of it against none, all places alike likely.

    values = mean + step · [from `at` on] + scatter between runs + error; mean and step Gaussian, scatter summed over.
    """
    size = max(float(np.abs(values).mean()), 1e-12)
    count = len(values)
    evidence = np.empty((count, len(SCATTERS)))
    estimates = np.empty((count, len(SCATTERS), 2))
    for at in range(count):  # 0: no step
        step = (np.arange(count) >= at).astype(float) if at else np.zeros(count)
        for place, scatter in enumerate(SCATTERS * size):
            noise = np.diag(std**2 + scatter**2)
            shape = (STEP_WIDTH * size) ** 2 * np.outer(step, step)
            whole = noise + (3.0 * size) ** 2 + shape
            solved = np.linalg.solve(whole, values)
            evidence[at, place] = -0.5 * values @ solved - 0.5 * np.linalg.slogdet(whole)[1]
            gain = (STEP_WIDTH * size) ** 2 * step
            estimates[at, place] = (
                gain @ solved,
                (STEP_WIDTH * size) ** 2 - gain @ np.linalg.solve(whole, gain),
            )
    top = float(evidence.max())
    likely = np.exp(evidence - top).mean(axis=1)
    at = 1 + int(np.argmax(likely[1:]))
    odds = float(likely[1:].mean() / max(float(likely[0]), 1e-300))
    weight = np.exp(evidence[at] - evidence[at].max())
    weight /= weight.sum()
    mean = float(weight @ estimates[at, :, 0])
    variance = float(weight @ (estimates[at, :, 1] + (estimates[at, :, 0] - mean) ** 2))
    return ChangePoint(at, odds, mean, float(np.sqrt(max(variance, 0.0))))


def _friction_at(fit: FitResult, joint: int, speed: float) -> tuple[float, float]:
    """FS + FV |q̇| in Nm and its deviation."""
    direction = np.zeros(len(fit.names))
    for symbol, share in (("FV", speed), ("FS", 1.0)):
        name = f"{symbol}_{joint}"
        if name in fit.names:
            direction[fit.names.index(name)] = share
    variance = float(direction @ fit.least_squares.covariance @ direction)
    return float(direction @ fit.values), float(np.sqrt(max(variance, 0.0)))


def _usual_speed(recording: Recording, joint: int) -> float:
    speed = np.abs(np.gradient(recording.position[:, joint - 1], recording.time))
    return float(np.median(speed[speed > 0.01])) if (speed > 0.01).any() else 0.1


def _temperature(recording: Recording, joint: int) -> float:
    if recording.temperature is None or not np.isfinite(recording.temperature[:, joint - 1]).any():
        return float("nan")
    return float(np.nanmean(recording.temperature[:, joint - 1]))


def _names(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """File names, with their folder where the file's alone would not tell them apart."""
    paths = [Path(item.source.path) for item in recordings]
    short = [path.name for path in paths]
    return tuple(short if len(set(short)) == len(short) else ["/".join(path.parts[-2:]) for path in paths])
