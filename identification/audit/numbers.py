"""The numbers of a difference, with intervals that hold between runs too.

Three things make an interval: what the rows leave open, times what the model leaves on rows that were not used; how far
the number moves when a stretch of the recording is left out, since misfit is not noise and another run is another part;
and how well the scale of the torque is known, which goes straight into kilograms. Pure.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identification.arrays import FloatArray
from identification.audit.basis import Explanation
from identification.audit.comparison import ALL, REPORT
from identification.audit.evidence import between_parts
from identification.audit.hypotheses import Hypothesis

LEAST_SCALE = 0.01
"""No torque is known better, relative."""
SCALE_WIDTH = 0.1
"""A torque sensor's scale differs by less than this between two runs; motor currents by a few per cent."""


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """Values (m,) of a hypothesis' columns beside the last set-up, and their covariance (m, m), all terms counted.

    scale: by how much, relative, the scales of the joints' torques scatter.
    """

    hypothesis: Hypothesis
    values: FloatArray
    covariance: FloatArray
    scale: float


def found_numbers(now: Explanation) -> list[Found]:
    """Of every difference, on all rows."""
    products, noise = now.comparison.products, now.noise
    expected = float((products.counts(REPORT) / noise.repeated).sum())
    misfit = max(1.0, float(noise.weight @ now.reported()) / max(expected, 1.0))
    stretches = now.in_stretches()
    values, covariance = _all_terms(stretches, misfit)
    scale = _scale_scatter(stretches, misfit)
    result, place = [], len(values) - sum(len(step.columns) for step in now.steps)
    for step in now.steps:
        own = slice(place, place + len(step.columns))
        place = own.stop
        result.append(Found(step, values[own], covariance[own, own], scale))
    return result


def _all_terms(stretches: Explanation, misfit: float) -> tuple[FloatArray, FloatArray]:
    """Values (k,) of all that is free, and covariance (k, k): what the rows leave open, and what stretches of time
    differ by: what a model leaves goes on for seconds, and blocks in turns have all had the same of it.

    misfit: what is left on rows that were not used, in units of the noise.
    """
    estimate = stretches.fitted(ALL)
    without = np.array([stretches.fitted([p for p in ALL if p != part]).values for part in ALL])
    return estimate.values, misfit * estimate.covariance + between_parts(without)


def _scale_scatter(stretches: Explanation, misfit: float) -> float:
    """Relative: root of the mean square of the joints' scales, free beside what was found, less their own variance.

    The variance has all terms: parts of a recording in which a joint carries next to nothing differ in its scale.
    """
    layout = stretches.layout
    taken = np.concatenate([[-1], *(step.columns for step in stretches.steps)])
    free = np.setdiff1d(np.arange(layout.gain, layout.gain + layout.n), taken)
    if not free.size:
        return 0.0
    scales = Hypothesis("torque_sensor_gain", free, np.full(free.size, SCALE_WIDTH), 0.0)
    values, covariance = _all_terms(stretches.plus(scales, stretches.day), misfit)
    variance = np.diag(covariance)[-free.size :]
    # Joints that carry no weight know nothing of their scale: each square counts by how well it is known itself.
    known = 1.0 / (variance + LEAST_SCALE**2) ** 2
    return float(np.sqrt(max(0.0, float(known @ (values[-free.size :] ** 2 - variance)) / float(known.sum()))))
