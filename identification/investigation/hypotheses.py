"""What may still be missing, as value objects: one hypothesis, and all that are alive after some recordings."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from identification.arrays import FloatArray
from identification.investigation.columns import Form
from identification.investigation.discrepancy import Discrepancies, Variances
from identification.mismatch.effects.base import Place
from identification.mismatch.evidence import Evidence


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """One thing that may be missing; effect None: nothing of the library is.

    forms: its shapes on the grid. best: the shape with the most evidence. coefficients: (m,) of it, with covariance.
    log_odds: nats against effect None, prior included. probability: among all that are alive. beside: variances of the
    classes of each joint that are there too, as `Discrepancies.bases` of the assessment has them. unnamed: whether any
    of these is missed by as much as the diagnosis asks of a class. Not slotted: what every forecast asks is kept.
    """

    effect: str | None
    place: Place
    forms: tuple[Form, ...]
    best: Form | None
    coefficients: FloatArray
    covariance: FloatArray
    log_odds: float
    probability: float = 0.0
    beside: Variances = ()
    unnamed: bool = False

    @property
    def name(self) -> str:
        """In words, with its place."""
        if self.without_name:
            joints = [str(number) for number, own in enumerate(self.beside, start=1) if own.any()]
            return f"no form of the library (joint{'s' if len(joints) > 1 else ''} {', '.join(joints)})"
        return describe(self.effect, self.place)

    @property
    def without_name(self) -> bool:
        """Whether something is there that no form of the library describes."""
        return self.effect is None and any(own.any() for own in self.beside)

    @cached_property
    def relative_std(self) -> float:
        """Standard deviation of the size over the size."""
        strength = float(self.coefficients @ np.linalg.pinv(self.covariance, hermitian=True) @ self.coefficients)
        return 1.0 / math.sqrt(strength) if strength > 0.0 else math.inf


NOTHING = Hypothesis(None, Place(), (), None, np.zeros(0), np.zeros((0, 0)), 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Assessment:
    """alive: hypotheses, the most probable first, probabilities summing to one. evidences: with the noise of the
    leader, and with the settled findings among the nominal columns. discrepancies: classes beside any of those alive.
    """

    alive: tuple[Hypothesis, ...]
    evidences: tuple[Evidence, ...]
    discrepancies: Discrepancies

    @property
    def leader(self) -> Hypothesis:
        """The most probable hypothesis."""
        return self.alive[0]

    @property
    def certain(self) -> float:
        """Probability of the leader."""
        return self.alive[0].probability


def describe(effect: str | None, place: Place) -> str:
    """An effect with its place, in words."""
    if effect is None:
        return "nothing more"
    where = "" if place.joint is None else f" at joint {place.joint}"
    other = "" if place.other_joint is None else f" and {place.other_joint}"
    return f"{effect.replace('_', ' ')}{where}{other}"
