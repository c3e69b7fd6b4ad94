"""What members of a model are examined with, and which of them stand under another name.

Where the fitted motion cannot separate two names, fitted and held-out data together choose. Whether a name may be
claimed at all is for `tenable` and `earned`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from identification.mismatch.evidence import Evidence
from identification.mismatch.heldout import Residuals, residuals
from identification.mismatch.names.verdict import (
    contains,
    rivals,
)
from identification.mismatch.problem import Problem
from identification.mismatch.search.extension import Extension, extend
from identification.mismatch.search.library import Library
from identification.mismatch.search.pruning import removal_score
from identification.mismatch.search.refinement import Member, other_kinds, score_of
from identification.mismatch.search.screening import build_screen
from identification.mismatch.search.search import SearchResult
from identification.mismatch.search.trial import Trial, fitted
from identification.mismatch.settings import DiagnosisSettings

FloatArray = npt.NDArray[np.float64]

# Log-likelihood within which two names are as good as even: then the one that the library lists first stands.
EVEN = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Evidences of one role, and their torque (R, n) Nm each without what changes between periods."""

    evidences: tuple[Evidence, ...]
    torque: tuple[FloatArray, ...]
    library: Library


@dataclass(frozen=True, slots=True, eq=False)
class Check:
    """A set of members fitted, and what it leaves on the fitted and on the held-out recordings."""

    extension: Extension
    after: Residuals
    heldout_after: Residuals | None


@dataclass(frozen=True, slots=True, eq=False)
class Examination:
    """What members are examined with: problem and search result, fitted and held-out rows, thresholds."""

    problem: Problem
    result: SearchResult
    rows: Rows
    unseen: Rows | None
    settings: DiagnosisSettings

    def check(self, members: Sequence[Member]) -> Check:
        """What a set of members leaves, fitted beside the base parameters."""
        extension = extend(self.problem, members)
        after, unseen = (
            None if rows is None else residuals(extension, rows.evidences, rows.library, rows.torque)
            for rows in (self.rows, self.unseen)
        )
        assert after is not None
        return Check(extension, after, unseen)


def admitted(exam: Examination, trial: Trial) -> tuple[Trial, list[str]]:
    """The members, some under a name that fitted and held-out recordings find likelier, and what is said of that."""
    chosen = _generalising(exam, trial)
    return chosen, _choices(trial, chosen)


def torque_of(member: Member, coefficients: FloatArray, n: int) -> FloatArray:
    """Torque rows (n, R) Nm of a member."""
    rows = np.zeros((n, member.rows.rows.shape[1]))
    rows[list(member.rows.joints)] = member.rows.rows @ coefficients
    return rows


def without(members: Sequence[Member], index: int) -> list[Member]:
    """All members but one."""
    return [item for position, item in enumerate(members) if position != index]


def name_of(effect: str, joint: int | None) -> str:
    """An effect and its place in words."""
    words = effect.replace("_", " ")
    return words if joint is None else f"{words} of joint {joint}"


def _generalising(exam: Examination, trial: Trial) -> Trial:
    """Members under the likeliest name: the fitted motion may be too small to tell names apart."""
    for index in range(len(trial.members) if exam.unseen is not None else 0):
        if trial.complete:
            trial = _likeliest(exam, trial, index)
    return trial


def _likeliest(exam: Examination, trial: Trial, index: int) -> Trial:
    """One member under the name that fitted and held-out recordings together find likeliest.

    Of the names that the fitted recordings leave open, each with the parameters that they give it. What contains
    another as a special case must explain clearly more: a spring of which only the constant shows is an offset. Of
    names that come out even the one that the library lists first is taken. Each name is asked in every whole-numbered
    kind that the fitted recordings leave open (the order of a wave).
    """
    problem, settings, member = exam.problem, exam.settings, trial.members[index]
    screen = build_screen(problem, exam.result.candidates)
    rest = fitted(problem, without(trial.members, index), settings, trial).problem
    order = {effect.name: place for place, effect in enumerate(exam.rows.library.effects)}
    best = trial
    most = removal_score(problem, trial, index, settings) + _held_out_likelihood(exam.check(trial.members))
    library, margin = exam.rows.library, settings.margin_of_indistinguishable
    open_names = [member, *(rival for _, rival in rivals(problem, trial, index, screen, library, settings))]
    kinds = [kind for item in open_names for kind in other_kinds(rest, library, item, margin)]
    for rival in (*open_names[1:], *kinds):
        members = [rival if place == index else item for place, item in enumerate(trial.members)]
        evidence = score_of(rest, rival) + _held_out_likelihood(exam.check(members))
        if rival.effect is member.effect:
            evidence -= EVEN
        elif contains(rest, member, rival):
            evidence += settings.margin_of_simplicity
        elif contains(rest, rival, member):
            evidence -= settings.margin_of_simplicity
        else:
            evidence += EVEN if order[rival.effect.name] < order[member.effect.name] else -EVEN
        if evidence > most:
            other = fitted(problem, members, settings, trial)
            if other.complete:
                best, most = other, evidence
    return best


def _held_out_likelihood(model: Check) -> float:
    return 0.0 if model.heldout_after is None else model.heldout_after.log_likelihood


def _choices(before: Trial, after: Trial) -> list[str]:
    """What is said of members that held-out data gave another name; both trials hold them in the same order."""
    return [
        f"The fitted motion cannot separate {name_of(new.effect.name, new.place.joint)} from "
        f"{name_of(old.effect.name, old.place.joint)}: the held-out recordings chose, so their figures are not "
        "independent of this name"
        for old, new in zip(before.members, after.members, strict=True)
        if (old.effect.name, old.place) != (new.effect.name, new.place)
    ]
