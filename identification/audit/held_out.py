"""How likely other readings of a recording are, on rows that were not fitted: one measure for all of them. Pure.

One rigid body with free parameters is fitted to three quarters of the blocks and asked for the others, by turns.
Not here: which readings are asked (`otherwise`, `linear_dynamics`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from identification.arrays import FloatArray, IntArray
from identification.audit.columns import Geometry
from identification.audit.evidence import Products, posterior, products_of
from identification.audit.given import Sizes, sizes_of, wide_open
from identification.audit.rows import REPEATED, Rows
from identification.robots.model import RobotModel

FOLDS = 4
STAYS = 0.12
"""Of the misfit of the joints that take part, what may stay for a misreading to be believed."""
LONGEST_STEP, STEPS = 0.3, 8
"""Of a value's logarithm, or a zero in rad or m: further than a tangent reaches, and most steps."""
_TURNS = 3
"""In which the noise that a reading leaves and its parameters settle."""


Linear = Callable[[FloatArray], tuple[FloatArray, FloatArray, FloatArray]]
"""At some values (m,) the columns (R, n, 14 n), how their torque goes on with each value (R, n, m), and the torque."""


@dataclass(frozen=True, slots=True, eq=False)
class Score:
    """Of rows that were not fitted. nats: their log-likelihood, by the noise that they have. square: (n,) Nm², left."""

    nats: float
    square: FloatArray

    @classmethod
    def of(cls, square: FloatArray, counts: FloatArray) -> Score:
        """Of squares (n,) in so many rows (n,)."""
        return cls(-0.5 / REPEATED * float(counts @ np.log(square)), square)

    def holds_against(self, stated: Score) -> bool:
        """Whether next to nothing of the misfit as stated stays, each joint weighed by what this reading leaves."""
        return len(self.square) <= STAYS * float((stated.square / self.square).sum())


@dataclass(frozen=True, slots=True, eq=False)
class Asked:
    """Rows of a recording with their columns (R, n, 14 n) as they are stated. fold: (R,) which part a row is in.

    Blocks go to the folds in turns that shift by one each time, so that no motion that repeats keeps time with them.
    """

    rows: Rows
    geometry: Geometry
    gravity: FloatArray
    sizes: Sizes
    columns: FloatArray
    fold: IntArray

    @classmethod
    def of(cls, rows: Rows, robot: RobotModel) -> Asked:
        """Of some rows of a robot's recording."""
        geometry, gravity = Geometry(robot, rows), np.array(robot.gravity, dtype=np.float64)
        fold = (rows.block + rows.block // FOLDS) % FOLDS
        return cls(rows, geometry, gravity, sizes_of(robot, rows), geometry.columns(gravity), fold)

    def products(self, columns: FloatArray, torque: FloatArray) -> Products:
        """Of columns (R, n, K) with a torque (R, n), for each fold."""
        return products_of(columns, torque, self.rows.used, self.fold, FOLDS)

    def widths(self, further: int = 0, width: float = 1.0) -> FloatArray:
        """(14 n + further,) deviations of the parameters, and of as many further columns."""
        return np.concatenate([wide_open(self.sizes), np.full(further, width)])

    def values(
        self, products: Products, widths: FloatArray, parts: tuple[int, ...] = tuple(range(FOLDS))
    ) -> FloatArray:
        """(K,) that explain some folds best, the joints weighed by what they leave."""
        std, every = np.maximum(self.sizes.first_noise, self.sizes.least_noise), np.arange(len(widths))
        values, fitted = np.zeros(len(widths)), products.together(parts)
        counts = np.maximum(fitted.count[0], 1.0)
        for _ in range(_TURNS):
            gram, right = fitted.summed((0,), 1.0 / (REPEATED * std**2))
            # Torques far smaller than what the parameters may make have no solution in floats without that.
            rounded = len(widths) * np.finfo(np.float64).eps * float(np.diag(gram) @ widths**2)
            gram[every, every] += rounded / widths**2
            values = posterior(gram, right, widths).values
            std = np.maximum(np.sqrt(fitted.left((0,), values, every) / counts), self.sizes.least_noise)
        return values

    def score(self, products: Products, widths: FloatArray, least: float = -np.inf) -> Score:
        """Of every fold by what the others say. least: nats; of what is found to be less likely no more is asked than
        that, as what further folds leave is only added.
        """
        every, counts = np.arange(len(widths)), products.counts(range(FOLDS))
        square = np.zeros(len(self.sizes.torque))
        for fold in range(FOLDS):
            others = tuple(other for other in range(FOLDS) if other != fold)
            square += products.left((fold,), self.values(products, widths, others), every)
            so_far = Score.of(np.maximum(square / np.maximum(counts, 1.0), self.sizes.least_noise**2), counts)
            if so_far.nats < least:
                break
        return so_far

    def settled(self, start: FloatArray, linear: Linear, width: float, nearest: float) -> FloatArray:
        """(m,) values that leave least, by tangents from a start, until no step is longer than the nearest.

        width: deviation of a step before the rows are seen.
        """
        values, count = start, len(start)
        for _ in range(STEPS):
            columns, slopes, torque = linear(values)
            products = self.products(np.concatenate([columns, slopes], axis=2), torque)
            step = np.clip(self.values(products, self.widths(count, width))[-count:], -LONGEST_STEP, LONGEST_STEP)
            values = values + step
            if np.abs(step).max() < nearest:
                break
        return values

    def of_reading(self, columns: FloatArray, torque: FloatArray | None = None, *, least: float = -np.inf) -> Score:
        """Of other columns (R, n, 14 n), or another torque (R, n). least: as in `score`."""
        products = self.products(columns, self.rows.torque if torque is None else torque)
        return self.score(products, self.widths(), least)
