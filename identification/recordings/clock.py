"""Is the clock of a recording right? Its velocity, where one was recorded, says so without a model; the order of its
stamps says whether it was set back. Pure.
"""

from __future__ import annotations

import numpy as np

from identification.arrays import DEVIATION_FROM_MEDIAN, BoolArray, FloatArray, runs_of
from identification.recordings.recording import Recording
from identification.recordings.velocities import WindowedRates

WIDEST_RATIO = 30.0
SMALLEST_CLOCK_ERROR = 0.03
"""Of the rate: less is no wrong clock."""
SET_BACK_ROWS = 3
"""In a row with a time before an earlier row's: fewer are single rows that came late."""


def clock_by_velocity(recording: Recording) -> tuple[float, float] | None:
    """True rate over stated rate and its deviation, as the recorded velocity goes with the change of position.

    None where a recording has no velocity, or one that is not the derivative of its position.
    """
    rates = WindowedRates.of(recording)
    if rates is None or not np.isfinite(rates.recorded).all():
        return None
    difference, velocity, moving = rates.derived, rates.recorded, rates.moving
    slopes = (difference * velocity).sum(axis=0) / np.maximum((difference**2).sum(axis=0), 1e-300)
    alike = (difference * velocity).sum(axis=0) ** 2 > 0.98 * (difference**2).sum(axis=0) * (velocity**2).sum(axis=0)
    chosen = slopes[moving & alike & (slopes > 0.0)]
    if chosen.size < max(1, 0.5 * moving.sum()):
        return None
    ratio = float(np.median(chosen))
    spread = DEVIATION_FROM_MEDIAN * float(np.median(np.abs(chosen - ratio))) if chosen.size > 1 else 0.01 * ratio
    if not 1.0 / WIDEST_RATIO < ratio < WIDEST_RATIO or spread > 0.05 * ratio:
        return None
    return ratio, max(spread / np.sqrt(chosen.size), 1e-4)


def highest_before_each(time: FloatArray) -> FloatArray:
    """(N,) the latest time in the rows before each, −∞ before the first."""
    return np.concatenate([[-np.inf], np.maximum.accumulate(time)[:-1]])


def before_a_clock_was_set_back(time: FloatArray, gap_s: float) -> BoolArray:
    """(N,) rows that are as late as those behind them, of a clock that was set back and ran on. gap_s: longest step.

    Without these rows and those behind there is a gap, as long as the clock was set back by. Else two moments would
    stand side by side, and the arm would seem to leap. Rows that merely come late leave a hole where they are missing.
    """
    twice = np.zeros(time.size, dtype=np.bool_)
    backwards = time < highest_before_each(time)
    for first, after in runs_of(backwards):
        if after - first >= SET_BACK_ROWS and (after == time.size or time[after] - time[after - 1] <= gap_s):
            twice[:first] |= time[:first] >= time[first]
    return twice & ~backwards
