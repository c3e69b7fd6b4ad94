"""The difference between a run and a model while the arm still moves: torque minus model, and how large beside noise.

Position and torque of a frame are means over the same 10 ms, so both sides are smoothed alike; velocity and
acceleration are differences over three frames. The noise of a joint comes from one period against the one before at the
same place, the misfit from the difference to the model; a ratio of 1 says that nothing but noise is left.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from daemon.live.frame import LiveFrame
from daemon.motion.torque_foresight import TorqueForesight
from identification.arrays import FloatArray

WIDEST_S = 0.06
"""Frames of a stretch with lost messages are farther apart; no acceleration is taken over it."""
LEAST_SHARE = 0.25
"""Of a period that must have been seen twice before the noise of a joint is said."""
REMARKABLE = 3.0
SETTLES_S = 0.3
"""After a message that was late or missing the arm was not where the motion is; for so long its torque says nothing of
the model."""


@dataclass(frozen=True, slots=True, eq=False)
class Modelled:
    """One frame with its motion and its torque; arrays (7,). modelled: Nm, None without a model; sign of eq. (1)."""

    frame: LiveFrame
    velocity: FloatArray
    acceleration: FloatArray
    modelled: FloatArray | None

    @property
    def difference(self) -> FloatArray | None:
        """Measured minus modelled torque, Nm; None where one of them is not known."""
        if self.modelled is None or self.frame.torque is None:
            return None
        return np.array(self.frame.torque) - self.modelled


class LiveResidual:
    """Takes the frames of a run as they come; `ratio` says how large what the model leaves over is beside the noise."""

    def __init__(self, foresight: TorqueForesight | None) -> None:
        self._foresight = foresight
        self._last: list[LiveFrame] = []
        self._noise: PeriodNoise | None = None
        self._disturbed = (-1, -1)
        self._counts_from_s = 0.0

    def take(self, frames: Sequence[LiveFrame]) -> list[Modelled]:
        """The frames that now have one before and one after them; frames without a position are passed over."""
        known = self._last + [frame for frame in frames if frame.position is not None]
        self._last = known[-2:]
        found: list[tuple[LiveFrame, FloatArray, FloatArray]] = []
        for before, here, after in zip(known, known[1:], known[2:], strict=False):
            motion = velocity_and_acceleration(before, here, after)
            if motion is not None:
                found.append((here, *motion))
        if not found:
            return []
        torque: FloatArray | None = None
        if self._foresight is not None:
            positions = np.array([frame.position for frame, _, _ in found])
            velocities, accelerations = (np.array([each[place] for each in found]) for place in (1, 2))
            regressor = self._foresight.regressor.matrix(positions, velocities, accelerations)
            torque = np.asarray(regressor @ self._foresight.values)
        result = [
            Modelled(frame, velocity, acceleration, None if torque is None else torque[row])
            for row, (frame, velocity, acceleration) in enumerate(found)
        ]
        for each in result:
            self._count(each)
        return result

    @property
    def ratio(self) -> FloatArray | None:
        """RMS of torque minus model over the RMS of the noise, (7,); None before a period was driven twice."""
        return None if self._noise is None else self._noise.ratio

    def _count(self, each: Modelled) -> None:
        frame, difference = each.frame, each.difference
        disturbed = (frame.late, frame.missing)
        if disturbed != self._disturbed:
            self._disturbed, self._counts_from_s = disturbed, frame.robot_time_s + SETTLES_S
        if frame.robot_time_s < self._counts_from_s:
            return
        if difference is None or frame.period < 0 or frame.sample_in_period < 0 or not frame.rows_per_period:
            return
        if self._noise is None:
            self._noise = PeriodNoise(-(-frame.rows_per_period // frame.rows_per_frame))
        self._noise.take(
            frame.period, frame.sample_in_period // frame.rows_per_frame, np.array(frame.torque), difference
        )


class PeriodNoise:
    """Noise from one period to the next, and misfit of the newest period driven, per place in the period and joint."""

    def __init__(self, places: int) -> None:
        self._torque = np.full((places, 7), np.nan)
        self._period = np.full(places, -2)
        self._square_noise = np.full((places, 7), np.nan)
        self._square_misfit = np.full((places, 7), np.nan)

    def take(self, period: int, place: int, torque: FloatArray, difference: FloatArray) -> None:
        """Torque and torque minus model (7,) Nm at one place (a frame's number) of one period."""
        if not 0 <= place < len(self._period):
            return
        if self._period[place] == period - 1:
            # The variance of a difference of two is twice that of one.
            self._square_noise[place] = 0.5 * (torque - self._torque[place]) ** 2
        self._torque[place], self._period[place] = torque, period
        self._square_misfit[place] = difference**2

    @property
    def ratio(self) -> FloatArray | None:
        """(7,), inf where a joint has no noise at all; None before enough of the period was seen twice."""
        seen = np.isfinite(self._square_noise[:, 0])
        if seen.mean() < LEAST_SHARE:
            return None
        # Over the same places, so that a part of the motion with more of either counts on both sides.
        noise, misfit = self._square_noise[seen].mean(axis=0), self._square_misfit[seen].mean(axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(np.where(misfit > 0.0, np.sqrt(misfit / noise), 0.0))


def noise_sentence(ratio: FloatArray | None) -> str:
    """Which joint the model fits worst, where that is worth a word; (7,) of `LiveResidual.ratio`."""
    if ratio is None:
        return ""
    joint = int(np.argmax(ratio))
    if ratio[joint] < REMARKABLE:
        return f"Torque minus model is noise: at most {ratio[joint]:.1f} × (joint {joint + 1})."
    return f"Joint {joint + 1} is {ratio[joint]:.3g} × its noise."


def velocity_and_acceleration(
    before: LiveFrame, here: LiveFrame, after: LiveFrame
) -> tuple[FloatArray, FloatArray] | None:
    """rad/s and rad/s² (7,) at the middle of three frames, of the parabola through them; None where they are not
    near each other in time.
    """
    first, second = here.robot_time_s - before.robot_time_s, after.robot_time_s - here.robot_time_s
    if not (first > 0.0 and second > 0.0 and first + second <= WIDEST_S):
        return None
    p0, p1, p2 = (np.array(frame.position) for frame in (before, here, after))
    slope_before, slope_after = (p1 - p0) / first, (p2 - p1) / second
    acceleration = 2.0 * (slope_after - slope_before) / (first + second)
    velocity = (slope_before * second + slope_after * first) / (first + second)
    return velocity, acceleration
