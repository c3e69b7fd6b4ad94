"""What a motion can show of each effect, before or after it is recorded: absorbed share, smallest size.

The nominal parameters take up part of every effect; only the rest can be seen (Frisch, Waugh, Lovell). From the rest
and the noise follow the smallest size that shows, how far the parameters move when the effect is real and not modelled,
and which effects look alike. No measured torque is used.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from identification.arrays import FloatArray
from identification.base_parameters import BaseRegressor
from identification.mismatch.effects import EFFECTS
from identification.mismatch.effects.base import Effect, Estimate, Parameter, Place
from identification.mismatch.effects.equivalence import Relation, relation
from identification.mismatch.evidence import PlannedRows, Rows
from identification.mismatch.motion import Motion
from identification.mismatch.problem import orthonormal
from identification.mismatch.search.library import evaluate
from identification.mismatch.settings import ROUNDING, DiagnosisSettings
from identification.signals.periodic import to_lines

ORACLE_STRENGTH = 24.0
"""λ at which a test that knows the effect's waveform sees it in 99 % of recordings, at 1 % false alarms."""


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """An effect at one place with one shape, after the nominal columns are projected off.

    strength: (m, m) CᵀC of the whitened rest: λ of coefficients c is cᵀ strength c. energy: (m,) the same diagonal
    before projecting. space: (rows, r) orthonormal columns of the rest, r ≤ m; empty where nothing is left.
    """

    effect: Effect
    place: Place
    shape: Mapping[str, float]
    strength: FloatArray
    energy: FloatArray
    space: FloatArray

    @property
    def leading(self) -> FloatArray:
        """Coefficients (m,) that share the first one's unit, as 0 and 1: sine and cosine, two bending moments."""
        units = self.effect.units
        count = self.energy.size
        return np.array([index < len(units) and units[index] == units[0] for index in range(count)], dtype=np.float64)

    @property
    def absorbed_fraction(self) -> float:
        """Share of the effect's energy that the nominal parameters take up, over the leading coefficients."""
        whole = float(self.leading @ self.energy)
        left = float(self.leading @ np.diag(self.strength))
        return 1.0 - max(0.0, left) / whole if whole > 0.0 else 1.0

    @property
    def identifiable(self) -> bool:
        """Whether anything is left to be seen."""
        return 1.0 - self.absorbed_fraction > ROUNDING

    def smallest(self, needed: float = ORACLE_STRENGTH) -> Parameter:
        """Smallest size with λ = needed, as the effect's first parameter; inf (its unit) where nothing is left.

        Over a pair of coefficients: the root mean square over their directions.
        """
        leading = self.leading
        unit_strength = float(leading @ np.diag(self.strength)) / float(leading.sum())
        coefficients = np.zeros(leading.size)
        coefficients[0] = math.sqrt(needed / unit_strength) if self.identifiable else 1.0
        size = self.effect.parameters(
            Estimate(self.place, self.shape, coefficients, np.zeros((leading.size, leading.size)))
        )[0]
        return size if self.identifiable else Parameter(size.name, math.inf, size.std, size.unit)


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """Two candidates that look alike after projection."""

    first: Candidate
    second: Candidate
    relation: Relation


def planned_rows(motion: Motion, regressor: BaseRegressor, noise_nm: FloatArray, *, periods: int = 1) -> PlannedRows:
    """Rows of a periodic motion before it is recorded, lines 0 to the bandwidth that torque is compared in.

    noise_nm: (n,) standard deviation of white torque noise per sample of one period; the mean of K periods has 1/√K.
    """
    duration = motion.samples * motion.sampling_period_s
    lines = min(int(DiagnosisSettings().torque_bandwidth_hz * duration), (motion.samples - 1) // 2)
    nominal = to_lines(regressor.matrix(motion.position, motion.velocity, motion.acceleration), lines)
    noise = np.broadcast_to(np.asarray(noise_nm) / math.sqrt(periods), nominal.shape[:2])
    return PlannedRows(motion, lambda values: to_lines(values, lines), nominal, noise)


def candidates(rows: Sequence[Rows], effects: Sequence[Effect] = EFFECTS) -> tuple[Candidate, ...]:
    """All repeatable effects at all places, at the middle of their grids.

    rows: one or several stretches that are fitted together. Effects that exert no torque on any of them are left out.
    """
    nominal = np.concatenate([_whitened(part.nominal, part.noise) for part in rows], axis=1)
    joints, count, parameters = nominal.shape
    blocks = orthonormal(nominal.reshape(joints * count, parameters)).reshape(joints, count, -1)
    found = []
    noise = np.concatenate([part.noise for part in rows])
    for effect, place, shape in _points(rows[0].motion, effects):
        seen = evaluate(effect, place, shape, rows)
        if seen is None:
            continue
        touched = list(seen.joints)
        values = seen.rows / noise.T[touched][..., None]
        coordinates = np.einsum("jrp,jrm->pm", blocks[touched], values)
        left = -np.einsum("jrp,pm->jrm", blocks, coordinates)
        left[touched] += values
        rest = left.reshape(joints * count, -1)
        energy = np.einsum("jrm,jrm->m", values, values)
        found.append(Candidate(effect, place, shape, rest.T @ rest, energy, _space(rest, energy)))
    return tuple(found)


def confusable(found: Sequence[Candidate], cosine: float = 0.9) -> tuple[Pair, ...]:
    """Pairs of another effect or another place whose rests come closer than this cosine, the closest first."""
    pairs = []
    for first, second in combinations(found, 2):
        if (first.effect.name, first.place) == (second.effect.name, second.place):
            continue
        between = relation(first.space, second.space)
        if between.cosine >= cosine:
            pairs.append(Pair(first, second, between))
    return tuple(sorted(pairs, key=lambda pair: -pair.relation.cosine))


def _points(motion: Motion, effects: Sequence[Effect]) -> Iterator[tuple[Effect, Place, dict[str, float]]]:
    for effect in effects:
        if effect.stage != "repeatable":
            continue
        for place in effect.places(motion):
            shapes = effect.shape_parameters(motion, place)
            yield effect, place, {shape.name: shape.grid[len(shape.grid) // 2] for shape in shapes}


def _whitened(values: FloatArray, noise: FloatArray) -> FloatArray:
    """(R, n, m) in units of the noise (R, n), as (n, R, m)."""
    return np.ascontiguousarray((values / noise[..., None]).transpose(1, 0, 2))


def _space(rest: FloatArray, energy: FloatArray) -> FloatArray:
    """Orthonormal columns of what is left, without directions that are rounding of the whole."""
    scale = np.sqrt(np.where(energy > 0.0, energy, 1.0))
    left, values, _ = np.linalg.svd(rest / scale, full_matrices=False)
    return np.asarray(left[:, values > math.sqrt(ROUNDING)])
