"""Names against classes: which of the members that passed so far stand out from what a joint's torque depends on."""

from __future__ import annotations

from identification.mismatch.names.abstention import Examination, name_of, without
from identification.mismatch.search.trial import Trial, fitted
from identification.mismatch.unknown.dependence import Dependence
from identification.mismatch.unknown.named import Standing, named, standings
from identification.mismatch.unknown.settings import ClaimSettings


def earned(exam: Examination, trial: Trial, dependence: Dependence) -> tuple[Trial, list[str]]:
    """The members that are earned, fitted without the others, and sentences on these, the least likely taken first."""
    settings, every, remarks = ClaimSettings(), dependence.every, list[str]()
    elsewhere = None if exam.unseen is None else exam.unseen.library
    while trial.members:
        coefficients = exam.check(trial.members).extension.coefficients
        names = [named(*pair, elsewhere, every) for pair in zip(trial.members, coefficients, strict=True)]
        found = standings(every, names, settings)
        # Classes that do not predict what was not fitted are no better explanation of it.
        failing = [
            index
            for index, (name, standing) in enumerate(zip(names, found, strict=True))
            if not standing.earned and dependence.predicts[list(name.joints)].any()
        ]
        if not failing:
            break
        worst = min(failing, key=lambda index: found[index].odds)
        member = trial.members[worst]
        remarks.append(f"{name_of(member.effect.name, member.place.joint)} {_why(found[worst], settings)}")
        trial = fitted(exam.problem, without(trial.members, worst), exam.settings)
    return trial, remarks


def _why(standing: Standing, settings: ClaimSettings) -> str:
    rivals = " and ".join(name.replace("_", " ") for name in standing.rivals)
    if standing.agree < settings.invariance:
        return "has another size on the data that were not fitted: it is not claimed"
    if rivals:
        return f"describes part of a torque that depends on {rivals}, of no form that is known: it is not claimed"
    return "explains no more than a torque of no known form does: it is not claimed"
