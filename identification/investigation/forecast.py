"""What a motion will tell, as a probability: that the true hypothesis stands out from all others afterwards.

Under the truth the log odds against a rival come out as N(now + λ/2, λ), λ being what the new rows add; the size of the
truth is known with a deviation of its own, over which the probability is averaged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr

from identification.investigation.hypotheses import Hypothesis

FloatArray = npt.NDArray[np.float64]

STANDS_OUT = 3.0
"""Nats by which a hypothesis has to lead every rival: odds of 20 to 1, as for a name in the diagnosis."""
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(5)
_WEIGHTS = _WEIGHTS / _WEIGHTS.sum()


@dataclass(frozen=True, slots=True)
class Pair:
    """Truth and rival, by their numbers, and the probability that the motion tells the one from the other."""

    truth: int
    rival: int
    probability: float


@dataclass(frozen=True, slots=True, eq=False)
class Forecast:
    """probability: that a name, or that there is nothing more, stands out afterwards and is true. now: the same without
    a motion more. Where something without a name is there, no motion gives it one: that chance is left out of both.

    hardest: the pair of those alive that is told apart least. gain: (H, H) λ that the motion adds.
    """

    probability: float
    now: float
    hardest: Pair | None
    gain: FloatArray


def forecast(hypotheses: Sequence[Hypothesis], before: FloatArray, after: FloatArray) -> Forecast:
    """before, after: (H, H) λ of `separations`, of all recordings so far and with the motion."""
    gain = np.maximum(after - before, 0.0)
    told = [_told(hypotheses, i, gain) for i in range(len(hypotheses))]
    weights = np.array([0.0 if item.without_name else item.probability for item in hypotheses])
    one = [float(max(0.0, 1.0 - np.sum(1.0 - row))) for row in told]
    standing = np.zeros_like(gain)
    now = [float(max(0.0, 1.0 - np.sum(1.0 - _told(hypotheses, i, standing)))) for i in range(len(hypotheses))]
    pairs = [
        Pair(i, j, float(told[i][j]))
        for i in range(len(hypotheses))
        for j in range(len(hypotheses))
        if i != j and weights[i] > 0.01
    ]
    hardest = min(pairs, key=lambda pair: pair.probability, default=None)
    return Forecast(float(weights @ one), float(weights @ now), hardest, gain)


def stands_out(hypotheses: Sequence[Hypothesis]) -> bool:
    """Whether the leading hypothesis leads every other one by so much that it is the answer."""
    first, *others = sorted((item.log_odds for item in hypotheses), reverse=True)
    return not others or first - others[0] >= STANDS_OUT


def _told(hypotheses: Sequence[Hypothesis], truth: int, gain: FloatArray) -> FloatArray:
    """(H,) probability that hypothesis `truth`, if it is the true one, leads each rival; 1 in its own place."""
    own = hypotheses[truth]
    lead = own.log_odds - np.array([item.log_odds for item in hypotheses])
    spread = min(own.relative_std, 1.0) if own.effect is not None else 0.0
    total = np.zeros(len(hypotheses))
    for node, weight in zip(_NODES, _WEIGHTS, strict=True):
        strength = gain[truth] * max(0.0, 1.0 + spread * float(node)) ** 2
        deviation = np.sqrt(np.maximum(strength, 1e-12))
        total += weight * ndtr((lead + 0.5 * strength - STANDS_OUT) / deviation)
    total[truth] = 1.0
    return np.minimum(total, 1.0)
