"""The rule of abstention: which members of a model may be named, and which stand under another name.

A name is claimed only if it removes most of the excess misfit on its joints, on the fitted and on the held-out
recordings, and if held-out recordings do not contradict it. Where the noise is not measured nobody knows what the
excess is: there a name may remove less if it predicts what was not fitted, and then needs the odds. Odds, and what has
another form than a name, are for `earned`. Where the fitted motion cannot separate two names, held-out data choose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from identification.mismatch.effects.base import Place
from identification.mismatch.evidence import Evidence
from identification.mismatch.heldout import Residuals, residuals, worsened
from identification.mismatch.names.verdict import (
    contains,
    contrast,
    contrast_by_band,
    explains_enough,
    joints_of,
    rivals,
)
from identification.mismatch.problem import Problem
from identification.mismatch.search.extension import Extension, extend
from identification.mismatch.search.library import Library
from identification.mismatch.search.pruning import removal_score, removal_scores
from identification.mismatch.search.refinement import Member, other_kinds, score_of
from identification.mismatch.search.screening import build_screen
from identification.mismatch.search.search import SearchResult
from identification.mismatch.search.trial import Trial, fitted
from identification.mismatch.settings import DiagnosisSettings

FloatArray = npt.NDArray[np.float64]

MemberKey = tuple[str, Place]
"""Effect and place of a member."""

# Held-out excess energy in its own deviations beyond which other names of a member are tried.
PLAIN_EXCESS = 6.0
# Deviations below what a true effect gains in log-likelihood on held-out data at which these speak against it.
REFUTED = 2.0
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


def admitted(exam: Examination, trial: Trial) -> tuple[Trial, list[str], set[MemberKey]]:
    """The members that may be named, some under another name, and sentences on those that may not.

    Last, those that predict but remove too little of what is left, noise and all: they stand by their odds alone.
    """
    before = exam.check(())
    searched, trial = trial, _generalising(exam, trial, before)
    remarks, refused, on_odds = _choices(searched, trial), list[str](), set[MemberKey]()
    while trial.members:
        now = exam.check(trial.members)
        failing = [
            index
            for index, member in enumerate(trial.members)
            if (member.effect.name, member.place) not in on_odds and not _passes(exam, trial, index, before, now)
        ]
        if not failing:
            break
        loudest = sorted(failing, key=lambda index: -_left_on(now, trial, index))
        options = (_confirmed_rival(exam, trial, index, before) for index in loudest)
        better = next((option for option in options if option is not None), None)
        if better is not None:
            remarks.extend(_choices(trial, better))
            trial = better
            continue
        scores = removal_scores(exam.problem, trial, exam.settings)
        worst = min(failing, key=lambda index: scores[index])
        member = trial.members[worst]
        if _predicts(exam, trial, worst, now):
            on_odds.add((member.effect.name, member.place))
            continue
        refused.append(name_of(member.effect.name, member.place.joint))
        trial = fitted(exam.problem, without(trial.members, worst), exam.settings)
    why = (
        "describes part of the misfit, but without it no more than noise is left: it is not claimed"
        if trial.complete
        else "describes part of the misfit, but not enough of it to be claimed"
    )
    return trial, [*remarks, *(f"{named} {why}" for named in refused)], on_odds


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


def _generalising(exam: Examination, trial: Trial, before: Check) -> Trial:
    """Members under another name where that leaves less than half on held-out data and the fitted data do not object.

    Tried where held-out misfit is plain on a member's joints: the fitted motion was too small to tell the names apart.
    """
    for index in range(len(trial.members) if before.heldout_after is not None else 0):
        if trial.complete:
            trial = _likeliest(exam, trial, index)
        now = exam.check(trial.members)
        rows = torque_of(trial.members[index], now.extension.coefficients[index], trial.problem.n)
        joints = joints_of(trial.members[index], rows)
        left = now.heldout_after
        if left is None or not np.any(left.excess_energy[joints] > PLAIN_EXCESS * left.excess_deviation[joints]):
            continue
        other = _confirmed_rival(exam, trial, index, before)
        if other is not None and _left_on(exam.check(other.members), other, index) < 0.5 * _left_on(now, trial, index):
            trial = other
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
    library, margin = exam.rows.library, settings.margin_of_search
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


def _left_on(now: Check, trial: Trial, index: int) -> float:
    """What a model leaves on held-out recordings on the joints of one member, in squares of the expected scatter."""
    left = now.after if now.heldout_after is None else now.heldout_after
    rows = torque_of(trial.members[index], now.extension.coefficients[index], trial.problem.n)
    joints = joints_of(trial.members[index], rows)
    return float(((left.rows[joints] / left.noise[joints]) ** 2).sum())


def _confirmed_rival(exam: Examination, trial: Trial, index: int, before: Check) -> Trial | None:
    """The trial with one member in another name that this data cannot tell from it and that held-out data confirm."""
    if before.heldout_after is None:
        return None
    problem, settings = exam.problem, exam.settings
    screen = build_screen(problem, exam.result.candidates)
    passed: list[tuple[float, Trial]] = []
    for _, rival in rivals(problem, trial, index, screen, exam.rows.library, settings):
        members = [rival if place == index else item for place, item in enumerate(trial.members)]
        other = fitted(problem, members, settings, trial)
        now = exam.check(members)
        if now.heldout_after is not None and _passes(exam, other, index, before, now):
            left = now.heldout_after.rows / now.heldout_after.noise
            passed.append((float((left**2).sum()), other))
    return min(passed, key=lambda item: item[0])[1] if passed else None


def _predicts(exam: Examination, trial: Trial, index: int, now: Check) -> bool:
    """Whether a member, beside noise that is not measured, lowers what is left of rows that were not fitted.

    On its joints beyond what these rows allow by chance, and on no joint to its loss.
    """
    other, unseen = exam.check(without(trial.members, index)).heldout_after, now.heldout_after
    if exam.problem.noise_is_measured or trial.complete or unseen is None or other is None:
        return False
    member = trial.members[index]
    joints = joints_of(member, torque_of(member, now.extension.coefficients[index], trial.problem.n))
    return (
        removal_score(exam.problem, trial, index, exam.settings) >= exam.settings.background_score
        and bool(worsened(unseen, other)[joints].any())
        and not worsened(other, unseen).any()
    )


def _passes(exam: Examination, trial: Trial, index: int, before: Check, now: Check) -> bool:
    """The rule of abstention for one member: enough removed on its joints, here and there, and no loss there."""
    member, settings = trial.members[index], exam.settings
    torque = torque_of(member, now.extension.coefficients[index], trial.problem.n)
    joints = joints_of(member, torque)
    rest, complete = exam.check(without(trial.members, index)), trial.complete
    if not complete and (
        # Whoever is left of a set that explained all, and does no longer, is judged as beside any background.
        removal_score(exam.problem, trial, index, settings) < settings.background_score
        or not explains_enough(before.after, now.after, joints, settings.share_removed, complete=False)
        or (
            trial.problem.noise_is_measured
            and contrast(rest.after, now.after, joints) < settings.contrast_to_background
            and contrast_by_band(rest.after, now.after, joints, exam.problem.band, settings) < settings.background_score
        )
    ):
        return False
    if now.heldout_after is None or before.heldout_after is None:
        return True
    needed = settings.heldout_share_removed
    if not explains_enough(before.heldout_after, now.heldout_after, joints, needed, complete=complete):
        return False
    other = rest.heldout_after
    if other is None:
        return True
    if worsened(other, now.heldout_after).any():
        return False
    if complete:
        there = now.heldout_after.log_likelihood - other.log_likelihood
        if removal_score(exam.problem, trial, index, settings) + there < settings.complete_score:
            return False
        # A true effect gains a²/2 there, with a deviation of a. One that gains nothing is not refuted by that alone.
        expected = now.heldout_after.squared_distance(other)
        return there >= min(-EVEN, 0.5 * expected - REFUTED * float(np.sqrt(expected)))
    gain = float((other.excess_energy[joints] - now.heldout_after.excess_energy[joints]).sum())
    variance = (other.excess_deviation[joints] ** 2 + now.heldout_after.excess_deviation[joints] ** 2).sum()
    return gain > -2.0 * float(np.sqrt(variance))
