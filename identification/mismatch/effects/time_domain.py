"""Derivatives and filters over the time of a motion, exact where it is periodic."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from scipy.fft import next_fast_len

from identification.arrays import FloatArray
from identification.mismatch.motion import Motion

ComplexArray = npt.NDArray[np.complexfloating]


def filtered(motion: Motion, values: FloatArray, response: Callable[[ComplexArray], ComplexArray]) -> FloatArray:
    """Values through a linear filter given by its response to s = i ω; axis 0 is time, (S, …).

    A periodic motion gets the periodic steady state. Other stretches are continued at both ends by their point
    reflection for the length of the stretch, so that the filter starts on something like what came before.
    """
    samples = motion.samples
    if not motion.periodic:
        before, after = 2.0 * values[:1] - values[:0:-1], 2.0 * values[-1:] - values[-2::-1]
        # Lengths with a large prime factor, of which a stretch may be, cost many times as much.
        spare = next_fast_len(3 * samples, real=True) - (3 * samples - 2)
        values = np.concatenate([before, values, after, np.repeat(after[-1:], spare, axis=0)])
    spectrum = np.fft.rfft(values, axis=0)
    s = 2.0j * np.pi * np.fft.rfftfreq(values.shape[0], motion.sampling_period_s)
    factor = response(s).reshape(-1, *(1 for _ in values.shape[1:]))
    result = np.fft.irfft(spectrum * factor, n=values.shape[0], axis=0)
    return np.asarray(result if motion.periodic else result[samples - 1 : 2 * samples - 1])


def time_derivative(motion: Motion, values: FloatArray) -> FloatArray:
    """d/dt along axis 0: exact for a periodic motion of limited band, central differences otherwise."""
    if motion.periodic:
        return filtered(motion, values, lambda s: s)
    return np.asarray(np.gradient(values, motion.sampling_period_s, axis=0, edge_order=2))
