"""What is said of any class: its size with an interval, what it does to held-out rows, and the nearest forms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.problem import Problem, off
from identification.mismatch.search.library import EffectRows
from identification.mismatch.search.refinement import Member, gram_of
from identification.mismatch.search.screening import group_gain
from identification.mismatch.settings import CAPTURE
from identification.mismatch.unknown.claims import NearestForm
from identification.mismatch.unknown.predictive import LEAST_CHANGE

CURVE_POINTS = 241
"""Of a class's curve: some ten for each wave of the narrowest functions."""
FORMS_NAMED = 3


def size_of_weights(
    square: FloatArray, weights: FloatArray, covariance: FloatArray
) -> tuple[float, tuple[float, float]]:
    """RMS and its 95 % interval of a torque whose mean square is wᵀQw. square: Q (m, m), of Gaussian weights (m,).

    Variance of the mean square: 4 wᵀQCQw + 2 tr (QC)².
    """
    mean = float(weights @ square @ weights)
    product = square @ covariance
    variance = 4.0 * float(weights @ product @ square @ weights) + 2.0 * float(np.sum(product * product.T))
    return rms_interval(max(mean, 0.0), float(np.sqrt(max(variance, 0.0))))


def rms_interval(mean_square: float, deviation: float) -> tuple[float, tuple[float, float]]:
    """Root of a mean square and its 95 % interval. deviation: of the mean square.

    The root has half of that deviation over the root: of one Gaussian weight |w| ± 1.96 σ, where the ends of the mean
    square's interval would call nothing what is less than 3.9 σ. What may be nothing has its upper end from the square.
    """
    rms = float(np.sqrt(mean_square))
    half = 0.98 * deviation / rms if rms > 0.0 else np.inf
    if half >= rms:
        return rms, (0.0, float(np.sqrt(mean_square + 1.96 * deviation)))
    return rms, (rms - half, rms + half)


def on_unseen_rows(gain: float, after: float, rms: str) -> str:
    """One sentence on the RMS of a joint on held-out rows. gain: Nm that a class takes off it; after: Nm, with it."""
    if abs(gain) <= LEAST_CHANGE * after:
        return f" On data that were not fitted it hardly changes {rms}."
    return f" On data that were not fitted it {'lowers' if gain > 0.0 else 'RAISES'} {rms} by {abs(gain):.2g} Nm."


def nearest_forms(
    problem: Problem, candidates: Sequence[EffectRows], joint: int, torque: FloatArray
) -> tuple[NearestForm, ...]:
    """Forms of the library that take most of a class's visible energy. torque: (n, R) whitened."""
    visible = off(problem.basis, torque.ravel())
    energy = float(visible @ visible)
    shadowed = replace(problem, residual=visible)
    best: dict[str, float] = {}
    for candidate in candidates:
        if joint not in candidate.joints or energy <= 0.0:
            continue
        gram, target, raw = gram_of(shadowed, Member(candidate))
        share = min(group_gain(gram, target, raw)[0] / energy, 1.0)
        best[candidate.effect.name] = max(best.get(candidate.effect.name, 0.0), share)
    found = sorted(((share, name) for name, share in best.items() if share >= CAPTURE), reverse=True)
    return tuple(NearestForm(name, share) for share, name in found[:FORMS_NAMED])
