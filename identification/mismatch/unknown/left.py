"""What classes leave of the fitted and of the held-out rows, their weights from the fitted ones alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.problem import off
from identification.mismatch.settings import OPEN_BEYOND_NOISE
from identification.mismatch.unknown.evidence import FREE
from identification.mismatch.unknown.rows import Rows
from identification.mismatch.unknown.selection import FULL_ROUNDS, Selection


@dataclass(frozen=True, slots=True, eq=False)
class Left:
    """RMS (n,) Nm of what selections leave on the fitted and on the held-out rows (empty without any).

    free: (n R', k) whitened directions of held-out rows along which base parameters may go that the fitted rows leave
    open (as in `heldout`).
    """

    rows: Rows
    free: FloatArray

    @classmethod
    def of(cls, rows: Rows) -> Left:
        """For selections from these rows, or from the same ones with another torque."""
        base = [joint.whitened[:, joint.columns : joint.columns + rows.base] for joint in rows.joints]
        if not rows.heldout:
            return cls(rows, np.zeros((0, 0)))
        there = rows.part >= rows.folds
        values, vectors = np.linalg.eigh(np.sum([part[~there].T @ part[~there] for part in base], axis=0))
        spread = np.concatenate([part[there] for part in base]) @ (vectors / np.sqrt(np.maximum(values, FREE)))
        scale, turned = np.linalg.eigh(spread.T @ spread)
        chosen = scale > OPEN_BEYOND_NOISE**2
        return cls(rows, spread @ (turned[:, chosen] / np.sqrt(scale[chosen])))

    def __call__(self, selection: Selection, base: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
        """Fitted and held-out RMS under a selection from rows of these evidences; base: as in `of_rows`."""
        fitted, unseen = self.of_rows(selection, base)
        return _rms(fitted, self.rows.samples[0]), _rms(unseen, self.rows.samples[1])

    def of_rows(self, selection: Selection, base: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
        """Rows (n, R) and (n, R') Nm themselves, zero where they do not count.

        base: (p,) parameters beside the classes; None: those of the selection.
        """
        rows, there = selection.rows, self.rows.part >= self.rows.folds
        problem = rows.problem
        parts = [base_of(selection, joint) for joint in range(problem.n)]
        found = selection.mean(0, selection.states[0])[1][: rows.base] if base is None else base
        left = np.array([torque - columns @ found for columns, torque in parts])
        if rows.heldout:
            left[:, there] = off(self.free, left[:, there].ravel()).reshape(problem.n, -1)
        left = np.where(problem.weight > 0.0, left * problem.noise, 0.0)
        return left[:, ~there], left[:, there]

    def base_as_fitted(self, selection: Selection, weight: FloatArray) -> FloatArray:
        """(p,) base parameters beside the classes of a selection, fitted with these weights (n, R) of the fitted rows.

        The selection's own weights are of what classes leave: where that is little they pull base parameters from other
        joints, and a model without classes would not be the fit's.
        """
        problem, there = selection.rows.problem, self.rows.part >= self.rows.folds
        scale = (weight * problem.noise[:, ~there])[..., None]
        parts = [base_of(selection, joint) for joint in range(problem.n)]
        columns = [own * part[~there] for (part, _), own in zip(parts, scale, strict=True)]
        torque = [own[:, 0] * part[~there] for (_, part), own in zip(parts, scale, strict=True)]
        values, vectors = np.linalg.eigh(sum(part.T @ part for part in columns))
        product = sum(part.T @ left for part, left in zip(columns, torque, strict=True))
        return np.asarray(vectors @ ((vectors.T @ product) / np.maximum(values, FREE)))


def base_of(selection: Selection, joint: int) -> tuple[FloatArray, FloatArray]:
    """Whitened columns (R, p) of the base parameters of a joint (from 0), and its torque (R,) less its classes."""
    state, rows = selection.states[joint], selection.rows.joints[joint]
    weights, beside = selection.mean(joint, state)
    first, size = rows.columns, selection.rows.base
    torque = rows.whitened[:, -1] - rows.whitened[:, selection.columns(joint, state)] @ weights
    torque -= rows.whitened[:, first + size : -1] @ beside[size:]
    return rows.whitened[:, first : first + size], torque


def shortened(selection: Selection, joint: int, numbers: Sequence[int]) -> Selection:
    """A selection without some classes of one joint (from 0), that joint estimated anew."""
    shorter = selection.without(joint, selection.states[joint], numbers)
    return selection.with_state(joint, selection.settled(joint, shorter, FULL_ROUNDS))


def _rms(left: FloatArray, samples: int) -> FloatArray:
    return np.asarray(np.sqrt((left**2).sum(axis=1) / samples)) if samples else np.zeros(0)
