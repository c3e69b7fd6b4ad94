"""Every form of the library against what base parameters and classes leave: which ones are worth a closer look.

Quick, because the variances of classes and of the noise are those without any form. What a form is worth beside classes
of its own is asked afterwards, of the best ones (`assessment`).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from identification.arrays import FloatArray
from identification.investigation.columns import Form, forms_of, stacked
from identification.mismatch.effects.base import Effect, Place
from identification.mismatch.evidence import Evidence
from identification.mismatch.unknown.selection import Selection

_VISIBLE = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Weighting:
    """Rows of all evidences whitened, classes counted as noise. weight: (n, R). basis: per joint (R, q) orthonormal.

    shrink: per joint (q,) share taken off along each. nominal: per joint (R, p). left: (n, R) torque that nominal
    columns leave. inverse: (p, p) of their normal equations.
    """

    weight: FloatArray
    basis: tuple[FloatArray, ...]
    shrink: tuple[FloatArray, ...]
    nominal: tuple[FloatArray, ...]
    left: FloatArray
    inverse: FloatArray

    @classmethod
    def of(cls, selection: Selection) -> Weighting:
        """Under the classes and the noise of a selection."""
        rows = selection.rows
        weight, basis, shrink, nominal, torque = [], [], [], [], []
        for joint, state in enumerate(selection.states):
            own = rows.problem.weight[joint] / np.sqrt(state.hyper.noise[rows.band])
            root = np.sqrt(state.hyper.variance[state.gram.group]) if state.groups else np.zeros(0)
            scale = 1.0 / np.sqrt(state.hyper.noise[rows.band])
            columns = rows.joints[joint].whitened[:, selection.columns(joint, state)] * root * scale[:, None]
            square, vectors = np.linalg.eigh(columns.T @ columns)
            seen = square > 1e-8
            weight.append(own)
            basis.append(columns @ (vectors[:, seen] / np.sqrt(square[seen])))
            shrink.append(1.0 - 1.0 / np.sqrt(1.0 + square[seen]))
            block = rows.problem.nominal[joint] * own[:, None]
            measured = rows.problem.torque.reshape(rows.problem.weight.shape)[joint] * scale
            nominal.append(_off(block, basis[-1], shrink[-1]))
            torque.append(_off(measured, basis[-1], shrink[-1]))
        gram = np.sum([part.T @ part for part in nominal], axis=0)
        size = 1.0 / np.sqrt(np.maximum(np.diag(gram), 1e-300))
        inverse = np.linalg.pinv(gram * np.outer(size, size), 1e-12, hermitian=True) * np.outer(size, size)
        values = inverse @ np.sum([part.T @ t for part, t in zip(nominal, torque, strict=True)], axis=0)
        left = np.stack([t - part @ values for part, t in zip(nominal, torque, strict=True)])
        return cls(np.stack(weight), tuple(basis), tuple(shrink), tuple(nominal), left, inverse)

    def gain(self, joints: Sequence[int], columns: FloatArray) -> tuple[float, FloatArray]:
        """Nats that columns (len(joints), R, m) Nm explain at best, and their coefficients (m,)."""
        size = columns.shape[2]
        strength, across = np.zeros((size, size)), np.zeros(size)
        shared = np.zeros((len(self.inverse), size))
        for joint, part in zip(joints, columns, strict=True):
            own = _off(part * self.weight[joint][:, None], self.basis[joint], self.shrink[joint])
            strength += own.T @ own
            shared += self.nominal[joint].T @ own
            across += own.T @ self.left[joint]
        energy = float(np.trace(strength))
        strength -= shared.T @ self.inverse @ shared
        if energy <= 0.0 or float(np.trace(strength)) < _VISIBLE * energy:
            return 0.0, np.zeros(size)
        coefficients = np.linalg.pinv(strength, 1e-9, hermitian=True) @ across
        return 0.5 * float(across @ coefficients), coefficients


def _off(values: FloatArray, basis: FloatArray, shrink: FloatArray) -> FloatArray:
    turned = basis.T @ values
    return np.asarray(values - basis @ (shrink.reshape(-1, *[1] * (values.ndim - 1)) * turned))


@dataclass(frozen=True, slots=True, eq=False)
class Screened:
    """The shape that a weighting likes best of an effect at a place. gain: nats. spread: nats, ≤ 0, of the choice."""

    effect: Effect
    place: Place
    forms: tuple[Form, ...]
    best: Form
    gain: float
    coefficients: FloatArray
    spread: float


def screen(
    rows: Sequence[Evidence], weightings: Sequence[Weighting], skip: Collection[tuple[str, Place]]
) -> tuple[list[list[Screened]], int]:
    """Per weighting, every effect at every place with its best shape; and how many there are in all.

    What nothing is seen of, and one-sided effects of the wrong sign, gain nothing.
    """
    found: list[list[Screened]] = [[] for _ in weightings]
    everything = tuple(forms_of(rows[0].motion))
    for effect, place, forms in everything:
        if (effect.name, place) in skip:
            continue
        scored: list[list[tuple[float, FloatArray]]] = [[] for _ in weightings]
        for form in forms:
            joints, columns = stacked(rows, form)
            for number, weighting in enumerate(weightings):
                gain, coefficients = weighting.gain(joints, columns)
                scored[number].append((0.0 if effect.is_impossible(coefficients) else gain, coefficients))
        for number, values in enumerate(scored):
            gains = np.array([gain for gain, _ in values])
            best = int(gains.argmax())
            spread = float(np.log(np.mean(np.exp(gains - gains[best]))))
            found[number].append(Screened(effect, place, forms, forms[best], *values[best], spread))
    return found, len(everything)
