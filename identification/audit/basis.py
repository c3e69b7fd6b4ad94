"""A model and the differences found so far, beside the rows of one recording: what they foretell, and what they leave.

The value that a search hands on from step to step. Pure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from identification.arrays import FloatArray, IntArray
from identification.audit.columns import INERTIAL, PARAMETERS, Geometry, SetUp
from identification.audit.comparison import ALL, REPORT, USED, Comparison, Noise, compare, noise_of, stretches_of
from identification.audit.evidence import Estimate, log_evidence, marginal, posterior
from identification.audit.given import GivenModel, Sizes
from identification.audit.hypotheses import Hypothesis, Layout

DAYS = (0.3, 1.0, 3.0)
"""How much friction differs, in times of what is usual between two days: as likely each before the recording is seen.
All joints together tell, so that one joint stands out after an hour, and none where every joint ran cold.
"""


_BENDS_SLOPES = ("gravity", "zeros", "ratio")
LEVEL_RAD = np.radians(0.3)
"""A base stands as is said within this; cables and hoses pull on an arm as much as such a lean."""


def root_of(covariance: FloatArray, scale: FloatArray) -> FloatArray:
    """F with F Fᵀ the covariance (k, k) of parameters of some sizes (k,)."""
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    return np.asarray(scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))


@lru_cache(maxsize=2 * len(DAYS))
def _prior_on(model: GivenModel, sizes: Sizes, day: float) -> FloatArray:
    """(14 n, 14 n) root of the prior of all parameters; every hypothesis asks for it again."""
    return root_of(model.covariance_on(day), sizes.each)


@dataclass(frozen=True, slots=True, eq=False)
class Explanation:
    """A model, the differences so far, and a recording read as a set-up says. day: how much friction differs (DAYS).

    held: places of delay and tilt that stay as they are said. Their scatter from run to run is small, but by many rows
    it takes what a difference of the same kind makes, which then took nothing away.
    """

    model: GivenModel
    sizes: Sizes
    comparison: Comparison
    noise: Noise
    steps: tuple[Hypothesis, ...] = ()
    day: float = 1.0
    held: tuple[int, ...] = ()

    @classmethod
    def of(cls, geometry: Geometry, set_up: SetUp, model: GivenModel, sizes: Sizes) -> Explanation:
        """The model as it stands."""
        return cls(model, sizes, compare(geometry, set_up, model), noise_of(geometry, set_up, sizes, model))

    def read(self, set_up: SetUp) -> Explanation:
        """With the data read otherwise; the noise stays what it was."""
        old = self.comparison.set_up
        as_before = all(np.array_equal(getattr(old, name), getattr(set_up, name)) for name in _BENDS_SLOPES)
        slopes = self.comparison.slopes if as_before else None
        return replace(self, comparison=compare(self.comparison.geometry, set_up, self.model, slopes))

    def in_stretches(self) -> Explanation:
        """With parts that are stretches of time in place of blocks in turns."""
        now = self.comparison
        part = stretches_of(now.geometry.rows)
        return replace(self, comparison=compare(now.geometry, now.set_up, self.model, now.slopes, part))

    def noise_with(self, item: Hypothesis | None = None) -> Noise:
        """The noise of the set-up as it is read now, where the scales of one hypothesis are free besides."""
        now, n, beside = self.comparison, self.layout.n, None
        if item is not None:
            scales = [int(place) - self.layout.gain for place in item.columns]
            beside = np.stack([now.expected * ((np.arange(n) == k) | (k == n)) for k in scales], axis=2)
        return noise_of(now.geometry, now.set_up, self.sizes, self.model, beside)

    def plus(self, step: Hypothesis, day: float) -> Explanation:
        """With one difference more."""
        return replace(self, steps=(*self.steps, step), day=day)

    def holding(self, steps: Sequence[Hypothesis]) -> Explanation:
        """With delay and tilt as they are said where a difference is about them."""
        return replace(self, held=tuple(int(column) for step in steps for column in step.columns))

    def without(self, steps: Sequence[Hypothesis]) -> Explanation:
        """With these differences out."""
        return replace(self, steps=tuple(step for step in self.steps if step not in steps))

    @property
    def layout(self) -> Layout:
        """Where the columns stand."""
        return Layout(self.comparison.geometry.robot.n)

    def columns(self) -> IntArray:
        """(k,) places of all that is free: parameters, delay and tilt as they are known, and the differences."""
        own = [step.columns for step in self.steps]
        return np.concatenate([self.layout.base, self._scattering()[0], *own])

    def _scattering(self) -> tuple[IntArray, FloatArray]:
        """Columns of delay and tilt that are not held, and their widths."""
        tilt = self.layout.tilt
        columns = np.array([self.layout.delay, tilt, tilt + 1])
        free = ~np.isin(columns, self.held)
        return columns[free], np.array([self.model.delay_std_s, LEVEL_RAD, LEVEL_RAD])[free]

    def factor(self, day: float | None = None) -> FloatArray:
        """(k, k) root of the prior of all that is free."""
        parameters = _prior_on(self.model, self.sizes, self.day if day is None else day)
        widths = np.concatenate([self._scattering()[1], *(step.width for step in self.steps)])
        factor = np.diag(np.concatenate([np.zeros(len(parameters)), widths]))
        factor[: len(parameters), : len(parameters)] = parameters
        return factor

    def fitted(self, parts: Sequence[int]) -> Estimate:
        """All that is free, by the rows of some parts."""
        return self._fitted(parts, self.columns(), self.factor())

    def _fitted(self, parts: Sequence[int], columns: IntArray, factor: FloatArray) -> Estimate:
        gram, right = self.comparison.products.summed(parts, self.noise.weight)
        return posterior(gram[np.ix_(columns, columns)], right[columns], factor)

    def _free(self, alone: bool) -> tuple[IntArray, FloatArray]:
        """Places (k,) of what is free, and the root of its prior. alone: the differences by themselves.

        The parameters then stay at the model's values, but for the friction and offsets of a drawn model, which says
        nothing of them: what they would take explains nothing.
        """
        columns, factor, size = self.columns(), self.factor(), PARAMETERS * self.layout.n
        free = np.ones(len(columns), dtype=np.bool_)
        if alone:
            free[:size] = (np.arange(size) % PARAMETERS >= INERTIAL) & (not self.model.own)
        return columns[free], factor[free]

    def gains(
        self, candidates: Sequence[Hypothesis], days: Sequence[float] = DAYS
    ) -> list[tuple[float, float, Hypothesis]]:
        """(log odds against none, likeliest day, hypothesis), the best first: whichever day it is, on rows in use."""
        gram, right = self.comparison.products.summed(USED, self.noise.weight)
        columns, alone, beside = self.columns(), [], []
        for day in days:
            factor = self.factor(day)
            alone.append(_evidence(gram, right, columns, factor))
            left, seen = marginal(gram, right, columns, factor)
            beside.append([_evidence(left, seen, each.columns, each.width) for each in candidates])
        total = np.array(alone)[:, None] + np.array(beside)
        gained = np.logaddexp.reduce(total, axis=0) - np.logaddexp.reduce(alone)
        likeliest = [days[place] for place in np.argmax(total, axis=0)]
        scored = [
            (float(value) + each.log_odds, day, each)
            for value, day, each in zip(gained, likeliest, candidates, strict=True)
        ]
        return sorted(scored, key=lambda one: -one[0])

    def evidence(self) -> float:
        """Log evidence of the rows in use, whatever day it is, up to a constant of the noise."""
        gram, right = self.comparison.products.summed(USED, self.noise.weight)
        each = [_evidence(gram, right, self.columns(), self.factor(day)) for day in DAYS]
        square = float(self.noise.weight @ self.comparison.products.square[list(USED)].sum(axis=0))
        return float(np.logaddexp.reduce(each)) - 0.5 * square

    def foretold(self, parts: Sequence[int] = USED, alone: bool = False) -> FloatArray:
        """(parts, n) sum of squares that is left on each part by what is fitted on the others; alone: as in `_free`."""
        free = self._free(alone)
        return np.array([self._left((part,), [other for other in parts if other != part], *free) for part in parts])

    def reported(self, alone: bool = False) -> FloatArray:
        """(n,) sum of squares that is left on the rows that report by what is fitted on those in use."""
        return self._left(REPORT, USED, *self._free(alone))

    def _left(self, parts: Sequence[int], fitted: Sequence[int], columns: IntArray, factor: FloatArray) -> FloatArray:
        return self.comparison.products.left(parts, self._fitted(fitted, columns, factor).values, columns)

    def deviation_of_last(self) -> tuple[FloatArray, FloatArray]:
        """Values (m,) and covariance (m, m) of the last difference beside all else, by all rows."""
        found = self.fitted(ALL)
        own = slice(len(found.values) - len(self.steps[-1].columns), None)
        return found.values[own], found.covariance[own, own]


def _evidence(gram: FloatArray, right: FloatArray, columns: IntArray, factor: FloatArray) -> float:
    return log_evidence(gram[np.ix_(columns, columns)], right[columns], factor)
