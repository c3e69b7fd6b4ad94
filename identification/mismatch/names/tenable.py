"""What no finding may be, however well it fits: without a certain size, of a sign no machine has, or seen elsewhere."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from identification.mismatch.changes.between_periods import Change
from identification.mismatch.effects.base import CERTAIN, Estimate
from identification.mismatch.names.abstention import Examination, name_of, torque_of, without
from identification.mismatch.problem import off
from identification.mismatch.search.extension import uncertainties
from identification.mismatch.search.trial import Trial, fitted

FloatArray = npt.NDArray[np.float64]

LEAST_SHOWN = 1e-3
"""Share of an effect's energy that has to show beside the base parameters: else its size is that of their error."""


def tenable(exam: Examination, trial: Trial) -> tuple[Trial, list[str]]:
    """The members that may stand, fitted without the others, and sentences on these, the least certain taken first."""
    remarks: list[str] = []
    while True:
        doubted = [(certainty, index, why) for index, (certainty, why) in enumerate(_doubts(exam, trial)) if why]
        if not doubted:
            return trial, remarks
        _, worst, why = min(doubted)
        member = trial.members[worst]
        remarks.append(f"{name_of(member.effect.name, member.place.joint)} {why}: it is not claimed")
        trial = fitted(exam.problem, without(trial.members, worst), exam.settings)


def _doubts(exam: Examination, trial: Trial) -> list[tuple[float, str]]:
    """Of each member how many σ its size has, and why it may not stand; empty where it may."""
    extension = exam.check(trial.members).extension
    sure = uncertainties(
        exam.problem, extension, trial.problem.residual, exam.rows.library, coloured=not trial.complete
    )
    found = []
    for member, coefficients, own in zip(trial.members, extension.coefficients, sure, strict=True):
        estimate = Estimate(member.place, member.shape, coefficients, own.covariance, own.shape_std)
        # On every joint at once: the surest one speaks for all.
        certainty, surest = max(
            ((member.effect.parameters(part)[0].certainty, part) for part in member.effect.parts(estimate)),
            key=lambda pair: pair[0],
        )
        rows = (torque_of(member, coefficients, exam.problem.n) * exam.problem.weight).ravel()
        left = off(exam.problem.basis, rows)
        why = ""
        if member.effect.one_sided and surest.coefficients[0] < 0.0:
            why = "would need a size below zero, which no machine has"
        elif left @ left < LEAST_SHOWN * (rows @ rows):
            why = "would be taken up by the base parameters, all but a thousandth of its energy"
        elif certainty < CERTAIN:
            why = "has a size that may as well be zero"
        found.append((float(certainty), why))
    return found


def recurring(changes: Sequence[Change], others: Sequence[Change]) -> list[Change]:
    """Pushes that come at the same moment of another recording too: no push of a person does, a fault of the set-up."""
    return [change for change in changes if any(_overlap(change, other) for other in others if other is not change)]


def _overlap(one: Change, other: Change) -> bool:
    first, second = one.estimate.shape, other.estimate.shape
    if one.effect.name != other.effect.name:
        return False
    if "start_s" not in first or "start_s" not in second:
        return False
    ends = [shape["start_s"] + shape["duration_s"] for shape in (first, second)]
    return first["start_s"] < ends[1] and second["start_s"] < ends[0]
