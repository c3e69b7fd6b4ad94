"""A motion as the classes of dependence see it: every input as a share of the range that some motions reached.

Here: ranges, and what is computed once for all classes of a motion. Not here: the functions of it (`classes`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.effects.dynamics import bending_moments, rigid_torque
from identification.mismatch.motion import Motion
from identification.mismatch.unknown.functions import fade, responses, smooth_table, tabulated

WAVES = 48
"""Random waves over the configuration, of about a half range of each joint."""


@dataclass(frozen=True, slots=True)
class Ranges:
    """What some motions reached, (n,) each: position in rad (m), speed, load and torque in Nm, acceleration.

    load: torque of the rigid links. torque: largest nominal torque, friction and all. bending: (n, 2) largest moment
    about the two directions across each joint's axis (`bending_moments`), Nm.
    """

    position_lower: FloatArray
    position_upper: FloatArray
    speed: FloatArray
    load_lower: FloatArray
    load_upper: FloatArray
    acceleration: FloatArray
    torque: FloatArray
    bending: FloatArray

    @classmethod
    def of(cls, motions: Sequence[Motion]) -> Ranges:
        """The ranges of several motions together."""
        position, velocity, acceleration, torque = (
            np.concatenate([getattr(motion, name) for motion in motions])
            for name in ("position", "velocity", "acceleration", "torque")
        )
        load = np.concatenate([rigid_torque(motion).torque for motion in motions])
        return cls(
            position.min(axis=0), position.max(axis=0), np.abs(velocity).max(axis=0),
            load.min(axis=0), load.max(axis=0), np.abs(acceleration).max(axis=0), np.abs(torque).max(axis=0),
            np.max([np.abs(bending_moments(motion)[..., 0]).max(axis=0) for motion in motions], axis=0),
        )  # fmt: skip

    def bounds(self, name: str) -> tuple[FloatArray, FloatArray]:
        """Least and largest (n,) of one input: "position", "velocity", "acceleration", "load" or "torque"."""
        if name in ("position", "load"):
            return getattr(self, f"{name}_lower"), getattr(self, f"{name}_upper")
        largest = {"velocity": self.speed, "acceleration": self.acceleration, "torque": self.torque}[name]
        return -largest, largest

    def to_json(self) -> dict[str, list[float]]:
        """Plain JSON types."""
        return {name: getattr(self, name).tolist() for name in self.__slots__}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Ranges:
        """The ranges that `to_json` wrote."""
        return cls(**{name: np.array(data[name], dtype=np.float64) for name in cls.__slots__})


def random_waves(joints: int) -> tuple[FloatArray, FloatArray]:
    """Wave numbers (n, WAVES) and phases (WAVES,). What a generator draws may differ from one version of NumPy to
    another, so a model that is kept holds them.
    """
    if joints == 1:
        return np.zeros((1, 0)), np.zeros(0)
    random = np.random.default_rng(12)
    return random.normal(size=(joints, WAVES)), random.uniform(0, 2 * np.pi, WAVES)


@dataclass(frozen=True, eq=False)
class Inputs:
    """A motion seen through ranges: every input is −1 … 1 within them. Not slotted: what is asked is kept.

    fade_width: distance beyond the limits, in half of them, over which functions fade to zero. limits: ranges beyond
    which they do; None: nowhere. wave_numbers: of `waves`; None: those of `random_waves`.
    """

    motion: Motion
    ranges: Ranges
    fade_width: float
    limits: Ranges | None = None
    wave_numbers: tuple[FloatArray, FloatArray] | None = None

    @cached_property
    def position(self) -> FloatArray:
        """(S, n) position."""
        return self._scaled("position", self.ranges)

    @cached_property
    def velocity(self) -> FloatArray:
        """(S, n) velocity over the largest speed."""
        return self._scaled("velocity", self.ranges)

    @cached_property
    def acceleration(self) -> FloatArray:
        """(S, n) acceleration over the largest."""
        return self._scaled("acceleration", self.ranges)

    @cached_property
    def load(self) -> FloatArray:
        """(S, n) torque of the rigid links: friction, which turns round with the motion, is no load."""
        return self._scaled("load", self.ranges)

    @cached_property
    def torque(self) -> FloatArray:
        """(S, n) nominal torque over the largest."""
        return self._scaled("torque", self.ranges)

    @cached_property
    def direction(self) -> FloatArray:
        """(S, n) direction of motion, as the nominal Coulomb friction has it."""
        return self.motion.direction

    def inside(self, name: str) -> FloatArray:
        """(S, n) 1 where an input is within its limits, fading to 0 beyond."""
        if self.limits is None:
            return np.ones((self.motion.samples, self.motion.n))
        if name not in self._faded:
            self._faded[name] = fade(self._scaled(name, self.limits), self.fade_width)
        return self._faded[name]

    @cached_property
    def _faded(self) -> dict[str, FloatArray]:
        return {}

    def smooth(self, name: str, joint: int, length: float, most: int) -> FloatArray:
        """(m ≤ most, S) smooth functions of an input of a joint, `smooth_table` of this length without a trend."""
        key = name, joint, length, most
        if key not in self._smooth:
            values = tabulated(smooth_table(length, most, ()), getattr(self, name)[:, joint])
            self._smooth[key] = np.ascontiguousarray(values.T)
        return self._smooth[key]

    @cached_property
    def _smooth(self) -> dict[tuple[str, int, float, int], FloatArray]:
        return {}

    def late(self, values: FloatArray, lags_s: FloatArray, poles: int = 1) -> FloatArray:
        """(S, m · lags · poles) what values (S, m) lack where they are followed late (`responses`)."""
        step, periodic = self.motion.sampling_period_s, self.motion.periodic
        lacking = partial(
            responses,
            step_s=step,
            periodic=periodic,
            lags_s=lags_s,
            resonances_hz=np.zeros(0),
            damping=1.0,
            poles=poles,
        )
        return np.concatenate([lacking(value) for value in values.T], axis=1)

    @cached_property
    def all_inside(self) -> FloatArray:
        """(S,) 1 where all positions are."""
        return np.asarray(self.inside("position").prod(axis=1))

    def _scaled(self, name: str, ranges: Ranges) -> FloatArray:
        lower, upper = ranges.bounds(name)
        half = 0.5 * (upper - lower)
        values = rigid_torque(self.motion).torque if name == "load" else getattr(self.motion, name)
        return np.asarray((values - 0.5 * (lower + upper)) / np.where(half > 1e-9, half, np.inf))

    @cached_property
    def waves(self) -> FloatArray:
        """(S, WAVES) random waves over the configuration, always the same ones; none where one joint is all of it."""
        direction, phase = self.wave_numbers or random_waves(self.motion.n)
        if not phase.size:
            return np.zeros((self.motion.samples, 0))
        return np.asarray(np.cos(np.clip(self.position, -1.0, 1.0) @ direction + phase))

    @cached_property
    def moments(self) -> FloatArray:
        """(S, n, 2) bending moments across the joints, Nm."""
        return np.ascontiguousarray(bending_moments(self.motion)[..., 0])


class Along(Inputs):
    """One input of one joint running over the fitted range, all others in the middle, every joint moving forward.

    place: (samples,) where it runs, rad (m), rad/s (m/s) or Nm (N).
    """

    place: FloatArray

    def __init__(self, like: Inputs, fitted: Ranges, joint: int, coordinate: str, samples: int) -> None:
        super().__init__(like.motion, like.ranges, like.fade_width)
        (lower, upper), (first, last) = like.ranges.bounds(coordinate), fitted.bounds(coordinate)
        place = np.linspace(first[joint], last[joint], samples)
        middle = np.zeros((samples, like.motion.n))
        running = middle.copy()
        running[:, joint] = (2.0 * place - lower[joint] - upper[joint]) / max(upper[joint] - lower[joint], 1e-9)
        for name in ("position", "velocity", "load", "torque"):
            self.__dict__[name] = running if name == coordinate else middle
        self.__dict__["direction"] = np.sign(running) if coordinate == "velocity" else np.ones_like(middle)
        object.__setattr__(self, "place", place)

    def late(self, values: FloatArray, lags_s: FloatArray, poles: int = 1) -> FloatArray:
        """Nothing: it runs slowly."""
        return np.zeros((len(values), values.shape[1] * lags_s.size * poles))

    def inside(self, name: str) -> FloatArray:
        """1 everywhere: it stays within the fitted range."""
        del name
        return np.ones_like(self.position)
