"""The ends of a record that was filtered before we got it: a filter begins and stops with nothing beside the record.

There its output swings from zero, or from a guess, to the signal; the record's first and last moments are no evidence.
"""

from __future__ import annotations

import numpy as np

from identification.arrays import BoolArray, FloatArray
from identification.signals.gaps import wrapped_fill

FEWEST_PERIODS = 4
FEWEST_LINES = 64
REMOVED = 1e-3
"""Share of the noise's power density that the highest eighth of the lines has when a filter took the rest."""
HALF = 0.5
"""Share of the density below it that is left at the cutoff of a Butterworth filter."""
SETTLED_PERIODS = 4.0
"""Of the cutoff frequency: the slowest pole of a fourth-order Butterworth filter, at 0.38 of its angular cutoff, has
faded to exp(−2 π · 0.38 · 4) = 7e-5 by then."""


def cutoff_hz(torque: FloatArray, sampling_period_s: float) -> float | None:
    """Cutoff of the low-pass that a periodic torque (K, M, n) went through; None where its noise shows none.

    The noise is what successive periods differ by, its median over them, so that no transient or push counts.
    """
    missing: BoolArray = np.asarray(~np.isfinite(torque).all(axis=2))
    held = np.flatnonzero(~missing.all(axis=1))
    torque, missing = torque[held], missing[held]
    if len(torque) < FEWEST_PERIODS or torque.shape[1] < 2 * FEWEST_LINES:
        return None
    filled = np.stack([wrapped_fill(period, lacks) for period, lacks in zip(torque, missing, strict=True)])
    power = np.median(np.abs(np.fft.rfft(np.diff(filled, axis=0), axis=1)[:, 1:]) ** 2, axis=0)
    total = power.sum(axis=0)
    if not np.any(total > 0.0):
        return None
    density = (power[:, total > 0.0] / total[total > 0.0]).mean(axis=1)
    edges = [density.size >> step for step in range(density.size.bit_length() - 2)]
    level = np.array([density[size // 2 : size].mean() for size in edges])
    if density[-(density.size // 8) :].mean() >= REMOVED * level.max():
        return None
    # From the highest octave downwards the first that holds a part which the filter left whole.
    whole = int(np.argmax(level > REMOVED**0.5 * level.max()))
    reference = level[whole : whole + 2].max()
    passed = np.flatnonzero(density[edges[whole] // 2 : edges[whole]] > HALF * reference)
    line = edges[whole] // 2 + 1 + (int(passed[-1]) if passed.size else 0)
    return float(line / (torque.shape[1] * sampling_period_s))


def at_filter_ends(time: FloatArray, cutoff: float) -> BoolArray:
    """Rows of a record that lie so near to its first or last one that a filter of that cutoff (Hz) has not settled."""
    edge = SETTLED_PERIODS / cutoff
    return np.asarray((time - time[0] < edge) | (time[-1] - time < edge))
