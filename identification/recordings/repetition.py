"""Whether a motion repeats although nobody states a period, as most bags and tables do."""

from __future__ import annotations

import numpy as np

from identification.arrays import FloatArray
from identification.recordings.labels import SAME_MOTION, in_its_own_motion, repeating_period

_ROWS = 20_000


def unstated_period(time: FloatArray, position: FloatArray, sampling_period_s: float) -> float | None:
    """The shortest time after which the whole motion comes again, s; None where no time in half of the recording is.

    time: (N,) s; position: (N, n) rad (m). By the mean square between position and itself that much later, of all
    joints in units of their own motion, over the rows that have both: from the autocorrelation.
    """
    number = min(time.size, _ROWS)
    grid = np.linspace(time[0], time[-1], number)
    there = in_its_own_motion(np.column_stack([np.interp(grid, time, joint) for joint in position.T]))
    there -= there.mean(axis=0)
    power = np.abs(np.fft.rfft(there, 2 * number, axis=0)) ** 2
    together = np.fft.irfft(power, axis=0)[:number].sum(axis=1)
    energy = np.concatenate([[0.0], np.cumsum((there**2).sum(axis=1))])
    later = np.arange(1, number // 2 + 1)
    both = energy[number - later] + energy[-1] - energy[later]
    apart = 1.0 - 2.0 * together[later] / np.maximum(both, np.finfo(np.float64).tiny)
    # Shortly after, every motion is still near where it was: a period begins with having left.
    left = np.flatnonzero(apart > 0.5)
    if not left.size:
        return None
    again = np.flatnonzero(apart[left[0] :] < SAME_MOTION**2)
    if not again.size:
        return None
    first = left[0] + again[0]
    near = apart[first : first + max(2, first // 20)]
    period_s = float(later[first + int(np.argmin(near))] * (grid[1] - grid[0]))
    return repeating_period(time, position, period_s, sampling_period_s)
