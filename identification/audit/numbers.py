"""The numbers of a difference, with intervals that hold between runs too.

Three things make an interval: what the rows leave open, times what the model leaves on rows that were not used; how far
the number moves when a part of the recording is left out, since misfit is not noise and another run is another part;
and how well the scale of the torque is known, which goes straight into kilograms. Pure.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from identification.audit.basis import Basis, basis_of
from identification.audit.comparison import ACCEPT, ALL, FIT, REPORT, Comparison
from identification.audit.evidence import posterior
from identification.audit.given import GivenModel, Sizes
from identification.audit.hypotheses import Hypothesis, Layout
from identification.audit.search import Audited

__all__ = ["FEW_PARTS", "Found", "found_numbers"]

FloatArray = npt.NDArray[np.float64]
FEW_PARTS = 2.365 / 1.96
"""Student's factor of seven degrees of freedom over the normal one: the scatter is that of eight parts."""
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


def found_numbers(found: Audited, model: GivenModel, sizes: Sizes) -> list[Found]:
    """Of every step, on all rows."""
    now, noise = found.comparison, found.noise
    layout = Layout(now.geometry.robot.n)
    basis = basis_of(layout, model, sizes, [step.hypothesis for step in found.steps])
    values, covariance = _fitted(now, basis, noise.weight, ALL)
    unseen, _ = _fitted(now, basis, noise.weight, (*FIT, *ACCEPT))
    left = now.products.left(REPORT, unseen, basis.columns)
    counts = now.products.counts(REPORT)
    expected = float((counts / noise.repeated).sum())
    birge = max(1.0, float(noise.weight @ left) / max(expected, 1.0))
    without = np.array([_fitted(now, basis, noise.weight, [p for p in ALL if p != part])[0] for part in ALL])
    moved = without - without.mean(axis=0)
    between = FEW_PARTS**2 * (len(ALL) - 1) / len(ALL) * moved.T @ moved
    scale = _scale_scatter(now, basis, layout, noise.weight)
    result, place = [], len(layout.base)
    for step in found.steps:
        own = slice(place, place + len(step.hypothesis.columns))
        place = own.stop
        whole = birge * covariance[own, own] + between[own, own]
        result.append(Found(step.hypothesis, values[own], whole, scale))
    return result


def _fitted(now: Comparison, basis: Basis, weight: FloatArray, parts: list[int] | tuple[int, ...]) -> tuple[
    FloatArray, FloatArray
]:  # fmt: skip
    gram, right = now.products.summed(parts, weight)
    estimate = posterior(gram[np.ix_(basis.columns, basis.columns)], right[basis.columns], basis.factor)
    return estimate.values, estimate.covariance


def _scale_scatter(now: Comparison, basis: Basis, layout: Layout, weight: FloatArray) -> float:
    """Relative: root of the mean square of the joints' scales, free beside what was found, less their own variance."""
    free = np.arange(layout.gain, layout.gain + layout.n)
    free = np.array([place for place in free if place not in basis.columns], dtype=np.int64)
    if not free.size:
        return 0.0
    hypothesis = Hypothesis("torque_sensor_gain", free, np.full(free.size, SCALE_WIDTH), 0.0)
    values, covariance = _fitted(now, basis.plus(hypothesis), weight, ALL)
    own = slice(len(basis.columns), None)
    squares = values[own] ** 2 - np.diag(covariance)[own]
    # Joints that carry no weight know nothing of their scale: each counts by what it does know.
    known = 1.0 / (np.diag(covariance)[own] + 1e-4)
    return float(np.sqrt(max(0.0, float(known @ squares) / float(known.sum()))))
