"""What a motion will tell, as a probability: that the true hypothesis stands out from all others afterwards.

Under the truth the log odds against a rival come out as N(now + λ/2, λ), λ being what the new rows add; the size of the
truth is known with a deviation of its own, over which the probability is averaged. A name also needs a λ of its own
(`LEAST_SHOWN`, and no less than the classes beside it): after a motion the size found is the mean of the one known and
the one that the motion shows, weighted by what each adds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtr, chndtr, ndtr

from identification.arrays import FloatArray
from identification.investigation.hypotheses import Hypothesis
from identification.mismatch.names.alternatives import EXPLAINS_MORE
from identification.mismatch.settings import ALTERNATIVE, LEAST_SHOWN, SPEAK, DiagnosisSettings

STANDS_OUT = ALTERNATIVE
"""Nats by which a name has to lead every free function, and "nothing more" every name: odds of 20 to 1."""
APART = DiagnosisSettings().margin_of_indistinguishable
"""Nats by which a name has to lead every other name, or the diagnosis says that it cannot tell the two."""
LEAST_GAIN, LEAST_LIKELY = 0.02, 0.01
"""Rise of a chance below which a motion is not worth its time; probability of all forms below which none is sought."""
_LEAST_ADDED = 1e-3
"""Of what is known of a size, what a motion adds at least: for less the chance is one or none."""
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

    hardest: the pair of those alive that is told apart least. gain: (H, H) λ that the motion adds; diagonal: of each by
    itself. forms: probability that it is a form of the library; named, named_now: that it then has its name, with the
    motion and without.
    """

    probability: float
    now: float
    hardest: Pair | None
    gain: FloatArray
    forms: float = 0.0
    named: float = 0.0
    named_now: float = 0.0

    @property
    def worth_driving(self) -> bool:
        """Whether a form is likely enough, and the motion raises the chance of its name; or settles that none is."""
        rise = max(self.probability - self.now, self.named - self.named_now if self.forms >= LEAST_LIKELY else 0.0)
        return rise >= LEAST_GAIN


def forecast(
    hypotheses: Sequence[Hypothesis],
    before: FloatArray,
    after: FloatArray,
    beside: tuple[FloatArray, FloatArray] | None = None,
) -> Forecast:
    """before, after: (H, H) λ of `separations`, of all recordings so far and with the motion; infinite after it where
    the rival has the truth for a special case. beside: (H,) of `beside_names`, before and after; None: none.
    """
    gain = np.maximum(after - before, 0.0)
    least_now, least = np.maximum(LEAST_SHOWN, np.zeros((2, len(hypotheses))) if beside is None else beside)
    told = [_told(hypotheses, i, before, gain, float(least[i])) for i in range(len(hypotheses))]
    one = [_all(hypotheses, i, row) for i, row in enumerate(told)]
    standing = np.where(np.isinf(gain), gain, 0.0)
    now = [
        _all(hypotheses, i, _told(hypotheses, i, before, standing, float(least_now[i]))) for i in range(len(hypotheses))
    ]
    weights = np.array([0.0 if item.without_name else item.probability for item in hypotheses])
    pairs = [
        Pair(i, j, float(told[i][j]))
        for i in range(len(hypotheses))
        for j in range(len(hypotheses))
        if i != j and weights[i] > 0.01
    ]
    hardest = min(pairs, key=lambda pair: pair.probability, default=None)
    likely = np.where([item.effect is not None for item in hypotheses], weights, 0.0)
    forms = float(likely.sum())
    share = likely / forms if forms > 0.0 else likely
    return Forecast(
        float(weights @ one), float(weights @ now), hardest, gain, forms, float(share @ one), float(share @ now)
    )


def stands_out(hypotheses: Sequence[Hypothesis]) -> bool:
    """Whether the leading hypothesis leads every other one by so much that it is the answer."""
    first, *others = sorted((item.log_odds for item in hypotheses), reverse=True)
    return not others or first - others[0] >= STANDS_OUT


def _told(
    hypotheses: Sequence[Hypothesis], truth: int, before: FloatArray, gain: FloatArray, least: float
) -> FloatArray:
    """(H,) probability that hypothesis `truth`, if it is the true one, leads each rival; in its own place, that it
    shows as much as a name needs, a λ of `least`.
    """
    own = hypotheses[truth]
    lead = own.log_odds - np.array([item.log_odds for item in hypotheses])
    needed = np.array([_needed(own, item) for item in hypotheses])
    spread = min(own.relative_std, 1.0) if own.effect is not None else 0.0
    total = np.zeros(len(hypotheses))
    general = np.isinf(gain[truth])
    finite = np.where(general, 0.0, gain[truth])
    for node, weight in zip(_NODES, _WEIGHTS, strict=True):
        strength = finite * max(0.0, 1.0 + spread * float(node)) ** 2
        deviation = np.sqrt(np.maximum(strength, 1e-12))
        total += weight * ndtr((lead + 0.5 * strength - needed) / deviation)
    shown, more = float(before[truth, truth]), float(gain[truth, truth])
    total[truth] = 1.0 if own.effect is None else _shown(shown, more, own.relative_std, least)
    for j, rival in enumerate(hypotheses):
        if general[j]:
            total[j] = _simpler(rival.coefficients.size - own.coefficients.size)
        elif own.effect is None and rival.effect is not None:
            total[j] = _faded(float(gain[truth, j]), rival, 2.0 * float(needed[j] - lead[j]))
    return np.minimum(total, 1.0)


def _needed(truth: Hypothesis, rival: Hypothesis) -> float:
    """Nats by which the diagnosis asks a truth to lead a rival.

    Beside torque of no known form its functions may fail to describe some of that, so that free functions have to be
    led by more.
    """
    if truth.effect is None:
        return STANDS_OUT
    if not _is_a_class(truth, rival):
        return APART
    return SPEAK if truth.unnamed else STANDS_OUT


def _simpler(further: int) -> float:
    """Probability that the diagnosis says a truth, and not what has it for a special case with further coefficients.

    No motion tells the two by λ. The diagnosis says the simpler one unless the other explains more than its
    coefficients cost, and by chance it explains half a χ² more.
    """
    return float(chdtr(further, 2.0 * (ALTERNATIVE * further - EXPLAINS_MORE)))


def _faded(gain: float, rival: Hypothesis, more: float) -> float:
    """Probability that λ of a form that is not there falls by `more`. gain: λ that the motion would show of the size
    known so far.

    The size found later is the mean of that one and of none, by what each weighs, so that no more than what speaks for
    the form now is ever lost. Its λ is then a noncentral χ², of as many degrees as the form has coefficients.
    """
    known = rival.relative_std**-2
    if more >= known:
        return 0.0
    added = max(gain / max(known, 1e-12), _LEAST_ADDED)
    return float(chndtr((known - more) * (1.0 + added) / added, rival.coefficients.size, known / added))


def _shown(before: float, gain: float, relative_std: float, least: float) -> float:
    """Probability that λ at the size found is `least` or more. before, gain: λ at the size known so far, of all
    recordings and of the motion; relative_std: of that size. What is found later is as far from it as the motion adds.
    """
    whole = max(before + gain, 1e-12)
    share, deviation = math.sqrt(least / whole), max(relative_std * math.sqrt(gain / whole), 1e-9)
    return float(ndtr((1.0 - share) / deviation) + ndtr((-1.0 - share) / deviation))


def _all(hypotheses: Sequence[Hypothesis], truth: int, told: FloatArray) -> float:
    """Probability that a truth leads all rivals, at least, and shows enough. told: (H,) of `_told`.

    Rivals that are one class with or without a further name stand and fall together; whether all are led, and whether
    enough is shown, hang on the same true size. Where nothing is there, each form fades by a noise of its own.
    """
    together = np.array([_is_a_class(hypotheses[truth], item) for item in hypotheses])
    missed = 1.0 - told
    missed[truth] = 0.0
    leads = 1.0 - missed[together].max(initial=0.0) - missed[~together].sum()
    return float(max(0.0, min(leads, told[truth])))


def _is_a_class(truth: Hypothesis, rival: Hypothesis) -> bool:
    """Whether a rival has no name for the truth's torque: none at all, or a class on its joint that the truth lacks."""
    if rival.effect is None or truth.effect is None:
        return rival.effect is None
    joints = range(len(rival.beside)) if truth.place.joint is None else (truth.place.joint - 1,)
    return any(
        np.any((own := rival.beside[joint]) > 0.0) and not np.array_equal(own > 0.0, truth.beside[joint] > 0.0)
        for joint in joints
        if joint < len(rival.beside)
    )
