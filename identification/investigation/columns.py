"""Hypotheses as torque columns, and recordings, made or planned, as normal equations of them and the base parameters.

Normal equations of several recordings add up, so that "all evidence and one motion more" is a sum of two matrices.
Here: the columns on recorded and planned rows, and the sums. Not here: which hypotheses there are (`hypotheses`), nor
what follows from the sums (`separation`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from identification.arrays import FloatArray, IntArray
from identification.base_parameters import BaseRegressor
from identification.investigation.discrepancy import Discrepancies
from identification.mismatch.effects import EFFECTS, effect_named
from identification.mismatch.effects.base import Effect, Place
from identification.mismatch.evidence import Evidence, PlannedRows, Rows
from identification.mismatch.motion import Motion
from identification.mismatch.search.library import evaluate, grid_of
from identification.signals.periodic import differentiate_harmonics, to_lines
from identification.signals.standstill import over_standstills

PLAN_RATE_HZ = 250.0
"""Rate at which planned motions are looked at: four times the widest compared band."""
_RANK = 1e-10


@dataclass(frozen=True, slots=True)
class Form:
    """One torque that may be missing: an effect of the library at a place with its nonlinear parameters fixed."""

    effect: str
    place: Place
    shape: tuple[tuple[str, float], ...]

    @classmethod
    def of(cls, effect: str, place: Place, shape: Mapping[str, float]) -> Form:
        """The form with these nonlinear parameters."""
        return cls(effect, place, tuple(sorted(shape.items())))

    @property
    def size(self) -> int:
        """Number of coefficients."""
        return len(effect_named(self.effect).units)


def forms_of(motion: Motion) -> Iterator[tuple[Effect, Place, tuple[Form, ...]]]:
    """Every repeatable effect at every place, with a form for each point of its grid."""
    for effect in EFFECTS:
        if effect.stage != "repeatable":
            continue
        for place in effect.places(motion):
            shapes = grid_of(effect, place, motion)
            yield effect, place, tuple(Form.of(effect.name, place, dict(shape)) for shape in shapes)


@dataclass(frozen=True, eq=False)
class Sums:
    """Normal equations of base parameters (p) and of the columns of some forms (m): gram (p + m, p + m), and p.

    classes: per joint, those of the columns of classes (q): (q, q + p + m). Not slotted: what is asked is kept.
    """

    gram: FloatArray
    base: int
    classes: tuple[FloatArray, ...] = ()

    def __add__(self, other: Sums) -> Sums:
        """Those of both recordings together."""
        classes = tuple(own + more for own, more in zip(self.classes, other.classes, strict=True))
        return Sums(self.gram + other.gram, self.base, classes)

    def projected(
        self, deviations: Sequence[FloatArray] = (), beside: tuple[int, IntArray] | None = None
    ) -> FloatArray:
        """(m, m) of the columns after base parameters and classes took up what they can.

        deviations: per joint (q,) Nm, how large the weight of each column of the classes may be beforehand. beside: a
        joint, from 0, and places of k columns of its classes that are kept behind the others: (m + k, m + k).
        """
        p, size = self.base, len(self.gram)
        joint, kept = beside if beside is not None else (-1, np.zeros(0, dtype=np.int64))
        gram = np.zeros((size + kept.size, size + kept.size))
        gram[:size, :size] = self.gram
        if kept.size:
            own = self.classes[joint]
            gram[size:, :size] = own[kept, len(own) :]
            gram[:size, size:] = gram[size:, :size].T
            gram[size:, size:] = own[kept[:, None], kept]
        for number, spread in enumerate(deviations):
            further = kept if number == joint else kept[:0]
            there = size + further.size
            gram[:there, :there] -= self._taken_up(number, spread, further)
        base = gram[:p, :p]
        across = gram[:p, p:]
        rest = gram[p:, p:] - across.T @ scaled_inverse(base) @ across
        return np.asarray(0.5 * (rest + rest.T))

    @cached_property
    def _known(self) -> dict[tuple[int, bytes, bytes], FloatArray]:
        return {}

    def _taken_up(self, joint: int, spread: FloatArray, kept: IntArray) -> FloatArray:
        """(size + k, size + k) what classes of a joint take off the columns, and off k of their own that are kept.

        Most hypotheses have the same classes on most joints.
        """
        key = joint, spread.tobytes(), kept.tobytes()
        if key in self._known:
            return self._known[key]
        own = self.classes[joint]
        across = np.concatenate([own[:, len(own) :], own[:, kept]], axis=1)
        # What no motion so far has reached takes up nothing.
        there = np.flatnonzero(spread * np.diagonal(own))
        root = spread[there]
        inner = root[:, None] * own[there[:, None], there] * root
        inner[np.diag_indices(there.size)] += 1.0
        factor = cholesky(inner, lower=True, check_finite=False) if there.size else inner
        half = solve_triangular(factor, root[:, None] * across[there], lower=True, check_finite=False)
        self._known[key] = half.T @ half
        return self._known[key]


def scaled_inverse(gram: FloatArray) -> FloatArray:
    """Pseudo-inverse of a Gram matrix, its columns scaled to one."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(gram), 1e-300))
    return np.asarray(np.linalg.pinv(gram * np.outer(scale, scale), _RANK, hermitian=True) * np.outer(scale, scale))


@dataclass(frozen=True, slots=True, eq=False)
class Whitened:
    """One recording's columns of base parameters (p) and forms over their noise, (R, n, p + m), and its rows."""

    rows: Rows
    columns: FloatArray

    @classmethod
    def of(cls, rows: Rows, forms: Sequence[Form], extra: FloatArray | None = None) -> Whitened:
        """extra: (R, n, k) further columns, put behind those of the forms."""
        parts = [rows.nominal, *(form_rows(rows, form) for form in forms), *([] if extra is None else [extra])]
        columns = np.concatenate(parts, axis=2) / rows.noise[..., None]
        used = getattr(rows, "used", None)
        return cls(rows, columns if used is None else np.where(used[..., None], columns, 0.0))

    def sums(self, beside: Discrepancies | None = None) -> Sums:
        """Normal equations. beside: classes whose columns are kept apart."""
        flat = self.columns.reshape(-1, self.columns.shape[2])
        return Sums(flat.T @ flat, self.rows.nominal.shape[2], self.classes(beside))

    def classes(self, beside: Discrepancies | None) -> tuple[FloatArray, ...]:
        """Those of the columns of classes alone, as in `Sums`."""
        if beside is None:
            return ()
        rows, used, found = self.rows, getattr(self.rows, "used", None), []
        parts = beside.columns(rows.motion, rows.project)
        for joint, (size, (there, columns)) in enumerate(zip(beside.sizes, parts, strict=True)):
            products = np.zeros((size, size + self.columns.shape[2]))
            if there.size:
                own = columns / rows.noise[:, joint, None]
                if used is not None:
                    own = np.where(used[:, joint, None], own, 0.0)
                products[there[:, None], there] = own.T @ own
                products[there, size:] = own.T @ self.columns[:, joint]
            found.append(products)
        return tuple(found)


def sums_of(
    rows: Rows, forms: Sequence[Form], extra: FloatArray | None = None, beside: Discrepancies | None = None
) -> Sums:
    """Normal equations of one recording. extra, beside: as `Whitened` has them."""
    return Whitened.of(rows, forms, extra).sums(beside)


def form_rows(rows: Rows, form: Form) -> FloatArray:
    """(R, n, m) Nm per unit of each coefficient; zeros where the motion does not let the effect act."""
    result = np.zeros((*rows.noise.shape, form.size))
    joints, columns = stacked([rows], form)
    result[:, list(joints)] = columns.transpose(1, 0, 2)
    return result


def stacked(rows: Sequence[Rows], form: Form) -> tuple[tuple[int, ...], FloatArray]:
    """Joints, from 0, and columns (len(joints), R, m) Nm of a form on all rows together."""
    found = evaluate(effect_named(form.effect), form.place, dict(form.shape), rows)
    if found is None:
        return (), np.zeros((0, sum(len(item.noise) for item in rows), form.size))
    return found.joints, found.rows


@dataclass(frozen=True, slots=True, eq=False)
class NoiseLevel:
    """Noise at each line, (L + 1, n) Nm in rows of a recording sampled at rate_hz.

    deviation: of one period, which the mean of K periods has 1/√K of. misfit: what comes again with every period.
    """

    frequency: FloatArray
    deviation: FloatArray
    misfit: FloatArray
    rate_hz: float

    @classmethod
    def of(cls, evidence: Evidence, inflated: Evidence) -> NoiseLevel:
        """Of a recording whose periods were averaged; inflated: the same, its noise with the misfit in it."""
        lines = np.r_[0, np.arange(1, len(evidence.frequency), 2)]
        noise, whole = evidence.noise[lines], inflated.noise[lines]
        misfit = np.sqrt(np.maximum(whole**2 - noise**2, 0.0))
        rate = 1.0 / evidence.motion.sampling_period_s
        return cls(evidence.frequency[lines], noise * np.sqrt(evidence.periods), misfit, rate)

    def of_mean(self, frequency: FloatArray, periods: int, rate_hz: float) -> FloatArray:
        """(R, n) standard deviation of rows at these frequencies of the mean of so many periods at another rate.

        Rows are orthonormal: sampled less often, they are smaller by the square root.
        """
        whole = np.sqrt(self.deviation**2 / periods + self.misfit**2) * np.sqrt(rate_hz / self.rate_hz)
        return np.stack([np.interp(frequency, self.frequency, column) for column in whole.T], axis=1)


def planned(
    states: tuple[FloatArray, FloatArray, FloatArray],
    period_s: float,
    like: Motion,
    regressor: BaseRegressor,
    values: FloatArray,
    noise: NoiseLevel,
    periods: int,
) -> PlannedRows:
    """Rows of a motion that nobody drove yet. states: q, q̇, q̈ (S, n) of one period at PLAN_RATE_HZ.

    like: a recorded motion of the arm. values: base parameters (p,), whose torque the effects see.
    """
    position, velocity, acceleration = states
    samples = len(position)
    step = period_s / samples
    lines = min(int(noise.frequency[-1] * period_s), (samples - 1) * 4 // 10)
    matrix = regressor.matrix(position, velocity, acceleration)
    motion = replace(
        like,
        time=np.arange(samples, dtype=np.float64) * step,
        position=position,
        velocity=velocity,
        acceleration=acceleration,
        torque=matrix @ values,
        full_parameters=regressor.ungrouping @ values,
        periodic=True,
        start_s=period_s * np.arange(periods, dtype=np.float64),
    )
    bridge = over_standstills(velocity, step)
    frequency = np.repeat(np.arange(lines + 1) / period_s, 2)[1:]
    deviation = noise.of_mean(frequency, periods, samples / period_s)
    return PlannedRows(motion, lambda part: to_lines(bridge(part), lines), to_lines(bridge(matrix), lines), deviation)


def states_of_table(table: FloatArray, period_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Position, velocity and acceleration of one period of positions (S, n), derivatives by its harmonics."""
    return differentiate_harmonics(table, period_s, len(table) // 2 - 1)
