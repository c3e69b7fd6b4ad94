"""Findings from what the search settled on: held-out check first, then numbers, place, words."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.changes.between_periods import Change
from identification.mismatch.effects.base import CERTAIN
from identification.mismatch.effects.equivalence import ALSO_CALLED, separating_experiment
from identification.mismatch.effects.own_joint import joint_index
from identification.mismatch.evidence import Evidence, rows_to_time
from identification.mismatch.figures import Curve
from identification.mismatch.findings import Alternative, Finding
from identification.mismatch.fit_weights import with_periods, without_periods
from identification.mismatch.heldout import Residuals, share_removed
from identification.mismatch.names.alternatives import alternatives, significance
from identification.mismatch.names.earned import AgainstClasses
from identification.mismatch.names.examination import Check, Examination, Rows, joints_of, name_of, torque_of
from identification.mismatch.names.localisation import best_curve, where_of
from identification.mismatch.names.objections import Rule, recurring, untenable, useless, without_objection
from identification.mismatch.nominal import Nominal
from identification.mismatch.prepared import Prepared
from identification.mismatch.problem import Problem, off, with_torque
from identification.mismatch.search.detection import BandPower
from identification.mismatch.search.extension import Extension, extend, nominal_factor, predicted, uncertainties
from identification.mismatch.search.library import Library
from identification.mismatch.search.refinement import Member
from identification.mismatch.search.search import SearchResult
from identification.mismatch.search.trial import Trial, fitted, removal_scores, without
from identification.mismatch.settings import CAPTURE, DiagnosisSettings
from identification.mismatch.unknown.dependence import Dependence
from identification.recordings.independence import recording_names

REMEMBERED = 8
"""Sets of members whose residuals are kept, to be asked for again; those of many recordings fill the memory."""


@dataclass(frozen=True, slots=True, eq=False)
class Claims:
    """What is claimed, the trial behind it, and the residuals without and with it, on fitted and held-out recordings.

    before: of the user's fit, without periods of one on these rows; after: of the model with names. heldout_searched:
    with all that the search found, also what may not be named. power: what the names leave.
    beside: joint (from 0) → classes that it holds beside the names; empty without names.
    remarks: sentences on what describes the misfit but is not claimed, and on names that held-out data chose.
    too_weak: names that fit what is there, and that is too weak for a name.
    """

    findings: tuple[Finding, ...]
    trial: Trial
    extension: Extension
    before: Residuals
    after: Residuals
    heldout_before: Residuals | None
    heldout_after: Residuals | None
    heldout_searched: Residuals | None
    remarks: tuple[str, ...]
    power: BandPower
    beside: Mapping[int, frozenset[str]] = field(default_factory=dict)
    too_weak: tuple[Alternative, ...] = ()

    def with_too_weak(self, names: Iterable[tuple[str, int | None]]) -> Claims:
        """The same with further names, each with its joint from 1."""
        return replace(self, too_weak=(*self.too_weak, *(Alternative(*name) for name in names)))


def build_findings(
    library: Library,
    result: SearchResult,
    fitted_role: Prepared,
    unseen: Prepared | None,
    settings: DiagnosisSettings,
    dependence: Dependence | None,
    nominal: Nominal,
) -> Claims:
    """The members that no rule objects to, and the changes between periods, as findings.

    dependence: the classes that names have to stand out from; None where a data fault makes names worthless; then
    nothing is claimed. nominal: the user's fit.
    """
    physics = dependence is not None
    elsewhere = (
        None if unseen is None else Rows(unseen.evidences, unseen.torque, Library(library.effects, unseen.evidences))
    )
    exam = Examination(
        result.trial.nominal, result, Rows(fitted_role.evidences, fitted_role.torque, library), elsewhere, settings
    )
    settled = lru_cache(REMEMBERED)(partial(_as_fit_weighs, exam, fitted_role))
    classes = None if dependence is None else AgainstClasses(exam, dependence, settled)
    rules: list[Rule] = [partial(useless, exam, settled), partial(untenable, exam)]
    if classes is not None:
        rules.append(classes.unearned)
    trial, remarks, there = without_objection(exam, result.trial if physics else result.before, rules)
    before = _left_by_fit(exam, fitted_role, nominal)
    now = settled(trial.members) if trial.members else before
    others = () if unseen is None else unseen.evidences
    names = recording_names([item.recording for item in (*fitted_role.evidences, *others)])
    changes = fitted_role.changes if physics else ()
    again = recurring(changes, (*changes, *(() if unseen is None else unseen.changes)))
    remarks += [_came_again(change) for change in again]
    findings = [
        *between_periods([change for change in changes if change not in again], names),
        *_repeatable(exam, trial, now, before, settled),
    ]
    claims = Claims(
        tuple(findings), trial, now.extension, before.after, now.after, before.heldout_after, now.heldout_after,
        settled(result.trial.members).heldout_after if physics else None, tuple(remarks),
        fitted(exam.plain, trial.members, settings).power, {} if classes is None else classes.held(trial),
    )  # fmt: skip
    return claims.with_too_weak((member.effect.name, member.place.joint) for member in there)


def _left_by_fit(exam: Examination, fitted_role: Prepared, nominal: Nominal) -> Check:
    """What the user's fit leaves; without periods the fit of the rows that are not held out, as `fit` weighs them."""
    if not exam.problem.noise_is_measured:
        return _as_fit_weighs(replace(exam, problem=exam.plain), fitted_role, ())
    plain = extend(exam.plain, ())
    # Nuisances of the fitted recordings, behind the base parameters, are no part of that model.
    base = np.concatenate([nominal.values, np.zeros(plain.base.size - nominal.values.size)])
    return exam.left_by(replace(plain, base=base))


def _as_fit_weighs(exam: Examination, fitted_role: Prepared, members: tuple[Member, ...]) -> Check:
    """As `Examination.check`, but by the weights of `fit`: each joint by what these members leave of it.

    One rule for the model with and without the members. By the weights of the noise, or of what all effects leave, a
    joint that is misfitted without one of them bends the parameters of the others, and what that does would count for
    the effect or against it.
    """
    if exam.problem.noise_is_measured:
        return _through_what_is_left(exam, extend(exam.problem, members))
    return replace(exam, problem=without_periods(exam.problem, fitted_role, members)).check(members)


def _through_what_is_left(exam: Examination, beside: Extension) -> Check:
    """Names of the size that they have beside torque without one, and base parameters fitted through that torque.

    The model holds no such torque. Beside it base parameters are free along what it takes up, and foretell nothing
    there; the fit of what the names leave weighs rows as `fit` does.
    """
    plain, size = exam.plain, beside.base.size
    names = predicted(replace(beside, base=np.zeros(size)), np.zeros((*plain.weight.shape, size)), exam.rows.library)
    cuts = np.cumsum([len(rows) for rows in exam.rows.torque])[:-1]
    left = np.split(np.concatenate(exam.rows.torque) - names.T, cuts)
    through, covariance = extend(with_periods(with_torque(plain, left)), ()), beside.covariance.copy()
    both = extend(through.problem, beside.members).covariance
    # Base parameters move with the size of a name as they do in a fit of both.
    moved = both[:size, size:] @ np.linalg.pinv(both[size:, size:])
    drag = moved @ covariance[size:, size:]
    covariance[:size, :size] = through.covariance + drag @ moved.T
    covariance[:size, size:], covariance[size:, :size] = drag, drag.T
    # What a motion leaves open does not depend on what the model leaves: directions as the noise alone has them.
    loose = nominal_factor(plain)[-1]
    extension = replace(beside, base=through.base, covariance=covariance, loose=loose, problem=plain)
    return exam.left_by(extension)


def _came_again(change: Change) -> str:
    return (
        f"What looks like a push {change.estimate.shape['start_s']:.3g} s after the start comes at the same moment of "
        "another recording: it is none of a person's, and not claimed"
    )


def _repeatable(
    exam: Examination, trial: Trial, now: Check, before: Check, settled: Callable[[tuple[Member, ...]], Check]
) -> list[Finding]:
    """One finding per member that passed, with its alternatives and its held-out gain.

    settled: what a set of members leaves, as it stands in the result.
    """
    if not trial.members:
        return []
    problem, plain, library = exam.problem, exam.plain, exam.rows.library
    result, settings = exam.result, exam.settings
    scores = removal_scores(problem, trial, settings)
    sure = uncertainties(problem, now.extension, trial.problem.residual, library, coloured=not trial.complete)
    found = []
    for index, member in enumerate(trial.members):
        coefficients = now.extension.coefficients[index]
        estimate = sure[index].estimate(member, coefficients)
        rows = torque_of(member, coefficients, problem.n)
        gain = _heldout_gain(settled(without(trial.members, index)), settled(trial.members))
        parts = member.effect.parts(estimate)
        others = alternatives(problem, trial, index, exam.screen, library, settings) if len(parts) == 1 else ()
        for part in parts:
            parameters = member.effect.parameters(part)
            own, joints = rows, joints_of(member, rows)
            if len(parts) > 1:
                if member.effect.certainty(part) < CERTAIN or member.effect.is_impossible(part.coefficients, part.std):
                    continue
                joints = [joint_index(part.place)]
                own = np.where(np.isin(np.arange(problem.n), joints)[:, None], rows, 0.0)
            whitened = (own * plain.weight).ravel()
            visible = off(plain.basis, whitened)
            phase = member.effect.phase(library.evidences[0].motion, part.place, member.shape)
            curve, where = _place(plain, library.evidences, before, now, own, visible, joints, result, phase)
            found.append(
                Finding(
                    effect=member.effect.name,
                    place=part.place,
                    parameters=parameters,
                    coefficients=part.coefficients,
                    covariance=part.covariance,
                    shape=member.shape,
                    absorbed_fraction=1.0 - float(visible @ visible) / max(float(whitened @ whitened), 1e-300),
                    score=scores[index],
                    significance=significance(scores[index], member.rows.coefficients, len(result.candidates)),
                    sentence=_sentence(member.effect.sentence(part), others, gain.size > 0),
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
    if float(before.excess_energy[chosen].sum()) < CERTAIN * spread:
        return float("nan")
    return min(1.0, share_removed(before, after, joints)[0])


def _heldout_gain(rest: Check, now: Check) -> FloatArray:
    """(n,) Nm by which a member lowers the RMS of held-out recordings; empty without any."""
    if rest.heldout_after is None or now.heldout_after is None:
        return np.zeros(0)
    return np.asarray(rest.heldout_after.rms_nm - now.heldout_after.rms_nm, dtype=np.float64)


def _sentence(plain: str, others: Sequence[Alternative], checked: bool) -> str:
    if others:
        plain += (
            " This data cannot tell it from " + ", ".join(name_of(item.effect, item.joint) for item in others) + "."
        )
    return plain if checked else plain + " Unconfirmed: no held-out recording was given."


def _place(
    problem: Problem,
    evidences: Sequence[Evidence],
    before: Check,
    now: Check,
    rows: FloatArray,
    visible: FloatArray,
    joints: Sequence[int],
    result: SearchResult,
    phase: FloatArray | None,
) -> tuple[Curve, dict[str, Any]]:
    """Curve and `where` of a member on the joint it shows most, on the first evidence."""
    evidence, names = evidences[0], recording_names([item.recording for item in evidences])
    size = evidence.frequency.size
    shown = visible.reshape(problem.n, problem.rows) / np.where(problem.weight > 0.0, problem.weight, np.inf)
    joint = max(joints, key=lambda item: float(shown[item] @ shown[item]))
    parts = (before.after.rows, now.after.rows, rows, shown)
    series = rows_to_time(evidence, np.stack([part[joint, :size] for part in parts], axis=1)).T
    noise = float(np.sqrt((evidence.noise[:, joint] ** 2).sum() / evidence.samples))
    curve, share = best_curve(evidence, joint, series[0], series[1], noise, series[2], phase=phase)
    where = where_of(evidence, result.before.power, joint, series[3], curve, share)
    where["joints"] = [item + 1 for item in joints]
    if len(set(names)) > 1:
        where["times_in"] = names[0]
    return curve, where


def between_periods(changes: Sequence[Change], names: Sequence[str]) -> list[Finding]:
    """A finding of each change, which names its recording. names: of each evidence's recording."""
    found = []
    for change in changes:
        rms = np.sqrt((change.contribution**2).mean(axis=0).sum(axis=0))
        joints = [int(joint) + 1 for joint in np.flatnonzero(rms > CAPTURE * rms.max(initial=0.0))]
        by_period = (change.contribution**2).sum(axis=(1, 2))
        periods = [int(period) for period in np.flatnonzero(by_period > 0.05 * by_period.max(initial=0.0))]
        place, causes = change.estimate.place, [change.effect.name, *(item.effect for item in change.alternatives)]
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
                sentence=_sentence(change.effect.sentence(change.estimate), change.alternatives, checked=True),
                alternatives=change.alternatives,
                separating_experiment=separating_experiment(causes) if change.alternatives else None,
                where={"joint": place.joint, "joints": joints, "periods": periods, "recording": names[change.evidence]},
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
