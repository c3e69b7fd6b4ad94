"""What no finding may be, however well it fits: of no use elsewhere, of no certain size, of a sign no machine has."""

from __future__ import annotations

from collections.abc import Callable, Sequence, Set
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from identification.mismatch.changes.between_periods import Change
from identification.mismatch.effects.base import CERTAIN, Place
from identification.mismatch.heldout import worsened
from identification.mismatch.names.alternatives import rivals
from identification.mismatch.names.examination import Check, Examination, joints_of, name_of, torque_of
from identification.mismatch.search.extension import uncertainties
from identification.mismatch.search.refinement import Member
from identification.mismatch.search.trial import Trial, fitted, without


@dataclass(frozen=True, slots=True)
class Objection:
    """Why one member, by its number, may not be named. worth: what speaks for it, on the scale of its rule. there:
    whether what it describes is there all the same, under whatever name.
    """

    index: int
    worth: float
    why: str
    there: bool = False


Rule = Callable[[Trial], Sequence[Objection]]


def without_objection(
    exam: Examination, trial: Trial, rules: Sequence[Rule]
) -> tuple[Trial, list[str], tuple[Member, ...]]:
    """The members that no rule objects to, fitted without the others; sentences on these; those of them that are there.

    The rules are asked in turn, and from the first again after each member that goes: the one worth least by the rule
    that objects. In its place the best of the names is asked that the fitted recordings cannot tell from it.
    """
    remarks, fallen, instead = list[str](), set[tuple[str, Place]](), dict[tuple[str, Place], str]()
    # Of a name that took the place of another: what is there though it was too weak for the first of them.
    there, behind = list[Member](), dict[tuple[str, Place], Member]()
    # What takes the place of a member is asked before it is taken, and after.
    answers = [lru_cache(2)(rule) for rule in rules]
    while trial.members:
        asked = ((rule, rule(trial)) for rule in answers)
        objecting, objections = next((pair for pair in asked if pair[1]), (None, ()))
        if objecting is None:
            break
        worst = min(objections, key=lambda item: item.worth)
        member = trial.members[worst.index]
        fallen.add((member.effect.name, member.place))
        first = behind.pop((member.effect.name, member.place), member if worst.there else None)
        name = name_of(member.effect.name, member.place.joint)
        remarks.append(f"{name} {worst.why}: it is not claimed")
        other = _under_another_name(exam, trial, worst.index, fallen)
        against = [] if other is None else [item for item in objecting(other) if item.index == worst.index]
        if other is None or against:
            trial = fitted(exam.problem, without(trial.members, worst.index), exam.settings)
            if first is not None:
                there.append(first)
            elif other is not None and against[0].there:
                rival = other.members[worst.index]
                remarks.append(f"{name_of(rival.effect.name, rival.place.joint)} {against[0].why}: it is not claimed")
                there.append(rival)
        else:
            trial, rival = other, other.members[worst.index]
            instead[rival.effect.name, rival.place] = name
            if first is not None:
                behind[rival.effect.name, rival.place] = first
    if exam.unseen is not None:
        standing = {(member.effect.name, member.place) for member in trial.members}
        remarks += [
            f"{name_of(effect, place.joint)} stands in the place of {name}; the held-out recordings had a say in that, "
            "so their figures are not independent of it"
            for (effect, place), name in instead.items()
            if (effect, place) in standing
        ]
    return trial, remarks, tuple(there)


def _under_another_name(exam: Examination, trial: Trial, index: int, fallen: Set[tuple[str, Place]]) -> Trial | None:
    """With the best name in the place of one member that the fitted recordings leave open; None without any."""
    for _, rival in rivals(exam.problem, trial, index, exam.screen, exam.rows.library, exam.settings):
        if (rival.effect.name, rival.place) not in fallen:
            members = [rival if place == index else member for place, member in enumerate(trial.members)]
            return fitted(exam.problem, members, exam.settings, trial)
    return None


def useless(exam: Examination, settled: Callable[[tuple[Member, ...]], Check], trial: Trial) -> list[Objection]:
    """Members that make a joint of the held-out recordings worse than its noise allows.

    Where the noise is not measured also those that make none better: rows of one kind are no proof for each other.
    settled: what a set of members leaves, as it stands in the result.
    """
    check = settled(trial.members)
    now, found = check.heldout_after, list[Objection]()
    for index, member in enumerate(trial.members):
        rest = settled(without(trial.members, index)).heldout_after
        if now is None or rest is None:
            break
        worse = (np.flatnonzero(worsened(rest, now)) + 1).tolist()
        if worse:
            joints = ", ".join(map(str, worse))
            why = f"makes joint {joints} worse on data that were not fitted than their noise allows"
            found.append(Objection(index, -len(worse), why))
        elif not exam.problem.noise_is_measured:
            own = joints_of(member, torque_of(member, check.extension.coefficients[index], exam.problem.n))
            if not worsened(now, rest)[own].any():
                found.append(Objection(index, 0.0, "does not foretell data that were not fitted"))
    return found


def untenable(exam: Examination, trial: Trial) -> list[Objection]:
    """Members without a certain size, or of a sign that no machine has."""
    extension = exam.check(trial.members).extension
    sure = uncertainties(
        exam.problem, extension, trial.problem.residual, exam.rows.library, coloured=not trial.complete
    )
    found = []
    for index, (member, coefficients, own) in enumerate(zip(trial.members, extension.coefficients, sure, strict=True)):
        estimate = own.estimate(member, coefficients)
        # On every joint at once: the surest one speaks for all.
        certainty, surest = max(
            ((member.effect.certainty(part), part) for part in member.effect.parts(estimate)),
            key=lambda pair: pair[0],
        )
        why = ""
        if member.effect.is_impossible(surest.coefficients, surest.std):
            why = "would need a size that no machine has"
        elif certainty < CERTAIN:
            why = "has a size that may as well be zero"
        if why:
            found.append(Objection(index, float(certainty), why))
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
