"""Going on after a pause in which the robot had no command: from rest, along the path, up to the motion's own pace.

Here: how long a pause the robot's own interpolation spans, the curve of the pace, the search for one inside every
limit, and the way back to rest from any point of it, along the path too. Not here: which commands belong to the path
(`motion`), who counts the robot's cycles (`loop`).

What a robot does in a cycle without a command is not published (PROTOCOL section 10.5): it stays on the last command or
goes on as far as the last one went. Robots take commands every 10 ms too (section 7) and bridge the time between two of
them themselves; what is lost of a path in 10 ms, 15 mrad at full velocity, is no more than the lag with which the arm
follows it anyhow. After a longer pause the arm is taken to stand on the last command, the only place it was ever sent
to, and the path is taken up from there at rest: nothing on the path is left out, and no step is larger than planned.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from safety.limits import FloatArray
from safety.path_stop import PathStop

BRIDGED_S = 0.01
"""Time without a command that a robot spans by itself: the longest command period of PROTOCOL section 7."""

DURATIONS_S = (0.15, 0.2, 0.3, 0.45, 0.7, 1.0)
"""Ladder: time from rest to full pace; the first whose commands are inside every limit is taken."""

BRAKING_DURATIONS_S = (0.1, *DURATIONS_S)
"""The same for the way back to rest."""


class ReEntry(NamedTuple):
    """Commands from rest to the motion's pace. start: step of the path the arm stands on, landing: the one reached at
    full pace, a whole number; positions: (ticks, n) rad.
    """

    start: float
    landing: int
    positions: list[list[float]]


def re_entry_steps(start: float, ticks: int) -> FloatArray:
    """Steps of the path after each command of a re-entry, (ticks,), ticks even; the last is a whole number.

    The pace is 3 u² - 2 u³ with u from 0 to 1, so velocity and acceleration along the path are continuous at both ends
    and ticks / 2 steps are driven; what `start` lacks to a whole step is spread over all of it (10 u³ - 15 u⁴ + 6 u⁵).
    """
    u = np.arange(1, ticks + 1) / ticks
    missing = math.ceil(start) - start
    steps = start + ticks * (u**3 - u**4 / 2.0) + missing * (10.0 * u**3 - 15.0 * u**4 + 6.0 * u**5)
    steps[-1] = math.ceil(start) + ticks // 2
    return steps


def plan_re_entry(
    start: float,
    command_period_s: float,
    positions_at: Callable[[FloatArray], FloatArray],
    fits: Callable[[FloatArray], bool],
) -> ReEntry | None:
    """The quickest re-entry from rest at step `start` of a path that fits; None where none does.

    positions_at: of steps of the path, counted from 0, the positions, (m, n) rad. fits: whether positions, one per
    command period, are inside every limit; asked from three commands at rest to three at full pace.
    """
    for duration in DURATIONS_S:
        ticks = 2 * math.ceil(duration / (2.0 * command_period_s) - 1e-9)
        steps = re_entry_steps(start, ticks)
        around = np.concatenate(([start] * 3, steps, steps[-1] + np.arange(1.0, 4.0)))
        positions = positions_at(around)
        if fits(positions):
            return ReEntry(start, round(steps[-1]), positions[3:-3].tolist())
    return None


def plan_braking(
    recent: FloatArray,
    command_period_s: float,
    positions_at: Callable[[FloatArray], FloatArray],
    fits: Callable[[FloatArray], bool],
) -> PathStop | None:
    """The quickest stop along the path from any pace that fits; None where none does.

    recent: steps of the path of the last four commands, (4,). The pace goes on from theirs as the cubic that begins
    with its value and its slope and ends with zero for both. positions_at, fits: see `plan_re_entry`; the geometry is
    that of the path, so what the preflight found about distances holds.
    """
    first = np.diff(recent)
    second = np.diff(first)
    third = second[1] - second[0]
    pace = float(first[-1] + second[-1] / 2.0 + third / 3.0)  # per command, at the last one
    slope = float(second[-1] + third)
    for duration in BRAKING_DURATIONS_S:
        ticks = math.ceil(duration / command_period_s - 1e-9)
        v = np.arange(1, ticks + 1) / ticks
        driven = pace * (v - v**3 + v**4 / 2.0) + slope * ticks * (v**2 / 2.0 - 2.0 * v**3 / 3.0 + v**4 / 4.0)
        steps = recent[-1] + ticks * driven
        around = positions_at(np.concatenate((recent, steps, steps[[-1] * 3])))
        if np.all(np.diff(steps) >= 0.0) and fits(around):
            return PathStop(around[len(recent) : -3], command_period_s, rows=0.0)
    return None
