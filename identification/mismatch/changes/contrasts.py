"""The space of what differs between the periods of one recording: whitened, without their mean and their seams.

Noise that is not periodic ends a period elsewhere than it began. That leaves a jump of its own at every seam, which
fades as fast as the noise forgets: within milliseconds, or by a ramp over the whole period. Its lines are not
independent. So jumps that fade within any such time are given away, in each period and joint.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc

from identification.arrays import FloatArray
from identification.mismatch.effects.base import Place
from identification.mismatch.effects.enveloped import EnvelopedEffect
from identification.mismatch.evidence import Evidence
from identification.mismatch.noise import NEIGHBOURS_OF_LINE_ZERO
from identification.mismatch.settings import ROUNDING

FORGETS_S = np.geomspace(0.003, 1.0, 6)
"""Times within which noise forgets, so that a jump where a period ends fades; the ramp stands beside them."""


def log10_chance(tail: float, tests: float) -> float:
    """log10 of the chance that one of so many tests of noise goes beyond what one alone does with chance `tail`
    (Bonferroni); minus infinity where the tail is too small for a float.
    """
    return min(0.0, math.log10(tail * max(tests, 1.0))) if tail > 0.0 else -math.inf


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """Least squares of columns on the contrasts. gain: drop of the whitened squares. coefficients: (m,), covariance
    (m, m). rank: directions that the columns really have. freedom: degrees of freedom of the noise estimate behind
    the gain (Satterthwaite: lines weighted by the energy they contribute).
    """

    gain: float
    coefficients: FloatArray
    covariance: FloatArray
    rank: int
    freedom: float

    def log10_chance(self, tests: float, extra_parameters: int = 0, dispersion: float = 1.0) -> float:
        """log10 of the chance to see this gain somewhere in so many tests of noise (Bonferroni)."""
        dof = self.rank + extra_parameters
        return log10_chance(float(fdtrc(dof, self.freedom, self.gain / dispersion / dof)), tests)

    def score(self, tests: float) -> float:
        """Half the gain in log-likelihood units, less what so many tests and columns gain on white noise."""
        return 0.5 * (self.gain - self.rank) - float(np.log(max(tests, 1.0)))


class Contrasts:
    """The whitened contrasts of one recording.

    z: (K, R, n) period rows over the standard deviation of one period's noise, less their mean over the periods and
    what may be a jump at each period's seam. seam: (R, n, m) the jumps that are given away, whitened, orthonormal.
    Rows that do not count are zero.
    """

    def __init__(self, evidence: Evidence) -> None:
        assert evidence.period_torque is not None
        self.evidence = evidence
        self.motion = evidence.motion
        self.periods = evidence.periods
        deviation = np.sqrt(evidence.periods) * evidence.noise
        self.weight: FloatArray = np.where(evidence.used, 1.0 / np.maximum(deviation, 1e-300), 0.0)
        self.seam: FloatArray = _seam(evidence, self.weight)
        self.z: FloatArray = self.whiten(evidence.period_torque[..., None], range(evidence.n))[..., 0]
        self._repeated: dict[tuple[str, Place, tuple[float, ...]], tuple[tuple[int, ...], FloatArray, FloatArray]] = {}

    def whiten(self, rows: FloatArray, joints: Sequence[int]) -> FloatArray:
        """(K, R, J, m) rows of every period → the same, whitened, without seams and without their mean over K."""
        return self.whiten_repeated(rows - rows.mean(axis=0), joints)

    def whiten_repeated(self, rows: FloatArray, joints: Sequence[int]) -> FloatArray:
        """(…, R, J, m) rows of periods → whitened and without the seam; for contrasts that only weight periods."""
        return self.without_seam(rows * self.weight[:, list(joints), None], joints)

    def without_seam(self, rows: FloatArray, joints: Sequence[int]) -> FloatArray:
        """(…, R, J, m) whitened rows → the same, without their part in the seam."""
        seam = self.seam[:, list(joints)].transpose(1, 0, 2)
        by_joint = rows.swapaxes(-3, -2)
        return np.asarray(rows - (seam @ (seam.swapaxes(1, 2) @ by_joint)).swapaxes(-3, -2))

    def repeated(
        self, effect: EnvelopedEffect, place: Place, shape: Mapping[str, float]
    ) -> tuple[tuple[int, ...], FloatArray, FloatArray] | None:
        """Joints, columns (S, J, m) and their rows (R, J, m) of an effect under an envelope of 1; kept for reuse."""
        key = (effect.name, place, tuple(value for name, value in sorted(shape.items()) if name.startswith("point_")))
        if key not in self._repeated:
            found = effect.repeated_columns(self.motion, place, shape)
            if found is None:
                return None
            self._repeated[key] = (*found, self.evidence.project(found[1]))
        return self._repeated[key]

    def rows(
        self, effect: EnvelopedEffect, place: Place, shape: Mapping[str, float], columns: slice = slice(None)
    ) -> tuple[tuple[int, ...], FloatArray]:
        """Joints and rows (K, R, J, m) of an effect; only periods in which the envelope varies are projected anew."""
        found = self.repeated(effect, place, shape)
        assert found is not None
        joints, values, constant = found
        values, constant = values[..., columns], constant[..., columns]
        result = np.empty((self.periods, *constant.shape))
        for period, factor in enumerate(effect.envelope(self.motion, shape)):
            if np.ptp(factor) == 0.0:
                result[period] = factor[0] * constant
            else:
                result[period] = self.evidence.project(factor[:, None, None] * values)
        return joints, result

    def pieces(
        self, effect: EnvelopedEffect, place: Place, shape: Mapping[str, float], columns: slice = slice(None)
    ) -> tuple[tuple[int, ...], FloatArray, list[FloatArray]]:
        """An effect's rows as a few patterns: joints, weights (P, K) and whitened rows (R, J, m) of each pattern.

        All periods with a constant envelope share one pattern; a period without the effect has none.
        """
        found = self.repeated(effect, place, shape)
        assert found is not None
        joints, values, constant = found
        factors = effect.envelope(self.motion, shape)
        return joints, *self.patterns(factors, joints, values[..., columns], constant[..., columns])

    def patterns(
        self, factors: FloatArray, joints: Sequence[int], values: FloatArray, rows: FloatArray
    ) -> tuple[FloatArray, list[FloatArray]]:
        """Weights and patterns, as of `pieces`, of columns (S, J, m) with rows (R, J, m) under factors (K, S)."""
        flat = np.ptp(factors, axis=1) == 0.0
        weights, patterns = [], []
        if np.any(factors[flat] != 0.0):
            weights.append(np.where(flat, factors[:, 0], 0.0))
            patterns.append(self.whiten_repeated(rows, joints))
        for period in np.flatnonzero(~flat):
            weights.append((np.arange(self.periods) == period).astype(float))
            varying = self.evidence.project(factors[period][:, None, None] * values)
            patterns.append(self.whiten_repeated(varying, joints))
        return np.array(weights), patterns

    def fit_pieces(self, joints: Sequence[int], weights: FloatArray, patterns: Sequence[FloatArray]) -> Fit:
        """As `fit`, for columns Σ weights[p, k] · patterns[p]; costs go with the number of patterns, not of periods."""
        if not patterns:
            return Fit(0.0, np.zeros(1), np.zeros((1, 1)), 0, 1.0)
        size = patterns[0].shape[-1]
        centred = weights - weights.mean(axis=1, keepdims=True)
        products = centred @ centred.T
        flat = [pattern.reshape(-1, size) for pattern in patterns]
        seen = np.einsum("pk,krj->prj", weights, self.z[:, :, list(joints)]).reshape(len(patterns), -1)
        gram = np.zeros((size, size))
        for p, first in enumerate(flat):
            for q in range(p, len(flat)):
                if products[p, q] != 0.0:
                    block = products[p, q] * (first.T @ flat[q])
                    gram += block if p == q else block + block.T
        right = np.sum([pattern.T @ target for pattern, target in zip(flat, seen, strict=True)], axis=0)
        coefficients, covariance, rank = solve(gram, right)
        torque = np.stack([pattern @ coefficients for pattern in patterns])
        share = np.einsum("prj,pq,qrj->rj", torque, products, torque, optimize=True)
        return Fit(float(right @ coefficients), coefficients, covariance, rank, self.freedom(share))

    def fit(self, white: FloatArray, joints: Sequence[int]) -> Fit:
        """Fit whitened columns (K, R, J, m) to the contrasts of those joints."""
        size = white.shape[-1]
        matrix = white.reshape(-1, size)
        right = np.ascontiguousarray(self.z[:, :, list(joints)]).reshape(-1)
        gram, projected = matrix.T @ matrix, matrix.T @ right
        coefficients, covariance, rank = solve(gram, projected)
        share = ((white @ coefficients) ** 2).sum(axis=0)
        return Fit(
            gain=float(projected @ coefficients),
            coefficients=coefficients,
            covariance=covariance,
            rank=rank,
            freedom=self.freedom(share),
        )

    def freedom(self, share: FloatArray) -> float:
        """Degrees of freedom behind a statistic to which rows (R, J) contribute these energies."""
        lines = np.concatenate([share[:1], share[1::2] + share[2::2]])
        total = float(lines.sum())
        if total <= 0.0:
            return 1.0
        # Line 0 is measured by its neighbours here: a change widens its own scatter, and what that says beyond theirs
        # is in the dispersion. All joints have the same periods and lines.
        others = self.evidence.noise_freedom[1::2, 0]
        per_line = np.concatenate([NEIGHBOURS_OF_LINE_ZERO * others[:1], others])
        return float(1.0 / ((lines / total) ** 2 / per_line[:, None]).sum())


def _seam(evidence: Evidence, weight: FloatArray) -> FloatArray:
    """(R, n, m) orthonormal whitened rows of a jump where a period ends, over FORGETS_S and over the whole period."""
    time = evidence.motion.time[:, None]
    length = evidence.motion.samples * evidence.motion.sampling_period_s
    jumps = [
        np.linspace(-1.0, 1.0, len(time))[:, None],
        np.exp(-(length - time) / FORGETS_S) - np.exp(-time / FORGETS_S),
    ]
    rows = evidence.project(np.concatenate(jumps, axis=1))
    return np.stack([np.linalg.qr(rows * own[:, None])[0] for own in weight.T], axis=1)


def solve(gram: FloatArray, right: FloatArray) -> tuple[FloatArray, FloatArray, int]:
    """Least squares from normal equations with scaled columns; directions the data do not have are left at zero."""
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    values, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
    kept = values > ROUNDING * max(float(values[-1]), 1e-300)
    inverse = (vectors[:, kept] / values[kept]) @ vectors[:, kept].T / np.outer(scale, scale)
    return np.asarray(inverse @ right), np.asarray(inverse), int(kept.sum())
