"""Outliers of a periodic torque: bounded across the periods, then replaced by what the noise around them foretells.

The same instant of every period has the same torque, so a sample is judged by its siblings and not by any model:
Huber's location with a scale per joint. What remains of a sample is coloured noise, of which its neighbours in time
know most: a sample far from what they foretell is an outlier however small it is beside the noise as a whole (robust
cleaning, Martin and Thomson 1982, here with the neighbours of both sides).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from identification.arrays import DEVIATION_FROM_MEDIAN, FloatArray
from identification.errors import EstimationError
from identification.signals.gaps import median_over_periods
from identification.signals.periods import PeriodTable, average_periods

# In robust standard deviations. Two keeps 99 % of the efficiency on Gaussian noise; the classical 1.345 keeps 95 %.
HUBER_BOUND = 2.0
FEWEST_PERIODS = 3
_ROUNDS = 5
# Hampel's redescending ψ, in robust deviations of the interpolation error: kept as it is up to the first (one of 370
# samples of Gaussian noise lies beyond), given no say beyond the second.
_KEPT, _REJECTED = 3.0, 5.0
_SPECTRUM_ROUNDS, _SWEEPS = 2, 6
# Lines quieter than this part of the mean power count as that: so far no sensor's noise floor is trusted.
_QUIETEST = 1e-2


def bound_outliers_across_periods(table: PeriodTable) -> tuple[PeriodTable, FloatArray]:
    """The table with pseudo-values in place of the torque, and the share (n,) of samples beyond the bound.

    A pseudo-value is μ + ψ(τ − μ)/E ψ' with Huber's ψ and location μ of each sample: their mean over the periods is μ,
    and their scatter is μ's true uncertainty, so averages and noise spectra downstream stay what they claim to be.
    Raises EstimationError for fewer than three periods.
    """
    torque = table.torque
    periods = torque.shape[0]
    if periods < FEWEST_PERIODS:
        raise EstimationError(f"Outliers cannot be judged across {periods} periods; {FEWEST_PERIODS} are needed")
    location = median_over_periods(torque)
    deviation = torque - location
    # Deviations from a median of K values are smaller than those from the truth.
    scale = DEVIATION_FROM_MEDIAN * np.nanmedian(np.abs(deviation), axis=(0, 1)) * np.sqrt(periods / (periods - 1.0))
    bound = HUBER_BOUND * scale
    share = unclipped_share(deviation, bound)
    clipped = np.clip(deviation, -bound, bound)
    held = np.maximum(np.isfinite(torque).sum(axis=0), 1)
    for _ in range(_ROUNDS):
        location = location + np.nansum(clipped, axis=0) / held / share
        clipped = np.clip(torque - location, -bound, bound)
    share = unclipped_share(torque - location, bound)
    return replace(table, torque=location + clipped / share), 1.0 - share


def clean_across_periods(table: PeriodTable) -> tuple[PeriodTable, FloatArray, FloatArray]:
    """The table with outliers of the torque replaced; shares (n,) beyond Huber's bound, and replaced.

    Huber's pseudo-values give the first mean period and the first noise spectrum. The spectrum says what all other
    samples foretell of each one, and the distance from that passes Hampel's ψ. (Bounded samples alone leave white noise
    of 0.08 of a sample's variance for 2 % of outliers: much beside coloured noise on the lines where it is quiet.)
    Raises EstimationError for fewer than three periods.
    """
    cleaned, beyond = bound_outliers_across_periods(table)
    joints = table.torque.shape[2]
    known = np.isfinite(table.torque).reshape(-1, joints)
    replaced = np.zeros(joints)
    for _ in range(_SPECTRUM_ROUNDS):
        average = average_periods(cleaned)
        assert average.torque_spectrum is not None, "there are several periods"
        distance_from, step = _interpolation(average.torque_spectrum, len(known), len(table.periods))
        measured = np.where(known, (table.torque - average.torque).reshape(-1, joints), np.inf)
        clean = _without_spikes(np.where(known, measured, 0.0))
        for _ in range(_SWEEPS):
            foretold = clean - distance_from(clean)
            distance = measured - foretold
            scale = DEVIATION_FROM_MEDIAN * np.median(np.abs(distance), axis=0)
            found = foretold + _hampel(distance, scale)
            clean += step * (found - clean)
        torque = average.torque + np.where(known, found, np.nan).reshape(table.torque.shape)
        cleaned = replace(table, torque=torque)
        replaced = np.mean(known & (np.abs(distance) > _REJECTED * scale), axis=0)
    return cleaned, beyond, replaced


def _interpolation(
    spectrum: FloatArray, samples: int, periods: int
) -> tuple[Callable[[FloatArray], FloatArray], FloatArray]:
    """How far each sample (samples, n) lies from what all others foretell, as a function, and a safe step (n,).

    spectrum: (lines, n) power of the noise on the lines of one period; samples: of all periods in a row. For a
    stationary process of spectrum S the interpolation error is the process filtered with 1/S, divided by the mean of
    1/S over all lines. Replacing several samples at once by what is foretold converges for steps below twice that mean
    over the largest 1/S.
    """
    mean = spectrum[1:].mean(axis=0)
    inverse = 1.0 / np.where(mean > 0.0, np.maximum(spectrum, _QUIETEST * mean), 1.0)
    place = np.arange(samples // 2 + 1) / periods
    gain = np.column_stack([np.interp(place, np.arange(len(inverse)), column) for column in inverse.T])
    both_sides = np.full(len(gain), 2.0)
    both_sides[0] = 1.0
    if samples % 2 == 0:
        both_sides[-1] = 1.0
    gain /= both_sides @ gain / samples
    step = np.minimum(1.0, 1.9 / gain.max(axis=0))
    return lambda values: np.fft.irfft(np.fft.rfft(values, axis=0) * gain, n=samples, axis=0), step


def _without_spikes(values: FloatArray) -> FloatArray:
    """(N, n) values bounded at Huber's deviations from their running median: what slowly wanders far stays."""
    from scipy.ndimage import median_filter  # slow to load, and most recordings have no outliers

    middle = median_filter(values, size=(5, 1), mode="wrap")
    bound = HUBER_BOUND * DEVIATION_FROM_MEDIAN * np.median(np.abs(values - middle), axis=0)
    return np.asarray(middle + np.clip(values - middle, -bound, bound), dtype=np.float64)


def _hampel(distance: FloatArray, scale: FloatArray) -> FloatArray:
    """ψ(distance), (N, n), for the deviations scale (n,): as it is, falling to zero, zero."""
    size = np.abs(distance)
    falling = np.clip((_REJECTED * scale - size) * (_KEPT / (_REJECTED - _KEPT)), 0.0, None)
    return np.sign(distance) * np.minimum(size, falling)


def unclipped_share(deviation: FloatArray, bound: FloatArray) -> FloatArray:
    """(n,) share of the known deviations (…, n) within the bound (n,), an estimate of E ψ'; at least a half."""
    known = np.isfinite(deviation)
    axes = tuple(range(deviation.ndim - 1))
    inside = (np.abs(np.where(known, deviation, np.inf)) <= bound).sum(axis=axes)
    return np.asarray(np.maximum(inside / np.maximum(known.sum(axis=axes), 1), 0.5), dtype=np.float64)
