"""Derivatives and filters over the time of a motion, exact where it is periodic."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.fft import next_fast_len

from identification.arrays import FloatArray
from identification.mismatch.motion import Motion
from identification.remembered import once_per_object

ComplexArray = npt.NDArray[np.complexfloating]


@once_per_object
def frequencies_of(motion: Motion) -> ComplexArray:
    """Values of s = i ω, (L,) rad/s, on which filters act: the lines of one period, or of a continued stretch."""
    return np.asarray(2.0j * np.pi * np.fft.rfftfreq(_length(motion), motion.sampling_period_s))


def filtered(motion: Motion, values: FloatArray, response: ComplexArray) -> FloatArray:
    """Values (S, …) over time through a linear filter, given by its response (L,) at `frequencies_of` the motion.

    A periodic motion gets the periodic steady state. Other stretches are continued at both ends by their point
    reflection for the length of the stretch, so that the filter starts on something like what came before.
    """
    return filtered_lines(motion, lines_of(motion, values), response)


def lines_of(motion: Motion, values: FloatArray) -> ComplexArray:
    """Fourier coefficients (L, …) of values (S, …) over time, continued as `filtered` says."""
    if not motion.periodic:
        before, after = 2.0 * values[:1] - values[:0:-1], 2.0 * values[-1:] - values[-2::-1]
        spare = _length(motion) - (3 * motion.samples - 2)
        values = np.concatenate([before, values, after, np.repeat(after[-1:], spare, axis=0)])
    return np.asarray(np.fft.rfft(values, axis=0))


def filtered_lines(motion: Motion, lines: ComplexArray, response: ComplexArray) -> FloatArray:
    """(S, …) over time of `lines_of` some values through a filter: for one whose values meet many filters."""
    samples = motion.samples
    factor = response.reshape(-1, *(1 for _ in lines.shape[1:]))
    result = np.fft.irfft(lines * factor, n=_length(motion), axis=0)
    return np.asarray(result if motion.periodic else result[samples - 1 : 2 * samples - 1])


@once_per_object
def torque_lines(motion: Motion) -> ComplexArray:
    """`lines_of` the nominal torque, (L, n)."""
    return lines_of(motion, motion.torque)


def time_derivative(motion: Motion, values: FloatArray) -> FloatArray:
    """d/dt along axis 0: exact for a periodic motion of limited band, central differences otherwise."""
    if motion.periodic:
        return filtered(motion, values, frequencies_of(motion))
    return np.asarray(np.gradient(values, motion.sampling_period_s, axis=0, edge_order=2))


def _length(motion: Motion) -> int:
    """Samples of a period, or of a continued stretch: with a large prime factor it would cost many times as much."""
    return motion.samples if motion.periodic else int(next_fast_len(3 * motion.samples, real=True))
