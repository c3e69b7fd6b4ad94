"""Findings from what the search settled on: held-out check first, then numbers, place, words.

Called by the diagnosis.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from identification.mismatch.between_periods import Change
from identification.mismatch.effects.base import Estimate
from identification.mismatch.effects.equivalence import ALSO_CALLED, separating_experiment
from identification.mismatch.evidence import Evidence, rows_to_time
from identification.mismatch.extension import Extension, extend, uncertainties
from identification.mismatch.findings import Alternative, Curve, Finding
from identification.mismatch.heldout import Residuals, residuals, share_removed
from identification.mismatch.library import Library
from identification.mismatch.localisation import best_curve, where_of
from identification.mismatch.problem import Problem, off
from identification.mismatch.refinement import Member
from identification.mismatch.screening import build_screen
from identification.mismatch.search import SearchResult, Trial, fitted, removal_scores
from identification.mismatch.settings import DiagnosisSettings
from identification.mismatch.verdict import (
    alternatives,
    contrast,
    explains_enough,
    has_its_form,
    joints_of,
    rivals,
    significance,
)

FloatArray = npt.NDArray[np.float64]

# Held-out excess energy in its own deviations beyond which other names of a member are tried.
PLAIN_EXCESS = 6.0


class Role(Protocol):
    """Evidences of one role, their changes between periods, and their torque without those."""

    @property
    def evidences(self) -> tuple[Evidence, ...]:
        """One per stretch."""

    @property
    def changes(self) -> tuple[Change, ...]:
        """What differs between their periods."""

    @property
    def torque(self) -> tuple[FloatArray, ...]:
        """(R, n) Nm per evidence, changes taken off."""


@dataclass(frozen=True, slots=True, eq=False)
class Claims:
    """What is claimed, the trial behind it, and the residuals without and with it, on fitted and held-out recordings.

    remarks: sentences on what describes the misfit but is not claimed, and on names that held-out data chose.
    """

    findings: tuple[Finding, ...]
    trial: Trial
    extension: Extension
    before: Residuals
    after: Residuals
    heldout_before: Residuals | None
    heldout_after: Residuals | None
    remarks: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Check:
    extension: Extension
    after: Residuals
    heldout_after: Residuals | None


_Checker = Callable[[Sequence[Member]], _Check]


def build_findings(
    problem: Problem,
    library: Library,
    result: SearchResult,
    fitted_role: Role,
    unseen: Role | None,
    settings: DiagnosisSettings,
    *,
    physics: bool,
) -> Claims:
    """The members that the rule of abstention lets pass, and the changes between periods, as findings.

    physics: False where a data fault makes names worthless; then nothing is claimed.
    """
    elsewhere = None if unseen is None else Library(library.effects, unseen.evidences)

    def check(members: Sequence[Member]) -> _Check:
        extension = extend(problem, members)
        after = residuals(extension, fitted_role.evidences, library, fitted_role.torque)
        if unseen is None or elsewhere is None:
            return _Check(extension, after, None)
        return _Check(extension, after, residuals(extension, unseen.evidences, elsewhere, unseen.torque))

    before = check(())
    trial = result.trial if physics else result.before
    searched = trial
    trial = _generalising(problem, library, result, trial, before, check, settings)
    remarks = _choices(searched, trial)
    now = check(trial.members)
    while trial.members:
        failing = [
            index
            for index in range(len(trial.members))
            if not _passes(library, trial, index, before, now, check, settings)
        ]
        if not failing:
            break
        loudest = sorted(failing, key=lambda index: -_left_on(now, trial, index))
        options = (_confirmed_rival(problem, library, result, trial, i, before, check, settings) for i in loudest)
        better = next((option for option in options if option is not None), None)
        if better is not None:
            remarks.extend(_choices(trial, better))
            trial = better
            now = check(trial.members)
            continue
        scores = removal_scores(problem, trial, settings)
        worst = min(failing, key=lambda index: scores[index])
        member = trial.members[worst]
        named = _named(member.effect.name, member.place.joint)
        remarks.append(f"{named} describes part of the misfit, but not enough of it to be claimed")
        trial = fitted(problem, _without(trial.members, worst), settings)
        now = check(trial.members)
    findings = [
        *_between(fitted_role.changes if physics else (), len(library.evidences)),
        *_repeatable(problem, library, result, trial, now, before, check, settings),
    ]
    return Claims(
        tuple(findings), trial, now.extension, before.after, now.after, before.heldout_after, now.heldout_after,
        tuple(remarks),
    )  # fmt: skip


def _generalising(
    problem: Problem,
    library: Library,
    result: SearchResult,
    trial: Trial,
    before: _Check,
    check: _Checker,
    settings: DiagnosisSettings,
) -> Trial:
    """Members under another name where that leaves less than half on held-out data and the fitted data do not object.

    Tried where held-out misfit is plain on a member's joints: the fitted motion was too small to tell the names apart.
    """
    for index in range(len(trial.members) if before.heldout_after is not None else 0):
        now = check(trial.members)
        rows = _torque_of(trial.members[index], now.extension.coefficients[index], trial.problem.n)
        joints = joints_of(trial.members[index], rows)
        left = now.heldout_after
        if left is None or not np.any(left.excess_energy[joints] > PLAIN_EXCESS * left.excess_deviation[joints]):
            continue
        other = _confirmed_rival(problem, library, result, trial, index, before, check, settings)
        if other is not None and _left_on(check(other.members), other, index) < 0.5 * _left_on(now, trial, index):
            trial = other
    return trial


def _choices(before: Trial, after: Trial) -> list[str]:
    """What is said of members that held-out data gave another name; both trials hold them in the same order."""
    return [
        f"The fitted motion cannot separate {_named(new.effect.name, new.place.joint)} from "
        f"{_named(old.effect.name, old.place.joint)}: the held-out recordings chose, so their figures are not "
        "independent of this name"
        for old, new in zip(before.members, after.members, strict=True)
        if (old.effect.name, old.place) != (new.effect.name, new.place)
    ]


def _left_on(now: _Check, trial: Trial, index: int) -> float:
    """What a model leaves on held-out recordings on the joints of one member, in squares of the expected scatter."""
    left = now.after if now.heldout_after is None else now.heldout_after
    rows = _torque_of(trial.members[index], now.extension.coefficients[index], trial.problem.n)
    joints = joints_of(trial.members[index], rows)
    return float(((left.rows[joints] / left.noise[joints]) ** 2).sum())


def _confirmed_rival(
    problem: Problem,
    library: Library,
    result: SearchResult,
    trial: Trial,
    index: int,
    before: _Check,
    check: _Checker,
    settings: DiagnosisSettings,
) -> Trial | None:
    """The trial with one member in another name that this data cannot tell from it and that held-out data confirm."""
    if before.heldout_after is None:
        return None
    screen = build_screen(problem, result.candidates)
    passed: list[tuple[float, Trial]] = []
    for _, rival in rivals(problem, trial, index, screen, library, settings):
        members = [rival if place == index else item for place, item in enumerate(trial.members)]
        other = fitted(problem, members, settings, trial)
        now = check(members)
        if now.heldout_after is not None and _passes(library, other, index, before, now, check, settings):
            left = now.heldout_after.rows / now.heldout_after.noise
            passed.append((float((left**2).sum()), other))
    return min(passed, key=lambda item: item[0])[1] if passed else None


def _torque_of(member: Member, coefficients: FloatArray, n: int) -> FloatArray:
    """Torque rows (n, R) Nm of a member."""
    rows = np.zeros((n, member.rows.rows.shape[1]))
    rows[list(member.rows.joints)] = member.rows.rows @ coefficients
    return rows


def _passes(
    library: Library,
    trial: Trial,
    index: int,
    before: _Check,
    now: _Check,
    check: _Checker,
    settings: DiagnosisSettings,
) -> bool:
    """The rule of abstention for one member: enough removed on its joints, here and there, and no loss there."""
    member = trial.members[index]
    torque = _torque_of(member, now.extension.coefficients[index], trial.problem.n)
    joints = joints_of(member, torque)
    rest, complete = check(_without(trial.members, index)), trial.complete
    if complete:
        loudest = int(np.argmax(((torque / now.after.sensor_noise) ** 2).sum(axis=1)))
        if not has_its_form(trial.problem, library.evidences, loudest, rest.after, now.after, settings):
            return False
    elif not explains_enough(before.after, now.after, joints, settings.share_removed, complete=False) or (
        trial.problem.noise_is_measured and contrast(rest.after, now.after, joints) < settings.contrast_to_background
    ):
        return False
    if now.heldout_after is None or before.heldout_after is None:
        return True
    needed = settings.heldout_share_removed
    if not explains_enough(before.heldout_after, now.heldout_after, joints, needed, complete=complete):
        return False
    without = rest.heldout_after
    if without is None:
        return True
    gain = float((without.excess_energy[joints] - now.heldout_after.excess_energy[joints]).sum())
    variance = (without.excess_deviation[joints] ** 2 + now.heldout_after.excess_deviation[joints] ** 2).sum()
    return gain > -2.0 * float(np.sqrt(variance))


def _repeatable(
    problem: Problem,
    library: Library,
    result: SearchResult,
    trial: Trial,
    now: _Check,
    before: _Check,
    check: _Checker,
    settings: DiagnosisSettings,
) -> list[Finding]:
    """One finding per member that passed, with its alternatives and its held-out gain."""
    if not trial.members:
        return []
    screen = build_screen(problem, result.candidates)
    scores = removal_scores(problem, trial, settings)
    sure = uncertainties(problem, now.extension, trial.problem.residual, library, coloured=not trial.complete)
    found = []
    for index, member in enumerate(trial.members):
        coefficients = now.extension.coefficients[index]
        estimate = Estimate(member.place, member.shape, coefficients, sure[index].covariance, sure[index].shape_std)
        others = alternatives(problem, trial, index, screen, library, settings)
        rows = _torque_of(member, coefficients, problem.n)
        joints = joints_of(member, rows)
        whitened = (rows * problem.weight).ravel()
        visible = off(problem.basis, whitened)
        gain = _heldout_gain(check(_without(trial.members, index)), now)
        curve, where = _place(problem, library.evidences[0], before, now, rows, visible, joints, result)
        found.append(
            Finding(
                effect=member.effect.name,
                place=member.place,
                parameters=member.effect.parameters(estimate),
                coefficients=coefficients,
                covariance=sure[index].covariance,
                shape=member.shape,
                absorbed_fraction=1.0 - float(visible @ visible) / max(float(whitened @ whitened), 1e-300),
                score=scores[index],
                significance=significance(scores[index], len(member.selection), len(result.candidates)),
                sentence=_sentence(member.effect.sentence(estimate), others, gain.size > 0),
                where=where,
                heldout_gain_nm=gain,
                confirmed=None if gain.size == 0 else bool(gain[joints].max() > 0.0),
                alternatives=others,
                separating_experiment=separating_experiment([member.effect.name, *(item.effect for item in others)])
                if others or member.effect.name in ALSO_CALLED
                else None,
                share_removed=_clear_share(before.after, now.after, joints),
                curve=curve,
            )
        )
    return found


def _clear_share(before: Residuals, after: Residuals, joints: Sequence[int]) -> float:
    """Share of the excess energy that is gone; nan where the excess itself does not stand clear of the noise."""
    chosen = list(joints)
    spread = float(np.sqrt((before.excess_deviation[chosen] ** 2).sum()))
    if float(before.excess_energy[chosen].sum()) < 2.0 * spread:
        return float("nan")
    return min(1.0, share_removed(before, after, joints)[0])


def _without(members: Sequence[Member], index: int) -> list[Member]:
    return [item for position, item in enumerate(members) if position != index]


def _heldout_gain(rest: _Check, now: _Check) -> FloatArray:
    """(n,) Nm by which a member lowers the RMS of held-out recordings; empty without any."""
    if rest.heldout_after is None or now.heldout_after is None:
        return np.zeros(0)
    return np.asarray(rest.heldout_after.rms_nm - now.heldout_after.rms_nm, dtype=np.float64)


def _sentence(plain: str, others: Sequence[Alternative], checked: bool) -> str:
    if others:
        plain += " This data cannot tell it from " + ", ".join(_named(item.effect, item.joint) for item in others) + "."
    return plain if checked else plain + " Unconfirmed: no held-out recording was given."


def _place(
    problem: Problem,
    evidence: Evidence,
    before: _Check,
    now: _Check,
    rows: FloatArray,
    visible: FloatArray,
    joints: Sequence[int],
    result: SearchResult,
) -> tuple[Curve, dict[str, Any]]:
    """Curve and `where` of a member on the joint it shows most, on the first evidence."""
    size = evidence.frequency.size
    shown = visible.reshape(problem.n, problem.rows) / np.where(problem.weight > 0.0, problem.weight, np.inf)
    joint = max(joints, key=lambda item: float(shown[item] @ shown[item]))
    parts = (before.after.rows, now.after.rows, rows, shown)
    series = rows_to_time(evidence, np.stack([part[joint, :size] for part in parts], axis=1)).T
    noise = float(np.sqrt((evidence.noise[:, joint] ** 2).sum() / evidence.samples))
    curve, share = best_curve(evidence, joint, series[0], series[1], noise, series[2])
    where = where_of(evidence, result.before.power, joint, series[3], curve, share)
    where["joints"] = [item + 1 for item in joints]
    return curve, where


def _between(changes: Sequence[Change], evidences: int) -> list[Finding]:
    found = []
    for change in changes:
        rms = np.sqrt((change.contribution**2).mean(axis=0).sum(axis=0))
        joints = [int(joint) + 1 for joint in np.flatnonzero(rms > 0.1 * rms.max(initial=0.0))]
        by_period = (change.contribution**2).sum(axis=(1, 2))
        periods = [int(period) for period in np.flatnonzero(by_period > 0.05 * by_period.max(initial=0.0))]
        place = change.estimate.place
        found.append(
            Finding(
                effect=change.effect.name,
                place=place,
                parameters=change.effect.parameters(change.estimate),
                coefficients=change.estimate.coefficients,
                covariance=change.estimate.covariance,
                shape=change.estimate.shape,
                absorbed_fraction=0.0,
                score=change.score,
                significance=float(10.0 ** min(0.0, change.log10_chance)),
                sentence=change.effect.sentence(change.estimate),
                where={"joint": place.joint, "joints": joints, "periods": periods, "recording": change.evidence}
                if evidences > 1
                else {"joint": place.joint, "joints": joints, "periods": periods},
                curve=_curve_over_periods(change),
            )
        )
    return found


def _curve_over_periods(change: Change) -> Curve:
    """Mean torque of the change in each period on the joint it shows most."""
    joint = int(np.argmax((change.contribution**2).sum(axis=(0, 1))))
    size = np.sqrt((change.contribution[:, :, joint] ** 2).sum(axis=1))
    period = np.arange(size.size, dtype=np.float64)
    return Curve(joint + 1, "period", "", period, size, np.zeros_like(size), np.zeros_like(size), size)


def _named(effect: str, joint: int | None) -> str:
    words = effect.replace("_", " ")
    return words if joint is None else f"{words} of joint {joint}"
