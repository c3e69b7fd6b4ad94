"""The entry point: recordings in, one `Diagnosis` out.

recordings → data faults → evidence → changes between periods → search over the mean → held-out check → findings. The
parts live in the modules beside this one; this one only joins them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

import numpy as np
from scipy.special import fdtrc

from identification.arrays import BoolArray, FloatArray
from identification.audit import Audit, audit
from identification.audit.between import model_of_fit
from identification.audit.reading import Reading, read_so
from identification.base_parameters import BaseRegressor
from identification.errors import EstimationError, RecordingError
from identification.fitting.result import FitResult
from identification.fitting.settings import Progress, Split, silent
from identification.mismatch.aperiodic_evidence import default_split
from identification.mismatch.baseline import ModelComparison, compare_elsewhere, compare_model, name_of
from identification.mismatch.claims import Claims
from identification.mismatch.data_faults.faults import stops_physics, upright
from identification.mismatch.effects.base import Effect, Place
from identification.mismatch.explained import Explained, concluded, explained_by_few
from identification.mismatch.extended_model import rms_with_findings
from identification.mismatch.findings import Baseline, DataFault, Diagnosis
from identification.mismatch.heldout import Residuals
from identification.mismatch.nominal import (
    Nominal,
    nominal_fit,
    nominal_of,
    residuals_of,
    settings_of_fit,
)
from identification.mismatch.prediction import given_by, left_to_parameters, rows_expected
from identification.mismatch.prepared import Prepared, prepare
from identification.mismatch.prismatic import in_units_of_joints
from identification.mismatch.problem import Problem
from identification.mismatch.search.extension import extend
from identification.mismatch.search.trial import Trial
from identification.mismatch.second_encoder import compare_encoders
from identification.mismatch.set_up import data_faults_of
from identification.mismatch.set_up_answer import settled, under_their_gravity, unseen_as_read, with_model
from identification.mismatch.settings import CAPTURE, DiagnosisSettings
from identification.mismatch.summary import summarise
from identification.mismatch.unknown.claims import ClassClaim
from identification.mismatch.unknown.judgement import Judgement, judge
from identification.mismatch.unknown.over_time import (
    Refused,
    changing,
    earned_over_time,
    least_of_drifts,
    still_refused,
)
from identification.mismatch.unknown.vibration import vibrating
from identification.model_file import Model
from identification.recordings.independence import in_one_order, recording_names, refuse_shared_samples
from identification.recordings.joint_choice import for_robot
from identification.recordings.recording import Recording
from identification.robots import RobotModel
from identification.robots.model import refuse_followers
from identification.signals.alike import one_of_alike


@dataclass(frozen=True, slots=True, eq=False)
class Examined:
    """The recordings once their data were looked at.

    fitted, unseen: put right where that could be done; of those held out only the ones that physics can be asked of.
    fit: of the fitted ones, None where there is none. faults: of all recordings. faults_stop_physics: those of the
    fitted ones do.
    """

    fitted: Sequence[Recording]
    unseen: Sequence[Recording]
    fit: FitResult | None
    faults: tuple[DataFault, ...]
    faults_stop_physics: bool


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
    be used or that is held out and fitted, ModelFileError or RobotError for such a model.
    """
    settings = settings if settings is not None else DiagnosisSettings()
    if not heldout:
        settings = replace(settings, provisional_score=settings.complete_score)
    report = progress if progress is not None else silent
    if not recordings:
        raise EstimationError("No recording was given to diagnose")
    refuse_followers(robot, "diagnose")
    recordings, heldout = (_asked_in_order(items, robot) for items in (recordings, heldout))
    refuse_shared_samples(recordings, heldout)
    split = _split_of(recordings, heldout, settings)
    report("the given model", 0.01)
    audited = None if model is None else _audited(recordings, robot, model)
    given, reading = recordings, None if audited is None else audited.reading
    recordings = read_so(reading, recordings, robot)
    stated, (robot, stand) = robot, under_their_gravity(robot, recordings, audited)
    report("nominal model", 0.02)
    rows = _examined(recordings, heldout, robot, settings, report, reading)
    settings = settings_of_fit(settings, rows.fit, heldout)
    regressor = BaseRegressor(robot) if rows.fit is None else rows.fit.regressor
    report("evidence", 0.1)

    def unseen_by(regressor: BaseRegressor, problem: Problem, trial: Trial) -> Prepared | None:
        """What was not fitted, its effects acting on the torque of a trial's base parameters."""
        others = rows.unseen if split is None else rows.fitted
        if not others:
            return None
        values = extend(problem, trial.members).base[: regressor.size]
        return prepare(others, robot, regressor, settings, split, values)

    fitted, refused = earned_over_time(prepare(rows.fitted, robot, regressor, settings, split))
    nominal = nominal_of(rows.fit, regressor, fitted.evidences)
    report("search", 0.3)
    explained = explained_by_few(regressor, fitted, settings)
    inactive = explained.library.candidates()[1]
    report("held-out check", 0.8)
    physics = not rows.faults_stop_physics and not (audited is not None and audited.makes_names_worthless)
    now, unseen, dependence, claims = concluded(
        explained, unseen_by, nominal, least_of_drifts(refused), settings, physics=physics
    )
    refused = still_refused(refused, [item for item in now.fitted.changes if item not in fitted.changes])
    claims = claims.with_too_weak((item.effect, item.joint) for item in refused if item.weak)
    report("findings", 0.9)
    plain = residuals_of(nominal, now.fitted.evidences, now.library)
    judgement = None
    if dependence is not None:
        judgement = judge(dependence, now.fitted, unseen, claims, now.problem, now.result.candidates)
    classes = _classes(judgement, refused, now.fitted, unseen, physics=physics)
    after = rms_with_findings(None if split else rows.fit, rows.fitted, claims, nominal, plain)
    diagnosis = _summarised(now, unseen, claims, classes, nominal, plain, after, inactive, rows.faults, settings)
    if model is not None:
        compared = _compared(model, stated, rows.fitted, now, claims, plain, settings, split)
        diagnosis = with_model(diagnosis, compared, model, given, audited, (robot, stand))
    diagnosis = replace(diagnosis, notes=(*diagnosis.notes, *nominal.notes, *(item.sentence for item in refused)))
    diagnosis = _with_classes(diagnosis, judgement)
    if audited is None:
        diagnosis = settled(replace(diagnosis, audit=_other_set_up(diagnosis, rows, robot)))
    encoders = compare_encoders(recordings, heldout)
    diagnosis = replace(diagnosis, encoders=encoders, notes=(*diagnosis.notes, *(item.sentence for item in encoders)))
    report("done", 1.0)
    return in_units_of_joints(diagnosis, robot)


def _asked_in_order(recordings: Sequence[Recording], robot: RobotModel) -> list[Recording]:
    """What is asked of these recordings, in an order that does not follow the one they were given in."""
    return [one_of_alike(for_robot(item, robot)) for item in in_one_order(recordings)]


def _examined(
    recordings: Sequence[Recording],
    heldout: Sequence[Recording],
    robot: RobotModel,
    settings: DiagnosisSettings,
    report: Progress,
    reading: Reading | None,
) -> Examined:
    """The recordings with the faults of their data found and, where that can be done, put right; fitted after that."""
    fit = nominal_fit(recordings, robot, settings)
    heldout = unseen_as_read(reading, heldout, robot, fit)
    report("data", 0.05)
    faults = data_faults_of([*recordings, *heldout], robot, BaseRegressor(robot) if fit is None else fit.regressor)
    turned = [upright(*pair) for pair in zip([*recordings, *heldout], faults, strict=True)]
    count = len(recordings)
    to_fit = turned[:count]
    to_check = [item for item, own in zip(turned[count:], faults[count:], strict=True) if not stops_physics(own)]
    if any(item is not given for item, given in zip(to_fit, recordings, strict=True)):
        fit = nominal_fit(to_fit, robot, settings)
    return Examined(to_fit, to_check, fit, tuple(chain(*faults)), any(map(stops_physics, faults[:count])))


def _split_of(
    recordings: Sequence[Recording], heldout: Sequence[Recording], settings: DiagnosisSettings
) -> Split | None:
    """Which rows are held out where neither other recordings are nor periods tell the noise."""
    if heldout or any(recording.repeats for recording in recordings):
        return None
    return default_split(recordings, settings) if settings.split is None else Split.parse(settings.split)


def _summarised(
    now: Explained,
    unseen: Prepared | None,
    claims: Claims,
    classes: tuple[ClassClaim, ...],
    nominal: Nominal,
    plain: Residuals,
    after: FloatArray,
    inactive: Sequence[tuple[Effect, Place]],
    faults: tuple[DataFault, ...],
    settings: DiagnosisSettings,
) -> Diagnosis:
    """All that is said beside the findings. plain: what the nominal model leaves.

    after: (n,) Nm, RMS with the findings. inactive: effects without torque.
    """
    measured = now.problem.noise_is_measured
    if measured:
        chances = [power.probability.min(axis=1) for power in (now.result.before.power, claims.power)]
    else:
        chances = [_found_by_chance(item, claims) for item in (claims.heldout_before, claims.heldout_after)]
    found, left = (chance < settings.consistency_probability for chance in chances)
    baseline = _baseline(nominal, plain, found, claims, classes, measured)
    return summarise(
        now.problem, now.result, inactive, claims, classes, baseline, left, now.fitted, unseen, faults, nominal, after,
        settings,
    )  # fmt: skip


def _classes(
    judgement: Judgement | None, refused: Sequence[Refused], fitted: Prepared, unseen: Prepared | None, *, physics: bool
) -> tuple[ClassClaim, ...]:
    """What the torque depends on: in the mean of the periods, over the recording, and what is in step with no period.

    physics: whether the data allow any.
    """
    evidences = [*fitted.evidences, *(() if unseen is None else unseen.evidences)]
    steady = () if judgement is None else (*judgement.claims, *changing(refused))
    return (*steady, *vibrating(evidences)) if physics else steady


def _with_classes(diagnosis: Diagnosis, judgement: Judgement | None) -> Diagnosis:
    """With the model of what the torque depends on, and what is offered of it; as it is where that was not asked."""
    if judgement is None:
        return diagnosis
    notes = (*diagnosis.notes, *judgement.notes)
    return replace(diagnosis, class_model=judgement.model, offer=judgement.offer, notes=notes)


def _compared(
    model: Model | Path,
    stated: RobotModel,
    recordings: Sequence[Recording],
    now: Explained,
    claims: Claims,
    plain: Residuals,
    settings: DiagnosisSettings,
    split: Split | None,
) -> ModelComparison:
    """What of the given model is wrong. stated: how its arm stands; that of the recordings may stand otherwise."""
    evidences, robot = now.fitted.evidences, now.regressor.robot
    if not np.array_equal(robot.gravity, stated.gravity):
        expected = rows_expected(model, recordings, stated, settings, split)
        return compare_elsewhere(name_of(model), expected, evidences, claims.extension, claims.after, plain.rms_nm)
    given = given_by(model, recordings, now.regressor, settings, split)
    return compare_model(*given, evidences, now.problem, claims.extension, claims.after, plain.rms_nm, now.regressor)


def _audited(recordings: Sequence[Recording], robot: RobotModel, model: Model | Path, called: str = "") -> Audit | None:
    """What in the set-up differs from the model; None where the recordings are too short to be asked."""
    try:
        return audit(left_to_parameters(model, recordings, robot), robot, model, called)
    except RecordingError:
        return None


def _other_set_up(diagnosis: Diagnosis, rows: Examined, robot: RobotModel) -> Audit | None:
    """What in the set-up of the held-out recordings differs from the fitted ones, where the two disagree.

    A joint of which a class is said has that torque on both: where the two disagree there, no cause is asked for.
    Nobody asked about the set-up, so a cause stands only where it is all that differs: torque that both recordings hold
    bends the parameters, and on another motion that looks in part like another link or another friction.
    """
    depends = {item.joint for item in diagnosis.classes}
    misfits = () if diagnosis.heldout is None else diagnosis.heldout.misfits
    disagree = any(item.differs and item.joint not in depends for item in misfits)
    if rows.fit is None or not rows.unseen or not disagree:
        return None
    name = " and ".join(recording_names([*rows.fitted, *rows.unseen])[: len(rows.fitted)])
    found = _audited(rows.unseen, robot, model_of_fit(rows.fit, name), name)
    taken = 0.0 if found is None else sum(item.explained for item in found.differences)
    return found if taken >= 1.0 - CAPTURE else None


def _found_by_chance(before: Residuals | None, claims: Claims) -> FloatArray:
    """(n,) chance that all that the search found leaves so much less than a model does on held-out rows; 1 without any.

    Where no noise is measured, a misfit is one that something predicts on rows that were not fitted, named or not.
    """
    after = claims.heldout_searched
    if before is None or after is None:
        return np.ones_like(claims.before.rms_nm)
    ratio = (before.rms_nm / np.maximum(after.rms_nm, 1e-300)) ** 2
    return np.asarray(fdtrc(before.freedom, after.freedom, ratio), dtype=np.float64)


def _baseline(
    nominal: Nominal, left: Residuals, found: BoolArray, claims: Claims, classes: Sequence[ClassClaim], measured: bool
) -> Baseline:
    """RMS and noise as the fit states them; the excess from the rows of the diagnosis, which the fit's are among.

    found: (n,) where misfit shows; the joint of a finding or of a class is one in any case.
    """
    excess, deviation = left.excess_energy, left.excess_deviation
    detected = found.copy()
    for joint in (*(item.place.joint for item in claims.findings), *(item.joint for item in classes)):
        if joint is not None:
            detected[joint - 1] = True
    low, high = (np.sqrt(np.maximum(excess + sign * 1.96 * deviation, 0.0)) for sign in (-1.0, 1.0))
    noise = np.where(np.isfinite(nominal.noise_floor_nm), nominal.noise_floor_nm, left.noise_floor_nm)
    return Baseline(nominal.rms_nm, noise, left.excess_nm, low, high, detected, measured)
