"""Names against classes: which members stand out from what a joint's torque depends on, and what stays beside them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from identification.mismatch.heldout import worsened
from identification.mismatch.names.examination import Check, Examination
from identification.mismatch.names.objections import Objection
from identification.mismatch.search.refinement import Member
from identification.mismatch.search.trial import Trial, without
from identification.mismatch.settings import DIFFERENT, MOST
from identification.mismatch.unknown.dependence import Dependence
from identification.mismatch.unknown.named import Named, Standing, held_beside, named, standings


@dataclass(frozen=True, slots=True, eq=False)
class AgainstClasses:
    """Members of a model beside the classes that their joints hold.

    settled: what a set of members leaves, as it stands in the result.
    """

    exam: Examination
    dependence: Dependence
    settled: Callable[[tuple[Member, ...]], Check]

    def unearned(self, trial: Trial) -> list[Objection]:
        """Members that classes describe as well, or that have another size on rows that were not fitted."""
        names = self._named(trial, self.exam.check(trial.members))
        asked = [index for index, name in enumerate(names) if not self._foretells_most(trial, index, list(name.joints))]
        found = standings(self.dependence.every, names, asked, self.dependence.chosen)
        return [
            Objection(index, standing.odds, _why(standing), standing.weak)
            for index, standing in found.items()
            if not standing.earned
        ]

    def held(self, trial: Trial) -> dict[int, frozenset[str]]:
        """Joint (from 0) → classes that it holds beside the members of a trial; empty without members.

        Where the noise is not known, a joint with a name holds none unless classes predict what was not fitted better.
        """
        if not trial.members:
            return {}
        now, dependence = self.exam.check(trial.members), self.dependence
        names = self._named(trial, now)
        held = held_beside(dependence.every, names, dependence.chosen)
        if self.exam.problem.noise_is_measured or now.heldout_after is None:
            return held
        # Joints of which classes predict rows that were not fitted better than the members do.
        by_classes = replace(now.heldout_after, rows=dependence.left.of_rows(dependence.alone)[1])
        better = worsened(by_classes, now.heldout_after)
        taken = {joint for name in names for joint in name.joints if not better[joint]}
        return {joint: frozenset() if joint in taken else classes for joint, classes in held.items()}

    def _foretells_most(self, trial: Trial, index: int, joints: list[int]) -> bool:
        """Whether a name takes half of what classes take of rows that were not fitted, on its joints (from 0).

        Asked where no noise is measured: there rows of one kind are no proof for each other, and how much there is to
        take nobody knows; what takes little of it may be any name.
        """
        if self.exam.problem.noise_is_measured:
            return False
        sets = ((), without(trial.members, index), trial.members)
        before, rest, now = (self.settled(members).heldout_after for members in sets)
        if before is None or rest is None or now is None:
            return False
        square = before.rms_nm[joints] ** 2
        taken = (rest.rms_nm**2 - now.rms_nm**2)[joints] / square
        there = 1.0 - self.dependence.after[1][joints] ** 2 / square
        return bool(taken.sum() >= MOST * there.sum())

    def _named(self, trial: Trial, check: Check) -> list[Named]:
        elsewhere = None if self.exam.unseen is None else self.exam.unseen.library
        pairs = zip(trial.members, check.extension.coefficients, strict=True)
        return [named(*pair, elsewhere, self.dependence.every) for pair in pairs]


def _why(standing: Standing) -> str:
    rivals = " and ".join(name.replace("_", " ") for name in standing.rivals if name != "constant")
    if standing.agree < DIFFERENT:
        return "has another size on the data that were not fitted"
    if standing.weak:
        return "is too weak here to be told from other physics that acts nearly the same"
    if rivals:
        return f"describes part of a torque that depends on {rivals}, of no form that is known"
    if standing.rivals:
        return "explains no more than a constant torque does"
    return "explains no more than a torque of no known form does"
