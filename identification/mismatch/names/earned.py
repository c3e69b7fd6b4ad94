"""Names against classes: which members stand out from what a joint's torque depends on, and what stays beside them."""

from __future__ import annotations

from collections.abc import Set
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from identification.mismatch.heldout import Residuals, worsened
from identification.mismatch.names.abstention import Examination, MemberKey, name_of, without
from identification.mismatch.search.trial import Trial, fitted
from identification.mismatch.unknown.dependence import Dependence, rival_of
from identification.mismatch.unknown.named import Standing, held_beside, named, standings
from identification.mismatch.unknown.selection import Selection
from identification.mismatch.unknown.settings import ClaimSettings

BoolArray = npt.NDArray[np.bool_]


def earned(exam: Examination, trial: Trial, dependence: Dependence, on_odds: Set[MemberKey]) -> tuple[Trial, list[str]]:
    """The members that are earned, fitted without the others, and sentences on these, the least likely taken first.

    on_odds: those that have to be earned also where no class is a rival (`admitted`).
    """
    settings, every, remarks = ClaimSettings(), dependence.every, list[str]()
    elsewhere = None if exam.unseen is None else exam.unseen.library
    if not trial.members:
        return trial, remarks
    rival, predicts = _rival(exam, dependence)
    while trial.members:
        check = exam.check(trial.members)
        pairs = zip(trial.members, check.extension.coefficients, strict=True)
        names = [named(*pair, elsewhere, every) for pair in pairs]
        now = check.heldout_after
        rivalled = predicts
        if rival is not None and now is not None:
            rivalled = predicts & _better(rival, dependence, now)
        asked = [
            index
            for index, (member, name) in enumerate(zip(trial.members, names, strict=True))
            if rivalled[list(name.joints)].any() or (member.effect.name, member.place) in on_odds
        ]
        found = standings(every, names, asked, settings)
        failing = [index for index, standing in found.items() if not standing.earned]
        if not failing:
            break
        worst = min(failing, key=lambda index: found[index].odds)
        member = trial.members[worst]
        remarks.append(f"{name_of(member.effect.name, member.place.joint)} {_why(found[worst], settings)}")
        trial = fitted(exam.problem, without(trial.members, worst), exam.settings)
    return trial, remarks


def held_beside_names(exam: Examination, trial: Trial, dependence: Dependence) -> dict[int, frozenset[str]]:
    """Joint (from 0) → classes that it holds beside the members of a trial; empty without members.

    Where the noise is not known, a joint with a name holds none unless classes predict what was not fitted better.
    """
    if not trial.members:
        return {}
    elsewhere = None if exam.unseen is None else exam.unseen.library
    now = exam.check(trial.members)
    pairs = zip(trial.members, now.extension.coefficients, strict=True)
    names = [named(*pair, elsewhere, dependence.every) for pair in pairs]
    held = held_beside(dependence.every, names, ClaimSettings(), dependence.chosen)
    if exam.problem.noise_is_measured or now.heldout_after is None:
        return held
    better = _better(dependence.alone, dependence, now.heldout_after)
    taken = {joint for name in names for joint in name.joints if not better[joint]}
    return {joint: frozenset() if joint in taken else classes for joint, classes in held.items()}


def _rival(exam: Examination, dependence: Dependence) -> tuple[Selection | None, BoolArray]:
    """The classes that are rivals of names by what they predict, and the joints (n,) where they predict anything.

    Where the noise is not known rows are no proof for each other: there classes are rivals only where they predict what
    was not fitted, and better than the names do, beyond what its rows allow. None, and every joint, where all classes
    are rivals by the odds alone.
    """
    if exam.problem.noise_is_measured or exam.unseen is None:
        return None, np.ones(exam.problem.n, dtype=np.bool_)
    rival = rival_of(dependence.every, ClaimSettings())
    plain = Selection.of(rival.rows, range(rival.rows.folds), rival.settings)
    return rival, dependence.left(rival)[1] < dependence.left(plain)[1]


def _better(classes: Selection, dependence: Dependence, now: Residuals) -> BoolArray:
    """(n,) joints of which classes predict rows that were not fitted better than what leaves `now` there."""
    return worsened(replace(now, rows=dependence.left.of_rows(classes)[1]), now)


def _why(standing: Standing, settings: ClaimSettings) -> str:
    rivals = " and ".join(name.replace("_", " ") for name in standing.rivals)
    if standing.agree < settings.invariance:
        return "has another size on the data that were not fitted: it is not claimed"
    if rivals:
        return f"describes part of a torque that depends on {rivals}, of no form that is known: it is not claimed"
    return "explains no more than a torque of no known form does: it is not claimed"
