"""Whether torques read otherwise with a load than without, and what a load is by the odds of that.

Not here: the columns and their products (`payload`). Pure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import softmax

from identification.arrays import FloatArray, IntArray
from identification.audit.comparison import ALL
from identification.audit.difference import Number
from identification.audit.evidence import Products, as_they_scatter, posterior
from identification.audit.hypotheses import ODDS


@dataclass(frozen=True, slots=True, eq=False)
class _Reading:
    """What was found where the torques of some joints (n,), 0 or 1, read otherwise by one scale.

    prior: odds of it. alike: how many readings of the same kind there are. every: (K,) values of all columns. values
    (k,), covariance (k, k) of the load. scale, std: of the torques, less one.
    """

    joints: FloatArray
    prior: float
    alike: int
    every: FloatArray
    values: FloatArray
    covariance: FloatArray
    scale: float
    std: float

    @property
    def nats(self) -> float:
        """What its scale gains of the likelihood."""
        return 0.5 * (self.scale / self.std) ** 2 if self.joints.any() else 0.0

    def log_odds(self, width: float) -> float:
        """Before the recordings, and what a scale of that width costs as it could have been any other."""
        return float(np.log(self.prior * self.std / width)) if self.joints.any() else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Load:
    """values (k,) of a load with covariance (k, k). ratio: of the torques with the load to those without, of one joint
    (from 0) where that is the likeliest reading, else of all. likeliest: (K,) values of all columns in that reading.
    """

    values: FloatArray
    covariance: FloatArray
    ratio: Number
    joint: int | None
    likeliest: FloatArray


def weighted_by_odds(products: Products, weight: FloatArray, width: FloatArray, own: IntArray) -> Load:
    """A load whatever is read otherwise: nothing, all torques by one scale, or those of one joint.

    own: (k,) the load's columns; the last n are the joints' scales. width: of all columns' prior.
    Both runs are read by the same sensors, so that their torques differ by a scale has to be earned: values are the
    mean over the readings by their odds, the prior's times what the densities of a scale of zero before and after the
    recordings say (Savage and Dickey). Where the prior is wrong these are too near to one scale for both. So the
    covariance is the mean square about them by the likelihoods alone, in which readings of one kind share one vote: it
    reaches as far as the recordings point. Of one scale for all nobody knows which side's torque reads right.
    """
    n, size = len(weight), float(width[-1])
    sums = [products.summed([p for p in ALL if p != left_out], weight) for left_out in (None, *ALL)]
    found = [_read(sums, width, own, np.zeros(n), 1.0, 1), _read(sums, width, own, np.ones(n), ODDS["common_gain"], 1)]
    if n > 1:  # of an arm of one joint all torques are that joint's: one reading, and no two votes
        found += [_read(sums, width, own, joints, ODDS["torque_sensor_gain"] / n, n) for joints in np.eye(n)]
    earned = softmax([each.nats + each.log_odds(size) for each in found])
    share = softmax([each.nats - np.log(each.alike) for each in found])
    values = np.einsum("h,hk->k", earned, [each.values for each in found])
    covariance = np.zeros((len(own), len(own)))
    for odds, each in zip(share, found, strict=True):
        away = each.values - values
        covariance += odds * (each.covariance + np.outer(away, away))
    covariance += share[1] * found[1].scale ** 2 * np.outer(values, values)
    best = int(np.argmax(earned))
    told = found[max(1, best)]
    ratio = Number("torque_ratio", 1.0 + told.scale, told.std, "")
    return Load(values, covariance, ratio, best - 2 if best > 1 else None, found[best].every)


def factor_of(width: FloatArray, joints: FloatArray) -> FloatArray:
    """(K, K - n + 1) root of the prior of all columns where some joints (n,), 0 or 1, have one scale."""
    first = len(width) - len(joints)
    factor = np.zeros((len(width), first + 1))
    factor[np.arange(first), np.arange(first)] = width[:first]
    factor[first:, first] = width[first:] * joints
    return factor


def _read(
    sums: Sequence[tuple[FloatArray, FloatArray]],
    width: FloatArray,
    own: IntArray,
    joints: FloatArray,
    prior: float,
    alike: int,
) -> _Reading:
    """sums: gram and right side of all parts, then of all but one. Covariances are as wide as values scatter there."""
    first, factor = len(width) - len(joints), factor_of(width, joints)
    shown = np.append(own, first + np.flatnonzero(joints)[:1]).astype(np.int64)
    whole, *without = (posterior(*each, factor) for each in sums)
    scattered = np.array([each.values[shown] for each in without])
    covariance = as_they_scatter(whole.covariance[np.ix_(shown, shown)], scattered)
    scale, std = (float(whole.values[shown[-1]]), float(np.sqrt(covariance[-1, -1]))) if joints.any() else (0.0, 0.0)
    load = covariance[: len(own), : len(own)]
    return _Reading(joints, prior, alike, whole.values, whole.values[own], load, scale, std)
