"""Friction over a series of recordings of one arm: its numbers by date, and whether and when it changed at once.

Each recording is fitted alone. A joint's friction at its usual speed, FS + FV |q̇|, is one number that both parts of it
make, so that they cannot trade. A change point is one step against none and against a steady drift: all by their
evidence, with the scatter between runs unknown. Pure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import permutations
from typing import Any

import numpy as np

from identification.arrays import FloatArray
from identification.audit.between import fitted_to
from identification.base_parameters import direction_of, width_of
from identification.errors import RecordingError
from identification.fitting.result import FitResult
from identification.json_values import json_list
from identification.recordings.independence import EARLIEST_CLOCK_S, recording_names
from identification.recordings.recording import Recording
from identification.robots.joint_units import in_units
from identification.robots.model import RobotModel

LEAST = 4
"""Recordings that make a series."""
ODDS_SAID = 20.0
STEP_WIDTH = 0.5
"""Of the friction's size: what a step may be, one standard deviation."""
SCATTERS = np.geomspace(0.005, 0.3, 25)
"""Of the friction's size, from run to run; all alike likely."""


@dataclass(frozen=True, slots=True)
class ChangePoint:
    """A step before the recording `at` (from 0). odds: of a step against none or a steady drift, whichever is likelier.
    size: Nm with its deviation. drift: Nm from the first recording to the last, alike, were it one.
    """

    at: int
    odds: float
    size: float
    std: float
    drift: float
    drift_std: float
    drift_odds: float


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
        if change.drift_odds >= ODDS_SAID:
            return (
                f"Joint {self.joint}: friction drifts from recording to recording, by {change.drift:+.3g} ± "
                f"{1.96 * change.drift_std:.2g} Nm in all at {self.speed:.2g} rad/s, rather than at once "
                f"(odds {min(change.drift_odds, 1e6):.0f} : 1)."
            )
        if change.odds < ODDS_SAID:
            sure = f" that is sure, which takes {ODDS_SAID:.0f} : 1" if change.odds > 1.0 else ""
            return (
                f"Joint {self.joint}: friction {mean:.3g} Nm at {self.speed:.2g} rad/s, no change at once{sure} (odds "
                f"of one {change.odds:.2g} : 1)."
            )
        return (
            f"Joint {self.joint}: friction changed by {change.size:+.3g} ± {1.96 * change.std:.2g} Nm at "
            f"{self.speed:.2g} rad/s before {names[change.at]} (odds {min(change.odds, 1e6):.0f} : 1)."
        )


@dataclass(frozen=True, slots=True, eq=False)
class Trend:
    """names: of the recordings by date. dates: where known, else None for all. hours: of operation of the arm, alike.
    joints: their friction. arms: serial numbers, as far as the logs say. units: of each joint's torque; empty: all Nm.
    """

    names: tuple[str, ...]
    dates: tuple[datetime, ...] | None
    hours: tuple[float, ...] | None
    joints: tuple[JointTrend, ...]
    arms: tuple[str, ...] = ()
    units: tuple[str, ...] = ()

    @property
    def sentences(self) -> tuple[str, ...]:
        """One a joint, after a warning where they are of several arms."""
        several = (
            f"These are recordings of {len(self.arms)} arms (serial numbers {', '.join(self.arms)}): a difference "
            "between two of them is no change of one.",
        )
        return (*several[: len(self.arms) > 1], *map(self._sentence, self.joints))

    def _sentence(self, item: JointTrend) -> str:
        return in_units(item.sentence(self.names), self.units)

    def to_json(self) -> dict[str, Any]:
        """As plain JSON types."""
        return {
            "recordings": list(self.names),
            "dates": None if self.dates is None else [date.isoformat() for date in self.dates],
            "operating_hours": None if self.hours is None else list(self.hours),
            "arms": list(self.arms),
            "joints": [
                {
                    "joint": item.joint,
                    "speed_rad_s": item.speed,
                    "friction_nm": item.friction.tolist(),
                    "std_nm": item.std.tolist(),
                    "temperature_c": json_list(item.temperature),
                    "change": {"before": self.names[item.change.at], "odds": item.change.odds,
                               "size_nm": item.change.size, "std_nm": item.change.std},
                    "drift": {"odds": item.change.drift_odds, "size_nm": item.change.drift,
                              "std_nm": item.change.drift_std},
                    "sentence": self._sentence(item),
                }
                for item in self.joints
            ],
        }  # fmt: skip


def date_of(recording: Recording) -> datetime | None:
    """When a run was made: by its identifier (20261121T103000123Z), or metadata `date` (ISO 8601; of a ROS bag its
    recorder's start); else None, as where it is that of a clock which was never set.

    A date without a zone is taken as UTC.
    """
    tags = recording.source.metadata
    date = tags.get("date", "")
    # What stands behind the seconds and is no zone, such as a remark, is left aside.
    for text, form in ((tags.get("run_id", "")[:15], "%Y%m%dT%H%M%S"), (date, ""), (date[:19], "")):
        try:
            found = datetime.strptime(text, form) if form else datetime.fromisoformat(text)
            found = found.replace(tzinfo=UTC) if found.tzinfo is None else found.astimezone(UTC)
        except (ValueError, OverflowError):
            continue
        return found if found.timestamp() > EARLIEST_CLOCK_S else None
    return None


def with_hours(recordings: Sequence[Recording], hours: Sequence[float]) -> list[Recording]:
    """The recordings with hours of operation as read off the arm.

    Raises RecordingError where one is left over, and where those of one arm fall from one date to a later one. Equal
    ones are taken: the counter shows whole hours.
    """
    if len(hours) != len(recordings):
        raise RecordingError(f"{len(hours)} hours of operation are given for {len(recordings)} recordings.")
    names, dates = recording_names(recordings), [date_of(item) for item in recordings]
    for one, other in permutations(range(len(recordings)), 2):
        before, after = dates[one], dates[other]
        arms = {recordings[place].source.metadata.get("serial", "") for place in (one, other)}
        if before and after and before < after and hours[other] < hours[one] and len(arms) == 1:
            raise RecordingError(
                f"An arm's hours of operation do not fall: {hours[one]:g} are given for {names[one]}, and "
                f"{hours[other]:g} for {names[other]}, which is of a later date ({after:%Y-%m-%d}). Give them in the "
                "order of the recordings."
            )
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
    arms = {item.source.metadata.get("serial", "") for item in recordings} - {""}
    dated = tuple(known) if len(known) == len(recordings) else None
    return Trend(tuple(recording_names(recordings)), dated, hours, tuple(joints), tuple(sorted(arms)), robot.units)


def _hours(recordings: Sequence[Recording]) -> tuple[float, ...] | None:
    """Of every recording, None where one does not say."""
    found = [hours for hours in map(hours_of, recordings) if hours is not None]
    return tuple(found) if len(found) == len(recordings) else None


def change_point(values: FloatArray, std: FloatArray) -> ChangePoint:
    """One step in a series (r,) with deviations (r,), its odds against none, all places alike likely, and a drift's.

    values = mean + change · shape + scatter between runs + error; mean and change Gaussian, scatter summed over. shape:
    nothing, a line from the first recording to the last, or 1 from `at` on. What has worn in is no step of its middle.
    """
    size = max(float(np.abs(values).mean()), 1e-12)
    count = len(values)
    steps = np.arange(count) >= np.arange(1, count)[:, None]
    shapes = np.vstack([np.zeros(count), np.linspace(0.0, 1.0, count), steps])
    variance = (STEP_WIDTH * size) ** 2
    # Covariances (shapes, scatters, r, r) of the values, and the values and each shape divided by them.
    by_scatter = (3.0 * size) ** 2 + (std**2 + (SCATTERS[:, None] * size) ** 2)[..., None] * np.eye(count)
    whole = by_scatter + variance * (shapes[:, :, None] * shapes[:, None])[:, None]
    solved = np.linalg.solve(whole, np.stack(np.broadcast_arrays(values, shapes), axis=2)[:, None])
    evidence = -0.5 * solved[..., 0] @ values - 0.5 * np.linalg.slogdet(whole)[1]
    along = np.einsum("sr,scrk->sck", shapes, solved)
    estimates = np.stack([variance * along[..., 0], variance - variance**2 * along[..., 1]], axis=2)
    likely = np.exp(evidence - float(evidence.max())).mean(axis=1)
    none, drifting, stepping = float(likely[0]), float(likely[1]), float(likely[2:].mean())
    at = 1 + int(np.argmax(likely[2:]))
    step, line = (_mean_over_scatters(evidence[row], estimates[row]) for row in (1 + at, 1))
    odds, drift_odds = stepping / max(none, drifting, 1e-300), drifting / max(none, stepping, 1e-300)
    return ChangePoint(at, odds, *step, *line, drift_odds)


def _mean_over_scatters(evidence: FloatArray, estimates: FloatArray) -> tuple[float, float]:
    """A change's value and deviation, of its estimates (scatters, 2) under each scatter: value and variance."""
    weight = np.exp(evidence - evidence.max())
    weight /= weight.sum()
    mean = float(weight @ estimates[:, 0])
    variance = float(weight @ (estimates[:, 1] + (estimates[:, 0] - mean) ** 2))
    return mean, float(np.sqrt(max(variance, 0.0)))


def _friction_at(fit: FitResult, joint: int, speed: float) -> tuple[float, float]:
    """FS + FV |q̇| in Nm and its deviation, of FS what has turned over at that speed."""
    direction = np.zeros(len(fit.names))
    turned_over = float(direction_of(np.array(speed), width_of(fit.regressor.options.coulomb_velocity, joint - 1)))
    for symbol, share in (("FV", speed), ("FS", turned_over)):
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
