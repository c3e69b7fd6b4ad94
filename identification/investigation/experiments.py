"""Motions a robot can be asked for: those a field engineer knows, and random Fourier series. All of one period length.

A purposeful motion moves one joint with a purpose and keeps all others turning slowly, because a joint at rest is held
by its dry friction and takes any torque. Here: the motions as positions of one period. Not here: what they tell
(`separation`) and whether the arm may drive them (preflight, in the daemon).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from identification.arrays import FloatArray
from identification.excitation.fourier import Trajectory, fourier_basis
from identification.excitation.limits import ExcitationLimits
from identification.excitation.trajectory_files import TableTrajectory
from identification.investigation.columns import PLAN_RATE_HZ, states_of_table
from identification.mismatch.settings import DiagnosisSettings

States = tuple[FloatArray, FloatArray, FloatArray]

PERIOD_S = 10.0
_SAMPLES = round(PERIOD_S * PLAN_RATE_HZ)
_TIME = np.arange(_SAMPLES) / PLAN_RATE_HZ
SHARE_OF_LIMITS = 0.85
"""Of each limit that a motion uses: the controller and the start ramp need the rest."""
_LARGEST_ACCELERATION, _LARGEST_JERK = 8.0, 80.0
"""rad/s² and rad/s³: nobody states them for the arm (docs/limits.md), so that motions keep to what its drives like."""
_HARMONICS = 5
_CORNER_S = 0.25
"""Length over which a change of speed is spread: the arm's drives ask for that."""
_LAST_HARMONIC = int(DiagnosisSettings().motion_bandwidth_hz * PERIOD_S)
"""Of a period, up to which a recorded motion is read: acceleration beyond it leaves torque that nothing explains."""
_DITHER_RAD, _DITHER_TURNS = 0.06, (1, 2, 3)


@dataclass(frozen=True, slots=True, eq=False)
class Experiment:
    """One motion to choose from. kind: of `KINDS`. joint: from 1, whose purpose it is; None: all. purpose: in words."""

    kind: str
    joint: int | None
    purpose: str
    table: FloatArray

    @property
    def states(self) -> States:
        """Position, velocity and acceleration (S, n) of one period at PLAN_RATE_HZ."""
        return states_of_table(self.table, PERIOD_S)

    def trajectory(self, robot: str) -> Trajectory:
        """What `run` and `check` take."""
        return TableTrajectory(self.table, PLAN_RATE_HZ, robot)


@dataclass(frozen=True, slots=True, eq=False)
class Room:
    """Where motions may be: limits of the joints, and a pose (n,) rad about which the arm is known to be free."""

    limits: ExcitationLimits
    centre: FloatArray
    spread: float = 0.4
    """rad, by which the pose of a motion is varied."""

    def pose(self, random: np.random.Generator) -> FloatArray:
        """A pose near the centre that leaves a third of the position range on both sides where there is as much."""
        pose = self.centre + random.uniform(-self.spread, self.spread, self.centre.size)
        low, high = self.limits.position_lower, self.limits.position_upper
        third = (high - low) / 3.0
        return np.clip(pose, low + third, high - third)


def _fourier(random: np.random.Generator, room: Room, _joint: int | None = None) -> FloatArray:
    """A random series on all joints."""
    n = room.centre.size
    decay = np.arange(1, _HARMONICS + 1) ** float(random.uniform(-0.5, 1.0))
    shape = random.normal(size=(n, 2, _HARMONICS)) * decay
    basis = fourier_basis(_TIME, 1.0 / PERIOD_S, _HARMONICS)[0]
    return room.pose(random) + basis @ shape.reshape(n, -1).T


def _alone(random: np.random.Generator, room: Room, joint: int | None) -> FloatArray:
    """One joint over its whole range at many speeds."""
    series = _fourier(random, room)
    return _beside(random, room, joint, series[:, joint or 0] - series[:, joint or 0].mean(), largest=True)


def _sweep(random: np.random.Generator, room: Room, joint: int | None) -> FloatArray:
    """Constant speed both ways: slow as a joint of that range goes in one period, or slower."""
    return _beside(random, room, joint, _forth_and_back(0.25 * PERIOD_S * random.uniform(0.01, 0.25), [(1.0, 1)]))


def _two_speeds(random: np.random.Generator, room: Room, joint: int | None) -> FloatArray:
    """The same path forth and back, once slowly and several times fast."""
    half_width, slow_share = random.uniform(0.05, 0.5), random.uniform(0.5, 0.75)
    # Within a corner there is no way: a leg that is shorter would not reach the ends of the path.
    fast = int(random.integers(2, min(8, int((1.0 - slow_share) * PERIOD_S / (2.0 * _CORNER_S))) + 1))
    path = _forth_and_back(half_width, [(slow_share, 1), (1.0 - slow_share, fast)])
    return _beside(random, room, joint, path)


def _reversals(random: np.random.Generator, room: Room, joint: int | None) -> FloatArray:
    """Small motions that turn round often, carried slowly along the joint's range."""
    turns = int(random.integers(6, 16))
    small = random.uniform(0.004, 0.06) * np.sin(2.0 * np.pi * turns * _TIME / PERIOD_S)
    carried = random.uniform(0.0, 0.5) * np.sin(2.0 * np.pi * _TIME / PERIOD_S)
    return _beside(random, room, joint, small + carried)


def _loads(random: np.random.Generator, room: Room, joint: int | None) -> FloatArray:
    """One joint forth and back quickly while all others carry it slowly through different loads."""
    turns = int(random.integers(3, 9))
    table = _beside(random, room, joint, random.uniform(0.05, 0.4) * np.sin(2.0 * np.pi * turns * _TIME / PERIOD_S))
    for other in range(table.shape[1]):
        if other != joint:
            table[:, other] += random.uniform(0.2, 0.9) * np.sin(2.0 * np.pi * (_TIME / PERIOD_S + random.uniform()))
    return table


def _range(random: np.random.Generator, room: Room, joint: int | None) -> FloatArray:
    """One joint once slowly through as much of its range as there is."""
    return _beside(random, room, joint, np.sin(2.0 * np.pi * _TIME / PERIOD_S), largest=True)


KINDS: dict[str, tuple[Callable[[np.random.Generator, Room, int | None], FloatArray], str]] = {
    "fourier": (_fourier, "all joints at once at many speeds"),
    "one_joint": (_alone, "joint {joint} alone at many speeds, the others turning slowly"),
    "slow_sweep": (_sweep, "joint {joint} at a constant low speed, both ways"),
    "two_speeds": (_two_speeds, "joint {joint} along the same path slowly and fast: distance against speed"),
    "reversals": (_reversals, "joint {joint} turning round often in small motions"),
    "loads": (_loads, "joint {joint} forth and back while the others change what it carries"),
    "whole_range": (_range, "joint {joint} slowly through its whole range"),
}
"""What may be asked for: how it is drawn, and its purpose in words."""


def experiments(random: np.random.Generator, room: Room, joints: Sequence[int]) -> Iterator[Experiment]:
    """Motions without end, each kind and each of the joints (from 0) in turn, all within the limits."""
    kinds = list(KINDS)
    while True:
        for kind in kinds:
            for joint in joints if kind != "fourier" and joints else (None,):
                yield experiment(random, room, kind, joint)


def experiment(random: np.random.Generator, room: Room, kind: str, joint: int | None) -> Experiment:
    """One motion of a kind, within the limits. joint: from 0."""
    draw, purpose = KINDS[kind]
    table = within_limits(draw(random, room, joint), room.limits)
    number = None if joint is None else joint + 1
    return Experiment(kind, number, purpose.format(joint=number), table)


def within_limits(table: FloatArray, limits: ExcitationLimits) -> FloatArray:
    """The same motion with each joint's excursion about its middle made as small as its limits ask. table: (S, n)."""
    middle = 0.5 * (table.max(axis=0) + table.min(axis=0))
    middle = np.clip(middle, 0.6 * limits.position_lower, 0.6 * limits.position_upper)
    way = table - 0.5 * (table.max(axis=0) + table.min(axis=0))
    _, velocity, acceleration = states_of_table(way, PERIOD_S)
    reach = np.minimum(limits.position_upper - middle, middle - limits.position_lower)
    largest = np.minimum(limits.acceleration, _LARGEST_ACCELERATION)
    shares = [
        SHARE_OF_LIMITS * allowed / np.maximum(np.abs(values).max(axis=0), 1e-9)
        for allowed, values in (
            (reach, way),
            (limits.velocity, velocity),
            (largest, acceleration),
            (np.full(reach.size, _LARGEST_JERK), np.gradient(acceleration, 1.0 / PLAN_RATE_HZ, axis=0)),
        )
    ]
    return np.asarray(middle + way * np.minimum(1.0, np.minimum.reduce(shares)))


def varied(random: np.random.Generator, room: Room, one: Experiment, step: float) -> Experiment:
    """A motion near another one: every joint's excursion a little larger or smaller, its middle moved, waves added."""
    n = one.table.shape[1]
    middle = one.table.mean(axis=0)
    way = (one.table - middle) * np.exp(step * random.normal(size=n))
    waves = fourier_basis(_TIME, 1.0 / PERIOD_S, _HARMONICS)[0] @ random.normal(size=(2 * _HARMONICS, n))
    moved = [one.joint - 1] if one.joint is not None else range(n)
    size = np.zeros(n)
    size[moved] = 0.3 * step if one.kind in ("fourier", "one_joint") else 0.0
    table = middle + 0.5 * step * random.normal(size=n) + way + size * waves
    return Experiment(one.kind, one.joint, one.purpose, within_limits(table, room.limits))


def _beside(
    random: np.random.Generator, room: Room, joint: int | None, way: FloatArray, *, largest: bool = False
) -> FloatArray:
    """One joint along `way` (S,) rad about a pose, the others turning slowly. largest: as far as its range lets it."""
    table = np.tile(room.pose(random), (_SAMPLES, 1))
    for other in range(table.shape[1]):
        turns = random.choice(_DITHER_TURNS)
        phase = random.uniform(0.0, 2.0 * np.pi)
        table[:, other] += _DITHER_RAD * np.sin(2.0 * np.pi * turns * _TIME / PERIOD_S + phase)
    if joint is not None:
        reach = room.limits.position_upper[joint] - room.limits.position_lower[joint]
        factor = 0.5 * reach / np.abs(way).max() if largest else 1.0
        table[:, joint] = table[:, joint].mean() + factor * way
    return table


def _forth_and_back(half_width: float, legs: Sequence[tuple[float, int]]) -> FloatArray:
    """(S,) rad: legs of (share of the period, times forth and back) at constant speed, corners rounded."""
    velocity = np.zeros(_SAMPLES)
    start = 0
    for share, turns in legs:
        count = round(share * _SAMPLES)
        stop = min(_SAMPLES, start + count)
        phase = (np.arange(stop - start) + 0.5) / max(1, count) * turns
        velocity[start:stop] = np.where(phase % 1.0 < 0.5, 1.0, -1.0) * 4.0 * half_width * turns / (share * PERIOD_S)
        start = stop
    width = round(_CORNER_S * PLAN_RATE_HZ)
    window = np.hanning(width + 2)[1:-1]
    kernel = np.zeros(_SAMPLES)
    kernel[:width] = window / window.sum()
    spectrum = np.fft.rfft(velocity) * np.fft.rfft(np.roll(kernel, -(width // 2)))
    spectrum[_LAST_HARMONIC + 1 :] = 0.0
    smooth = np.fft.irfft(spectrum, _SAMPLES)
    position = np.cumsum(smooth - smooth.mean()) / PLAN_RATE_HZ
    return np.asarray(position - position.mean())
