"""What of the classes goes into the extended model: terms beside the names that stand, where no joint gets worse.

Names keep their sizes; classes are chosen on what they leave, weights and base parameters come from the fitted rows,
and held-out rows say which terms may stay. Without held-out rows nothing is offered.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import groupby

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.heldout import Residuals
from identification.mismatch.search.extension import OPEN, nominal_factor
from identification.mismatch.unknown.claims import Offer
from identification.mismatch.unknown.classes import CLASSES
from identification.mismatch.unknown.dependence import weighed
from identification.mismatch.unknown.left import Left
from identification.mismatch.unknown.model_terms import terms_of
from identification.mismatch.unknown.predictive import LEAST_CHANGE, Dropped, harmless, useful
from identification.mismatch.unknown.selection import Selection

LISTED = 3
"""Classes of a joint that a sentence lists by name."""


def offer(
    alone: Selection, left: Left, before: Residuals, weight: FloatArray
) -> tuple[Offer | None, tuple[Dropped, ...]]:
    """The terms that predict held-out rows, None where none are left; and what is left out as it does not.

    Base parameters beside them are those of `alone`, or are fitted with the weights (n, R) of the names' own fit: what
    leaves less of the held-out rows of all joints is offered. So are angles that are off, all of them or none.
    """
    found, dropped, logarithm = _with_best_weights(alone, left, before, weight)
    if alone.rows.angles:
        other = _with_best_weights(weighed(alone.rows.without_angles()), left, before, weight)
        if other[2] < logarithm:
            kinds = [kind.name for kind in CLASSES]
            gone = dict.fromkeys((item.joint, kinds.index(item.name)) for item in alone.rows.angles)
            found, dropped = other[0], (*other[1], *gone)
    return found, dropped


def _with_best_weights(
    alone: Selection, left: Left, before: Residuals, weight: FloatArray
) -> tuple[Offer | None, tuple[Dropped, ...], float]:
    """As `_offered`, with the weights that `offer` chooses."""
    return min((_offered(alone, left, before, item) for item in (None, weight)), key=lambda found: found[2])


def _offered(
    alone: Selection, left: Left, before: Residuals, weight: FloatArray | None
) -> tuple[Offer | None, tuple[Dropped, ...], float]:
    """As `offer` with one kind of base parameters, None: those of `alone`; and the sum of logarithms of what is left.

    Terms stay where they lower the RMS of their joint there and raise no other joint's by more than base parameters may
    (`harmless`), or beyond its noise. alone: classes with the weights of the fitted rows, beside the names. before:
    what the model with its names leaves of the held-out rows. A joint with terms has to do better than that, and better
    than the same model of the rows of `alone`: it is open in the same directions of the base parameters as they are.
    """

    def base_beside(selection: Selection) -> FloatArray | None:
        return None if weight is None else left.base_as_fitted(selection, weight)

    def left_of(selection: Selection) -> FloatArray:
        return replace(before, rows=left.of_rows(selection, base_beside(selection))[1]).rms_nm

    nominal = Selection.nominal(alone.rows.without_angles(), range(alone.rows.folds))
    plain = before.rms_nm
    best, allowed = np.minimum(plain, left_of(nominal)), plain

    selection, dropped = alone, tuple[Dropped, ...]()
    if alone.rows.problem.noise_is_measured:
        # Base parameters scatter: what a joint is left within that has no cause in the terms of another one.
        allowed = np.maximum(plain, before.noise_at_most_nm)
    else:
        selection, dropped = useful(alone, left_of, best)
    selection, more = harmless(selection, left_of, best, allowed)
    dropped += more
    if alone.rows.angles and (left_of(selection) > (1.0 + LEAST_CHANGE) * allowed).any():
        return None, dropped, np.inf
    if not any(state.groups for state in selection.states) and not selection.rows.angles:
        return None, dropped, float(np.log(plain).sum())
    base = base_beside(selection)
    fitted, unseen = left(selection, base)
    found = Offer(terms_of(selection), *base_parameters(selection, base), fitted, unseen)
    return found, dropped, float(np.log(unseen).sum())


def refusal(dropped: Sequence[Dropped]) -> str:
    """What of the torque without a name is not in the model, and why, in words."""
    listed = [
        f"joint {joint + 1}: {_short([CLASSES[number].name.replace('_', ' ') for _, number in group])}"
        for joint, group in groupby(sorted(dropped), key=lambda place: place[0])
    ]
    return (
        f"Some torque without a name is not part of the extended model ({'; '.join(listed)}): with it the error on "
        "data that were not fitted is larger. Fit a motion that covers the range of the other one."
    )


def _short(names: Sequence[str]) -> str:
    if len(names) > LISTED:
        return f"{', '.join(names[:LISTED])} and {len(names) - LISTED} more"
    return ", ".join(names)


def base_parameters(selection: Selection, base: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
    """Base parameters (p,) fitted beside the classes, with their deviations; what the rows leave open is zero.

    base: in the selection's own coordinates; None: those that it has, whose deviations stand for others too.
    """
    problem = selection.rows.problem
    factor, triangle, norms, _ = nominal_factor(problem)
    outer, singular, inner = np.linalg.svd(triangle)
    kept = singular > OPEN * singular[0]
    back = ((inner[kept].T / singular[kept]) @ outer[:, kept].T @ (factor.T @ problem.basis)) / norms[:, None]
    now = selection.posterior(0, selection.states[0])
    size = selection.rows.base
    values = back @ (problem.basis.T @ problem.torque + (now.base[:size] if base is None else base))
    first = now.covariance.shape[0] - now.base.size
    covariance = now.covariance[first : first + size, first : first + size]
    count = selection.rows.evidences[0].nominal.shape[2]
    std = np.sqrt(np.maximum(np.einsum("pk,km,pm->p", back, covariance, back), 0.0))
    return values[:count], std[:count]
