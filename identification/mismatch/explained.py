"""What few effects explain of the fitted recordings, and what of that may be claimed.

search over the mean → a push in every period → a drift → classes → claims. Not here: the data before, and the
`Diagnosis` that is made of it (`diagnosis`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from identification.base_parameters import BaseRegressor
from identification.mismatch.changes.drift_in_mean import find_drift_in_mean
from identification.mismatch.changes.repeated_contact import (
    beside,
    excess_per_row,
    explains_better,
    find_repeated_contact,
    misfit_elsewhere,
)
from identification.mismatch.claims import Claims, build_findings
from identification.mismatch.names.examination import joints_shown
from identification.mismatch.names.proposals import search_beside_classes
from identification.mismatch.nominal import Nominal
from identification.mismatch.prepared import Prepared
from identification.mismatch.problem import Problem
from identification.mismatch.search.library import Library
from identification.mismatch.search.search import SearchResult, search
from identification.mismatch.search.trial import Trial
from identification.mismatch.search.trial import fitted as fitted_again
from identification.mismatch.search.waves import waves_left
from identification.mismatch.settings import DiagnosisSettings
from identification.mismatch.unknown.covariance import ClassCovariance
from identification.mismatch.unknown.dependence import Dependence, find_dependence


@dataclass(frozen=True, slots=True, eq=False)
class Explained:
    """What the search settled on so far: the nominal model, what it was fitted to, and the effects beside it.

    library: of the fitted evidences. problem: theirs, weighted by the noise alone.
    """

    regressor: BaseRegressor
    fitted: Prepared
    library: Library
    problem: Problem
    result: SearchResult


Unseen = Callable[[BaseRegressor, Problem, Trial], Prepared | None]
"""What was not fitted, its effects acting on the torque of a trial's base parameters."""
Concluded = tuple[Explained, Prepared | None, Dependence | None, Claims]
"""What explains the fitted recordings, those not fitted, the classes (None without physics), and the claims."""


def explained_by_few(regressor: BaseRegressor, fitted: Prepared, settings: DiagnosisSettings) -> Explained:
    """What few effects explain of the mean of the periods, or of the rows where there are none."""
    problem = fitted.problem()
    library = replace(fitted.library(), waves=waves_left(problem, fitted.evidences))
    result = search(problem, library, fitted.renewal(regressor, library), settings)
    return Explained(regressor, fitted, library, problem, result)


def concluded(
    explained: Explained,
    unseen_by: Unseen,
    nominal: Nominal,
    least: Mapping[int | None, float],
    settings: DiagnosisSettings,
    *,
    physics: bool,
) -> Concluded:
    """What may be claimed, with a push in every period where that leaves nothing but noise beside what is claimed.

    least: λ that a drift needs on some joints (from 1), as in `_with_drift`. physics: whether the data allow any name.
    """

    def claimed(now: Explained) -> Concluded:
        return _claimed(_with_drift(now, least, settings), unseen_by, nominal, settings, physics=physics)

    pushed = _with_push(explained, unseen_by, settings)
    found = claimed(pushed)
    return found if pushed is explained or found[-1].trial.complete else claimed(explained)


def _claimed(
    now: Explained, unseen_by: Unseen, nominal: Nominal, settings: DiagnosisSettings, *, physics: bool
) -> Concluded:
    """What may be claimed of what the search found, against classes and held-out recordings."""
    unseen = unseen_by(now.regressor, now.problem, now.result.trial)
    now, dependence = _against_classes(now, unseen, settings) if physics else (now, None)
    claims = build_findings(now.result.library, now.result, now.fitted, unseen, settings, dependence, nominal)
    return now, unseen, dependence, claims


def _against_classes(
    now: Explained, unseen: Prepared | None, settings: DiagnosisSettings
) -> tuple[Explained, Dependence]:
    """The names, and the classes that they have to stand out from, asked also where a name alone shows, however weak.

    Where few names do not explain all, they are those that stand out from torque of no known form.
    """
    named = joints_shown(now.result.trial)
    dependence = find_dependence(now.fitted, unseen, named)
    if now.problem.noise_is_measured and not now.result.trial.complete:
        renewed, classes = now.fitted.renewal(now.regressor, now.library), ClassCovariance.of(now.problem, dependence)
        result = search_beside_classes(classes, now.result.before, now.library, renewed, settings)
        now = replace(now, result=result)
    shown = joints_shown(now.result.trial)
    asked_already = dependence.every.asked[sorted(shown)].all()
    return now, dependence if asked_already else find_dependence(now.fitted, unseen, named | shown)


def _with_push(now: Explained, unseen_by: Unseen, settings: DiagnosisSettings) -> Explained:
    """With a push that comes in every period, where it explains more and another motion does not speak against it."""

    def misfit_of_another_motion() -> float:
        other = unseen_by(now.regressor, now.problem, now.result.trial)
        return 0.0 if other is None else excess_per_row(other.problem())

    contact = find_repeated_contact(now.problem, now.fitted.evidences, now.result, settings, misfit_of_another_motion)
    if contact is None:
        return now
    renewed = now.fitted.renewal(now.regressor, now.library)
    # More effects than these explain nothing, and a push is claimed only where nothing but noise is left.
    few = replace(settings, largest_findings=settings.largest_explanation)
    other = search(now.fitted.with_change(contact).problem(), now.library, renewed, few)
    if not explains_better(now.problem, contact, other, now.result, settings):
        return now
    push = beside(now.problem, now.fitted.evidences, contact, other, settings)
    pushed = now.fitted.with_change(push)
    problem = pushed.problem()
    trial = fitted_again(problem, other.trial.members, settings)
    elsewhere = unseen_by(now.regressor, problem, trial)
    if elsewhere is not None and misfit_elsewhere(
        push, problem, trial.members, elsewhere.library(), elsewhere.torque, settings
    ):
        return now
    before = fitted_again(problem, (), settings)
    return replace(now, fitted=pushed, problem=problem, result=replace(other, trial=trial, before=before))


def _with_drift(now: Explained, least: Mapping[int | None, float], settings: DiagnosisSettings) -> Explained:
    """With a drift from zero that mean and contrasts prove together.

    least: λ that it needs on joints (from 1) of which their contrasts alone refused a change.
    """
    drift = find_drift_in_mean(now.problem, now.fitted.evidences, now.fitted.changes, now.result, settings)
    if drift is None or drift.gain < least.get(drift.estimate.place.joint, 0.0):
        return now
    renewed, fitted = now.fitted.renewal(now.regressor, now.library), now.fitted.with_change(drift)
    problem = fitted.problem()
    return replace(now, fitted=fitted, problem=problem, result=search(problem, now.library, renewed, settings))
