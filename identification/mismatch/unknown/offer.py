"""What of the classes goes into the extended model: terms beside the names that stand, where no joint gets worse.

Names keep their sizes; classes are chosen on what they leave, weights and base parameters come from the fitted rows,
and held-out rows say which joints may keep their terms. Without held-out rows nothing is offered.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from identification.mismatch.heldout import Residuals, worsened
from identification.mismatch.prepared import Prepared
from identification.mismatch.search.extension import OPEN, Extension, nominal_factor, predicted
from identification.mismatch.search.library import Library
from identification.mismatch.unknown.claims import Offer
from identification.mismatch.unknown.evidence import Hyper
from identification.mismatch.unknown.left import Left
from identification.mismatch.unknown.model_terms import terms_of
from identification.mismatch.unknown.selection import FULL_ROUNDS, Selection

FloatArray = npt.NDArray[np.float64]

LEAST_RISE = 0.01
"""Rise of a held-out RMS, as a share of it, that base parameters of another joint's terms may cause."""


def without_members(role: Prepared, extension: Extension, library: Library) -> Prepared:
    """The same rows with the torque of the names taken off; base parameters stay in it."""
    if not extension.members:
        return role
    size = role.evidences[0].nominal.shape[2]
    nothing = replace(extension, base=np.zeros(size))
    nominal = np.concatenate([item.nominal for item in role.evidences]).transpose(1, 0, 2)
    taken = predicted(nothing, nominal, library).T
    cuts = np.cumsum([item.frequency.size for item in role.evidences])[:-1]
    return replace(
        role, torque=tuple(rows - part for rows, part in zip(role.torque, np.split(taken, cuts), strict=True))
    )


def offer(alone: Selection, left: Left, before: Residuals) -> tuple[Offer | None, tuple[int, ...]]:
    """The terms that predict held-out rows, None where none are left; and the joints (from 1) whose terms do not.

    A joint keeps its terms where they lower its RMS there, and no other joint may get worse beyond what its rows allow.
    alone: classes with the weights of the fitted rows, beside the names. before: what the model with its names leaves
    of the held-out rows.
    """
    selection, given_up = alone, set[int]()
    while any(state.groups for state in selection.states):
        now = replace(before, rows=left.of_rows(selection)[1])
        rise = now.rms_nm / before.rms_nm - 1.0
        held = np.array([bool(state.groups) for state in selection.states])
        refused = worsened(before, now) | (rise >= np.where(held, 0.0, LEAST_RISE))
        if not refused.any():
            fitted, unseen = left(selection)
            found = Offer(terms_of(selection), *base_parameters(selection), fitted, unseen)
            return found, tuple(sorted(given_up))
        # A joint without terms gets worse through base parameters: then the one that gains least by its own gives in.
        own = refused & held
        joint = int(np.argmax(np.where(own if own.any() else held, rise, -np.inf)))
        given_up.add(joint + 1)
        selection = _without_terms(selection, joint)
    return None, tuple(sorted(given_up))


def _without_terms(selection: Selection, joint: int) -> Selection:
    """A selection without the classes of one joint, all joints estimated anew."""
    empty = Hyper(np.zeros(0), selection.states[joint].hyper.noise)
    result = selection.with_state(joint, selection.state(joint, (), empty))
    for other in range(len(result.states)):
        result.states[other] = result.settled(other, result.states[other], FULL_ROUNDS)
    return result


def refusal(joints: Sequence[int]) -> str:
    """Why joints (from 1) have no terms in the model, in words."""
    named = ", ".join(map(str, joints))
    return (
        f"Joint{'s' if len(joints) > 1 else ''} {named}: torque without a name is not part of the extended model: it "
        "makes the error on data that were not fitted larger. Fit a motion that covers the range of the other one."
    )


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
