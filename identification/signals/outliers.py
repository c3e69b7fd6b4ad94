"""Outliers of a periodic torque, bounded sample by sample across the periods: Huber's location with a scale per joint.

The same instant of every period has the same torque, so a sample is judged by its siblings and not by any model.
Called by the periodic pipeline when a fit asks for the estimator "huber".
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from identification.errors import EstimationError
from identification.signals.periods import PeriodTable

FloatArray = npt.NDArray[np.float64]

# In robust standard deviations. Two keeps 99 % of the efficiency on Gaussian noise; the classical 1.345 keeps 95 %.
HUBER_BOUND = 2.0
FEWEST_PERIODS = 3
_ROUNDS = 5


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
    location = np.nanmedian(torque, axis=0)
    deviation = torque - location
    # Deviations from a median of K values are smaller than those from the truth.
    scale = 1.4826 * np.nanmedian(np.abs(deviation), axis=(0, 1)) * np.sqrt(periods / (periods - 1.0))
    bound = HUBER_BOUND * scale
    share = unclipped_share(deviation, bound)
    clipped = np.clip(deviation, -bound, bound)
    for _ in range(_ROUNDS):
        location = location + np.nanmean(clipped, axis=0) / share
        clipped = np.clip(torque - location, -bound, bound)
    share = unclipped_share(torque - location, bound)
    return replace(table, torque=location + clipped / share), 1.0 - share


def unclipped_share(deviation: FloatArray, bound: FloatArray) -> FloatArray:
    """(n,) share of the known deviations (…, n) within the bound (n,), an estimate of E ψ'; at least a half."""
    known = np.isfinite(deviation)
    axes = tuple(range(deviation.ndim - 1))
    inside = (np.abs(np.where(known, deviation, np.inf)) <= bound).sum(axis=axes)
    return np.asarray(np.maximum(inside / np.maximum(known.sum(axis=axes), 1), 0.5), dtype=np.float64)
