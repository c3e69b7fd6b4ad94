"""Torque of no known form as a covariance of the fitted rows: what a name has to stand out from."""

from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.problem import Problem, beside
from identification.mismatch.settings import VARIANCE_CAP
from identification.mismatch.unknown.classes import CLASSES
from identification.mismatch.unknown.dependence import Dependence

ClassOnJoint = tuple[int, int]
"""Joint (from 0) and number of a class in CLASSES."""


@dataclass(frozen=True, slots=True, eq=False)
class ClassCovariance:
    """Classes of the fitted rows of `plain`, without names.

    columns: (R, k) Nm of each, whose product with their own transpose is its covariance. losses: nats that the rows
    lose without it. always: (n) of (R, k) Nm, what is in no hypothesis left out: a smooth error of the whole model, and
    the mean of one. inflation: (n, R) factor on the noise's deviation.
    """

    plain: Problem
    columns: Mapping[ClassOnJoint, FloatArray]
    losses: Mapping[ClassOnJoint, float]
    always: tuple[FloatArray, ...]
    inflation: FloatArray

    @classmethod
    def of(cls, plain: Problem, found: Dependence) -> ClassCovariance:
        """plain: the fitted rows alone, as they stand first in those of `found`."""
        alone, columns, losses = found.alone, dict[ClassOnJoint, FloatArray](), dict[ClassOnJoint, float]()
        always, inflation = [], np.ones_like(plain.noise)
        held = [alone.classes(joint, state) for joint, state in enumerate(alone.states)]
        smooth = any(CLASSES[number].background for numbers in held for number in numbers)
        for joint, state in enumerate(alone.states):
            scale = np.where(plain.weight[joint] > 0.0, plain.weight[joint], np.inf)[:, None]
            own, kept = alone.rows.joints[joint], [np.zeros((plain.rows, 0))]
            missed = alone.losses(joint, state)
            for number, places in held[joint].items():
                groups = own.group[alone.columns(joint, state, places)]
                variance = dict(zip(state.groups, state.hyper.variance.tolist(), strict=True))
                deviation = np.sqrt([variance[group] for group in groups.tolist()])
                rows = own.whitened[: plain.rows, alone.columns(joint, state, places)] / scale * deviation
                if CLASSES[number].background:
                    kept.append(rows)
                    continue
                columns[joint, number] = rows
                losses[joint, number] = missed[number]
            if smooth:
                kept.append(_mean_of(found, plain.rows, joint) / scale)
            always.append(np.concatenate(kept, axis=1))
            noise = state.hyper.noise
            inflation[joint] = np.sqrt(noise[alone.rows.band[: plain.rows]])
        return cls(plain, columns, losses, tuple(always), inflation)

    def problem(self, held: AbstractSet[ClassOnJoint]) -> Problem:
        """The fitted rows beside some of the classes."""
        spread = [
            np.concatenate([rows, *(self.columns[place] for place in sorted(held) if place[0] == joint)], axis=1)
            for joint, rows in enumerate(self.always)
        ]
        return beside(self.plain, spread, self.inflation)


def _mean_of(found: Dependence, rows: int, joint: int) -> FloatArray:
    """(rows, 1) whitened constant of a joint, as large as it may be: the functions of a smooth error have mean zero."""
    own = found.every.joints[joint]
    constant = [number for number, basis in enumerate(own.bases) if CLASSES[basis.number].name == "constant"]
    deviation = np.sqrt(VARIANCE_CAP * found.every.misfit[joint])
    return np.asarray(own.whitened[:rows, np.flatnonzero(np.isin(own.group, constant))] * deviation)
