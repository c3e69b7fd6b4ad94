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
from identification.mismatch.unknown.left import Left
from identification.mismatch.unknown.model_terms import terms_of
from identification.mismatch.unknown.predictive import Dropped, harmless, useful
from identification.mismatch.unknown.selection import Selection

LISTED = 3
"""Classes of a joint that a sentence lists by name."""


def offer(alone: Selection, left: Left, before: Residuals) -> tuple[Offer | None, tuple[Dropped, ...]]:
    """The terms that predict held-out rows, None where none are left; and what is left out as it does not.

    Terms stay where they lower the RMS of their joint there and raise no other joint's by more than base parameters may
    (`harmless`). alone: classes with the weights of the fitted rows, beside the names. before: what the model with its
    names leaves of the held-out rows. A joint with terms has to do better than that, and better than the same model of
    the rows of `alone`: it is open in the same directions of the base parameters as they are.
    """
    nominal = Selection.nominal(alone.rows, range(alone.rows.folds))
    plain = before.rms_nm
    best = np.minimum(plain, replace(before, rows=left.of_rows(nominal)[1]).rms_nm)

    def left_of(selection: Selection) -> FloatArray:
        return replace(before, rows=left.of_rows(selection)[1]).rms_nm

    selection, dropped = alone, tuple[Dropped, ...]()
    if not alone.rows.problem.noise_is_measured:
        selection, dropped = useful(alone, left_of, best)
    selection, more = harmless(selection, left_of, best, plain)
    dropped += more
    if not any(state.groups for state in selection.states):
        return None, dropped
    fitted, unseen = left(selection)
    return Offer(terms_of(selection), *base_parameters(selection), fitted, unseen), dropped


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


def base_parameters(selection: Selection) -> tuple[FloatArray, FloatArray]:
    """Base parameters (p,) fitted beside the classes, with their deviations; what the rows leave open is zero."""
    problem = selection.rows.problem
    factor, triangle, norms, _ = nominal_factor(problem)
    outer, singular, inner = np.linalg.svd(triangle)
    kept = singular > OPEN * singular[0]
    back = ((inner[kept].T / singular[kept]) @ outer[:, kept].T @ (factor.T @ problem.basis)) / norms[:, None]
    now = selection.posterior(0, selection.states[0])
    values = back @ (problem.basis.T @ problem.torque + now.base)
    size = now.base.size
    covariance = now.covariance[-size:, -size:]
    count = selection.rows.evidences[0].nominal.shape[2]
    std = np.sqrt(np.maximum(np.einsum("pk,km,pm->p", back, covariance, back), 0.0))
    return values[:count], std[:count]
