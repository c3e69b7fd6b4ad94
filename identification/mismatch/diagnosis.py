"""The entry point: recordings in, one `Diagnosis` out.

recordings → data faults → evidence → changes between periods → search over the mean → held-out check → findings. The
parts live in the modules beside this one; this one only joins them. Called by the command line and the worker.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from identification.base_parameters import BaseRegressor
from identification.errors import EstimationError
from identification.fitting.settings import Split
from identification.mismatch.aperiodic_evidence import choose_regressor, default_split, weighted_by_result
from identification.mismatch.baseline import baseline_values, compare_model
from identification.mismatch.between_periods import Change, find_between_periods
from identification.mismatch.claims import Claims, build_findings
from identification.mismatch.data_faults import find_data_faults
from identification.mismatch.drift_in_mean import find_drift_in_mean
from identification.mismatch.effects import EFFECTS
from identification.mismatch.evidence import Evidence, build_evidence, fit_parameters, with_parameters
from identification.mismatch.extension import extend
from identification.mismatch.findings import Baseline, DataFault, Diagnosis
from identification.mismatch.friction_transition import explains_better as turns_better
from identification.mismatch.friction_transition import transition_sentence, transition_velocity
from identification.mismatch.heldout import Residuals, residuals
from identification.mismatch.library import Library
from identification.mismatch.problem import Problem, build_problem
from identification.mismatch.repeated_contact import beside, explains_better, find_repeated_contact, misfit_elsewhere
from identification.mismatch.search import search
from identification.mismatch.second_encoder import compare_encoders
from identification.mismatch.settings import DiagnosisSettings
from identification.mismatch.summary import summarise
from identification.mismatch.trial import Trial
from identification.mismatch.trial import fitted as fitted_again
from identification.model_file import Model
from identification.recordings.recording import Recording
from identification.robots import RobotModel

FloatArray = npt.NDArray[np.float64]
Progress = Callable[[str, float], None]

MOST_TRANSITIONS = 3
"""Turns in which the width of the friction's transition and the effects beside it are found."""


@dataclass(frozen=True, slots=True, eq=False)
class Prepared:
    """Evidences of one role (fitted or held out), what changes between their periods, and torque without that."""

    evidences: tuple[Evidence, ...]
    changes: tuple[Change, ...]
    torque: tuple[FloatArray, ...]


def diagnose(
    recordings: Sequence[Recording],
    robot: RobotModel,
    *,
    heldout: Sequence[Recording] = (),
    settings: DiagnosisSettings | None = None,
    model: Model | Path | None = None,
    progress: Progress | None = None,
) -> Diagnosis:
    """Locate and name what the nominal model leaves out of these recordings, and check it on the held-out ones.

    model: a model.json or a simulator's file to compare with first; what of it is wrong parameters, and what is left,
    stands in `model_comparison`. Raises EstimationError when no recording is given, RecordingError for one that cannot
    be used, ModelFileError or RobotError for such a model.
    """
    settings = settings if settings is not None else DiagnosisSettings()
    if not heldout:
        settings = replace(settings, provisional_score=settings.complete_score)
    report = progress if progress is not None else _silent
    if not recordings:
        raise EstimationError("No recording was given to diagnose")
    split = None
    if not heldout and not any(recording.is_periodic for recording in recordings):
        split = default_split(recordings) if settings.split is None else Split.parse(settings.split)
    regressor = choose_regressor(recordings, robot, settings, split)
    given = None if model is None else baseline_values(model, regressor)
    report("data", 0.05)
    faults = tuple(fault for recording in recordings for fault in find_data_faults(recording, robot, regressor))
    report("evidence", 0.1)
    upright = [_upright(item, faults) for item in recordings]
    fitted = _prepare(upright, robot, regressor, settings, split)
    report("search", 0.3)
    problem = _problem(fitted)
    library = Library(EFFECTS, fitted.evidences)
    renewed = _renewal(fitted, regressor)

    def unseen_by(problem: Problem, trial: Trial) -> Prepared | None:
        """What was not fitted, its effects acting on the torque of a trial's base parameters."""
        if not heldout and split is None:
            return None
        values = extend(problem, trial.members).base[: regressor.size]
        others = [_upright(item, faults) for item in heldout] if heldout else upright
        return _prepare(others, robot, regressor, settings, split, values)

    inactive = library.candidates()[1]
    if not problem.noise_is_measured:
        # Weights are those of the misfit: the joints with most of it count least until theirs is explained.
        first = search(problem, library, renewed, settings)
        fitted = replace(fitted, evidences=weighted_by_result(fitted.evidences, first.trial))
        problem, renewed = _problem(fitted), _renewal(fitted, regressor)
    result = search(problem, library, renewed, settings)
    for turn in range(MOST_TRANSITIONS):
        velocity = transition_velocity(problem, fitted, regressor, result, settings)
        if velocity is None:
            break
        turning = BaseRegressor(robot, replace(regressor.options, coulomb_velocity=velocity))
        prepared = _prepare(upright, robot, turning, settings, split)
        lately = search(_problem(prepared), Library(EFFECTS, prepared.evidences), _renewal(prepared, turning), settings)
        if not turns_better(lately, result, settings, first=turn == 0):
            break
        regressor, fitted, problem, result = turning, prepared, _problem(prepared), lately
        library, renewed = Library(EFFECTS, fitted.evidences), _renewal(fitted, regressor)
    contact = find_repeated_contact(problem, fitted.evidences, result, settings)
    if contact is not None:
        other = search(_problem(_with_change(fitted, contact)), library, renewed, settings)
        if explains_better(problem, contact, other, result, settings):
            pushed = _with_change(fitted, beside(problem, fitted.evidences, contact, other, settings))
            beside_it = _problem(pushed)
            trial = fitted_again(beside_it, other.trial.members, settings)
            elsewhere = unseen_by(beside_it, trial)
            if elsewhere is None or not misfit_elsewhere(
                pushed.changes[-1],
                beside_it,
                trial.members,
                Library(EFFECTS, elsewhere.evidences),
                elsewhere.torque,
                settings,
            ):
                fitted, problem, result = pushed, beside_it, replace(other, trial=trial)
    drift = find_drift_in_mean(problem, fitted.evidences, fitted.changes, result, settings)
    if drift is not None:
        fitted = _with_change(fitted, drift)
        problem = _problem(fitted)
        result = search(problem, library, renewed, settings)
    report("held-out check", 0.8)
    unseen = unseen_by(problem, result.trial)
    claims = build_findings(
        problem, result.library, result, fitted, unseen, settings, physics=not _stops_physics(faults)
    )
    report("findings", 0.9)
    nominal = extend(build_problem(fitted.evidences), ())
    plain = residuals(nominal, fitted.evidences, library)
    baseline = _baseline(plain, result.before.power.probability, claims)
    diagnosis = summarise(
        problem, result.library, result, inactive, claims, baseline, fitted, unseen, faults, regressor, settings
    )
    if given is not None:
        compared = compare_model(
            *given, fitted.evidences, problem, claims.extension, claims.after, plain.rms_nm, regressor
        )
        diagnosis = replace(diagnosis, model_comparison=compared, notes=(compared.sentence, *diagnosis.notes))
    if regressor.options.coulomb_velocity > 0.0:
        said = transition_sentence(regressor.options.coulomb_velocity)
        diagnosis = replace(diagnosis, notes=(*diagnosis.notes, said))
    encoders = compare_encoders(recordings, heldout)
    if encoders:
        sentences = tuple(item.sentence for item in encoders)
        diagnosis = replace(diagnosis, encoders=encoders, notes=(*diagnosis.notes, *sentences))
    report("done", 1.0)
    return diagnosis


def _prepare(
    recordings: Sequence[Recording],
    robot: RobotModel,
    regressor: BaseRegressor,
    settings: DiagnosisSettings,
    split: Split | None,
    values: FloatArray | None = None,
) -> Prepared:
    """values: base parameters whose torque the effects see; with them the rows are those that the split holds out.

    None: the rows to fit, and the parameters that fit them all together.
    """
    evidences = [
        part
        for recording in recordings
        for part in build_evidence(recording, robot, regressor, settings, split, held_out=values is not None)
    ]
    if values is None and len(evidences) > 1:
        values = fit_parameters(evidences)
    if values is not None:
        evidences = [with_parameters(evidence, regressor, values) for evidence in evidences]
    changes = find_between_periods(evidences, EFFECTS)
    torque = [evidence.torque.copy() for evidence in evidences]
    for change in changes:
        torque[change.evidence] -= change.contribution.mean(axis=0)
    return Prepared(tuple(evidences), changes, tuple(torque))


def _with_change(prepared: Prepared, change: Change) -> Prepared:
    torque = list(prepared.torque)
    torque[change.evidence] = torque[change.evidence] - change.contribution.mean(axis=0)
    return replace(prepared, changes=(*prepared.changes, change), torque=tuple(torque))


def _renewal(prepared: Prepared, regressor: BaseRegressor) -> Callable[[FloatArray], Library]:
    """The library seen from other base parameters (and whatever stands behind them), for the search."""

    def renewed(values: FloatArray) -> Library:
        base = values[: regressor.size]
        return Library(EFFECTS, tuple(with_parameters(evidence, regressor, base) for evidence in prepared.evidences))

    return renewed


def _problem(prepared: Prepared) -> Problem:
    """The rows of the fitted evidences, columns of changes between periods kept free."""
    nuisance = [(change.evidence, change.mean_columns) for change in prepared.changes]
    return build_problem(prepared.evidences, prepared.torque, nuisance)


def _baseline(nominal: Residuals, probability: FloatArray, claims: Claims) -> Baseline:
    excess, deviation = nominal.excess_energy, nominal.excess_deviation
    detected = probability.min(axis=1) < 1e-4
    for finding in claims.findings:
        if finding.place.joint is not None:
            detected[finding.place.joint - 1] = True
    low, high = (np.sqrt(np.maximum(excess + sign * 1.96 * deviation, 0.0)) for sign in (-1.0, 1.0))
    return Baseline(nominal.rms_nm, nominal.noise_floor_nm, nominal.excess_nm, low, high, detected)


def _upright(recording: Recording, faults: Sequence[DataFault]) -> Recording:
    """The recording with the torque of joints turned whose sign a data fault says is inverted."""
    inverted = {joint - 1 for fault in faults if fault.fault == "inverted_torque_sign" for joint in fault.joints}
    if not inverted:
        return recording
    sign = np.array([-1.0 if joint in inverted else 1.0 for joint in range(recording.n)])
    return replace(recording, torque=recording.torque * sign)


def _stops_physics(faults: Sequence[DataFault]) -> bool:
    """Whether a fault makes every name worthless: with a wrong clock all inertial torque is wrong."""
    return any(fault.fault == "wrong_time_base" for fault in faults)


def _silent(phase: str, share: float) -> None:
    """Progress that nobody watches."""
