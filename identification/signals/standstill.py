"""Samples at which a joint of a periodic motion stands or turns slowly, taken out of both sides by a straight line."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array

from identification.arrays import BoolArray, FloatArray, IntArray
from identification.signals.processed import LinearOperator, unchanged

STANDSTILL_VELOCITY = 1e-3
"""rad/s (m/s) below which a joint's direction of motion is not known."""
STANDSTILL_MARGIN_S = 0.006
"""Length around each such sample that is left out with it; no less than one sample on each side."""
SHORTEST_STANDSTILL_S = 0.007
"""A joint that is slower than that for less time turns round without resting (|q̈| above 0.3 rad/s²)."""
FEWEST_SLOW_SAMPLES = 3
"""On end, where one sample alone lasts longer than that: it does not tell a rest from a turn."""
LONGEST_STANDSTILL_SHARE = 0.2
BRIDGE_SUPPORT_S = 0.01
"""Length of the samples on each side whose means carry the line over a standstill."""


def over_standstills(velocity: FloatArray, step_s: float) -> LinearOperator:
    """Values (S, …) as they are, but on a straight line while a joint stands or turns round slowly.

    A joint that is held by its dry friction takes any torque within it, and its neighbours feel the jerks of its
    sticking, which are too fast for the motion's bandwidth: no column describes these samples. A joint that turns round
    at once is not held; there its friction turns over, and without these samples most would be gone that shows a delay
    of less than a millisecond. A joint that stands for long is not asked. The line goes through the means of samples
    before and behind. Zeros instead would chop the slow noise, and all high lines would see the same few numbers of it,
    as if each were news.

    The line is not a wave's own course: of a wave's energy, up to twice the share of time that is bridged (averaged
    over frequencies) appears on other lines of the same joint. Predicting these samples from 50 ms around (kriging)
    leaves a tenth of that, but it carries on the jerk of the joint's sticking, which outlasts the bridged samples: on
    an arm under feedback the noise rose by an eighth and a resonance was named that is not there.
    """
    standing = np.abs(velocity) < STANDSTILL_VELOCITY
    standing &= standing.mean(axis=0) < LONGEST_STANDSTILL_SHARE
    coarse = step_s > SHORTEST_STANDSTILL_S
    shortest = FEWEST_SLOW_SAMPLES if coarse else round(SHORTEST_STANDSTILL_S / step_s) | 1
    standing = _marked_around(_marked_around(standing, shortest) == shortest, shortest) > 0
    width = max(3, round(STANDSTILL_MARGIN_S / step_s)) | 1
    bridged = _marked_around(np.asarray(standing.any(axis=1)), width) > 0
    samples, places = bridged.size, np.flatnonzero(bridged)
    if places.size in (0, samples):
        return unchanged
    support = max(2, round(BRIDGE_SUPPORT_S / step_s))
    known = np.flatnonzero(~bridged)
    # Known samples on a circle: those of the period before stand in front, those of the next behind.
    circle = np.concatenate([known - samples, known, known + samples])
    after = np.searchsorted(circle, places)
    near = np.arange(support)
    before_times, after_times = circle[after[:, None] - 1 - near], circle[after[:, None] + near]
    start, end = before_times.mean(axis=1), after_times.mean(axis=1)
    share = ((places - start) / (end - start))[:, None]
    halves = [np.broadcast_to(part / support, before_times.shape) for part in (1.0 - share, share)]
    weights = np.concatenate(halves, axis=1)
    columns = np.concatenate([before_times, after_times], axis=1) % samples
    rows = np.repeat(np.arange(places.size), 2 * support)
    line = csr_array((weights.ravel(), (rows, columns.ravel())), shape=(places.size, samples))

    def bridge(values: FloatArray) -> FloatArray:
        result = values.copy("K")
        result[places] = (line @ values.reshape(samples, -1)).reshape(places.size, *values.shape[1:])
        return result

    return bridge


def _marked_around(marks: BoolArray, width: int) -> IntArray:
    """How many of the `width` (odd) samples around each one are marked, along axis 0 on a circle."""
    half = width // 2
    around = np.take(marks, np.arange(-half - 1, len(marks) + half), axis=0, mode="wrap")
    total = np.cumsum(around, axis=0, dtype=np.int64)
    return total[width:] - total[:-width]
