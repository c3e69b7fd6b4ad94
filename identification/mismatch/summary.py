"""The rest of a diagnosis: what could not be seen, how small an effect would have shown, parameter shift, words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from identification.arrays import BoolArray, FloatArray
from identification.mismatch.between_recordings import difference_sentence, held_out_misfits
from identification.mismatch.claims import Claims
from identification.mismatch.detectability import ORACLE_STRENGTH
from identification.mismatch.detectability import Candidate as Visible
from identification.mismatch.effects.base import Effect, Place
from identification.mismatch.evidence import Evidence, rows_of_each, rows_to_time
from identification.mismatch.figures import Curve, Spectrum, TimeSeries
from identification.mismatch.findings import (
    Baseline,
    DataFault,
    Detectable,
    Diagnosis,
    Finding,
    HeldOut,
    HeldOutMisfit,
    NotIdentifiable,
    ParameterShift,
    Verdict,
)
from identification.mismatch.heldout import Residuals
from identification.mismatch.names.localisation import best_curve
from identification.mismatch.nominal import Nominal
from identification.mismatch.prepared import Prepared
from identification.mismatch.problem import Problem, spread
from identification.mismatch.search.library import EffectRows
from identification.mismatch.search.search import SearchResult
from identification.mismatch.settings import ROUNDING, DiagnosisSettings
from identification.mismatch.unknown.claims import ClassClaim
from identification.recordings.independence import recording_names
from identification.signals.alike import notes_on_alike

MUCH = 3.0
"""Noise of another colour lies within; a model that leaves more may lack physics."""


def summarise(
    problem: Problem,
    result: SearchResult,
    inactive: Sequence[tuple[Effect, Place]],
    claims: Claims,
    classes: tuple[ClassClaim, ...],
    baseline: Baseline,
    left: BoolArray,
    fitted: Prepared,
    unseen: Prepared | None,
    faults: tuple[DataFault, ...],
    nominal: Nominal,
    rms_after_nm: FloatArray,
    settings: DiagnosisSettings,
) -> Diagnosis:
    """Everything a diagnosis says beside its findings. classes: what the torque of a joint depends on. left: (n,) where
    misfit shows beside the findings.
    """
    detectable, hidden = _visibility(problem, result.candidates, inactive, 2.0 * settings.complete_score)
    heldout = _held_out(claims, fitted, unseen, settings)
    unnamed = bool(claims.too_weak) or (heldout is not None and bool(heldout.misfits))
    much = much_is_left(claims.after.rms_nm, fitted.evidences)
    verdict = verdict_of(claims.findings, baseline, left.tolist(), unnamed, classes=classes, much=much)
    curves = _curves(fitted.evidences[0], claims.after, left)
    return Diagnosis(
        robot=nominal.regressor.robot.name,
        verdict=verdict,
        mode="complete" if claims.trial.complete and not claims.trial.nominal.unnamed else "background",
        baseline=baseline,
        findings=claims.findings,
        data_faults=faults,
        not_identifiable=hidden,
        minimum_detectable=detectable,
        heldout=heldout,
        parameter_shift=_shift(nominal, claims),
        remaining=_remaining(claims, classes, baseline, rms_after_nm, left, curves, faults, heldout),
        curves=curves,
        spectra=tuple(_spectra(fitted.evidences, claims.before, claims.after)),
        series=tuple(_series(fitted.evidences, claims.before, claims.after)),
        heldout_series=()
        if unseen is None or claims.heldout_before is None or claims.heldout_after is None
        else tuple(_series(unseen.evidences, claims.heldout_before, claims.heldout_after)),
        rms_after_nm=rms_after_nm,
        notes=_notes(fitted, unseen),
        classes=classes,
        too_weak=claims.too_weak,
        provenance={
            "library": len(result.library.effects),
            "candidates": len(result.candidates),
            "regressor": nominal.regressor.options.to_json(),
            "low_pass_hz": settings.low_pass_hz,
            "nominal_fit": nominal.digest,
        },
    )


def _visibility(
    problem: Problem, candidates: Sequence[EffectRows], inactive: Sequence[tuple[Effect, Place]], needed: float
) -> tuple[tuple[Detectable, ...], tuple[NotIdentifiable, ...]]:
    """Smallest size that shows of each effect at each place (in the middle of its grid), or why none does."""
    groups: dict[tuple[str, Place], list[EffectRows]] = {}
    for item in candidates:
        groups.setdefault((item.effect.name, item.place), []).append(item)
    detectable: list[Detectable] = []
    hidden = [NotIdentifiable(effect.name, place, "it exerts no torque in this motion") for effect, place in inactive]
    for (name, place), items in groups.items():
        item = items[len(items) // 2]
        columns = spread(problem, item.joints, item.rows)
        shadow = problem.basis.T @ columns
        plain = columns.T @ columns
        strength, energy = plain - shadow.T @ shadow, np.diag(plain).copy()
        visible = Visible(item.effect, place, dict(item.shape), strength, energy, np.zeros((0, 0)))
        if visible.absorbed_fraction > 1.0 - ROUNDING:
            hidden.append(NotIdentifiable(name, place, "the base parameters take up all of it in this motion"))
            continue
        size = visible.smallest(max(needed, ORACLE_STRENGTH))
        detectable.append(Detectable(name, place, size.value, size.unit, visible.absorbed_fraction))
    return tuple(detectable), tuple(hidden)


def _held_out(claims: Claims, fitted: Prepared, unseen: Prepared | None, settings: DiagnosisSettings) -> HeldOut | None:
    before, after = claims.heldout_before, claims.heldout_after
    if before is None or after is None or unseen is None:
        return None
    same = {item.recording.source.sha256 for item in fitted.evidences}
    misfits: tuple[HeldOutMisfit, ...] = ()
    if all(item.recording.source.sha256 not in same for item in unseen.evidences):
        # Parameters scatter by the noise that the fit weighed its rows with, without periods a tenth of what is left.
        weighed = replace(claims.after, sensor_noise=claims.extension.problem.noise)
        misfits = held_out_misfits(after, unseen.evidences, weighed, fitted.evidences, settings)
    square, deviation = after.rms_nm**2, after.excess_deviation
    interval = np.sqrt(np.maximum(np.column_stack([square - 1.96 * deviation, square + 1.96 * deviation]), 0.0))
    return HeldOut(
        before.rms_nm, after.rms_nm, interval, after.noise_floor_nm, before.excess_nm, after.excess_nm, misfits
    )


def _shift(nominal: Nominal, claims: Claims) -> tuple[ParameterShift, ...]:
    """From the fit to the parameters fitted with the findings; without findings there is nothing to shift."""
    after, std = nominal.values, nominal.std
    if claims.findings:
        after = claims.extension.base
        std = np.sqrt(np.maximum(np.diag(claims.extension.covariance), 0.0))
    return tuple(
        ParameterShift(name, float(nominal.values[index]), float(after[index]), float(std[index]), unit)
        for index, (name, unit) in enumerate(zip(nominal.regressor.names, nominal.regressor.units, strict=True))
    )


def _curves(evidence: Evidence, after: Residuals, left: BoolArray) -> tuple[Curve, ...]:
    size = evidence.frequency.size
    series = rows_to_time(evidence, after.rows[:, :size].T)
    curves = []
    for joint in np.flatnonzero(left):
        noise = float(np.sqrt((evidence.noise[:, joint] ** 2).sum() / evidence.samples))
        curves.append(best_curve(evidence, int(joint), series[:, joint], series[:, joint], noise)[0])
    return tuple(curves)


def _remaining(
    claims: Claims,
    classes: Sequence[ClassClaim],
    baseline: Baseline,
    rms_after_nm: FloatArray,
    left: BoolArray,
    curves: Sequence[Curve],
    faults: Sequence[DataFault],
    heldout: HeldOut | None,
) -> str:
    parts = [fault.sentence for fault in faults]
    misfits = () if heldout is None else heldout.misfits
    # What these joints' torque depends on is said, which is more than over what it is best drawn.
    unnamed = {item.joint for item in classes if not item.named}
    parts.extend(filter(None, (difference_sentence(misfits), *(item.sentence for item in misfits))))
    if not baseline.noise_is_measured:
        rms = ", ".join(f"{value:.2g}" for value in rms_after_nm)
        parts.append(f"The model leaves {rms} Nm RMS by joint; how much of it is noise was not measured.")
    elif not left.any() and (unnamed or claims.too_weak):
        pass
    elif not left.any() and misfits:
        parts.append("On the fitted recordings nothing above the noise remains.")
    elif not left.any():
        # The band in which it was asked: the noise of the fit's samples, beyond it too, may be three times as much.
        floor = float(np.max(claims.after.noise_floor_nm))
        parts.append(
            f"Nothing above the noise remains ({floor:.2g} Nm at most, per joint, over the compared band)."
            if claims.findings
            else f"No mismatch above {floor:.2g} Nm over the compared band; smaller effects than those listed as "
            "detectable would not show."
        )
    excess = claims.after.excess_nm
    for curve in curves:
        joint = curve.joint - 1
        if curve.joint not in unnamed and (baseline.noise_is_measured or baseline.detected[joint]):
            parts.append(
                f"Joint {curve.joint}: {excess[joint]:.2g} Nm RMS stay unexplained; a curve over {curve.coordinate} "
                "describes them best, which names no cause."
            )
    parts.extend(f"{sentence[:1].upper()}{sentence[1:]}." for sentence in claims.remarks)
    if claims.findings and heldout is None:
        parts.append("Names are unconfirmed: no held-out recording was given.")
    return " ".join(parts)


def _spectra(evidences: Sequence[Evidence], before: Residuals, after: Residuals) -> list[Spectrum]:
    found = []
    for evidence, own in zip(evidences, rows_of_each(evidences), strict=True):
        parts = [
            _per_line(values[:, own].T, evidence.frequency, evidence.samples)
            for values in (before.rows, after.rows, before.sensor_noise)
        ]
        found.append(Spectrum(np.unique(evidence.frequency), *parts))
    return found


def _per_line(rows: FloatArray, frequency: FloatArray, samples: int) -> FloatArray:
    """RMS per frequency from all rows at it: cosine and sine of a period, or the same line of several blocks."""
    index = np.unique(frequency, return_inverse=True)[1]
    square = np.stack([np.bincount(index, weights=column**2) for column in rows.T], axis=1)
    return np.asarray(np.sqrt(square / samples), dtype=np.float64)


def _series(evidences: Sequence[Evidence], before: Residuals, after: Residuals) -> list[TimeSeries]:
    found = []
    for evidence, own in zip(evidences, rows_of_each(evidences), strict=True):
        motion = evidence.motion
        series = [
            rows_to_time(evidence, rows) for rows in (evidence.torque, before.rows[:, own].T, after.rows[:, own].T)
        ]
        found.append(TimeSeries(motion.time, motion.position, motion.velocity, *series))
    return found


def _notes(fitted: Prepared, unseen: Prepared | None) -> tuple[str, ...]:
    evidences = [*fitted.evidences, *(() if unseen is None else unseen.evidences)]
    if all(evidence.noise_is_measured for evidence in evidences):
        return ()
    recordings = list({id(item.recording): item.recording for item in evidences}.values())
    alike = [
        f"{name}: {sentence}."
        for name, recording in zip(recording_names(recordings), recordings, strict=True)
        for sentence in notes_on_alike(recording)
    ]
    return (
        *alike,
        "A recording has no periods to compare, so its noise cannot be told from misfit. Rows are weighted by the "
        "level above the compared band, or by a tenth of what a plain fit leaves where that is more. Names rest on "
        "what they explain of rows that were not fitted. Where the robot can repeat a motion, record four periods "
        "or more.",
    )


def verdict_of(
    findings: Sequence[Finding],
    baseline: Baseline,
    left: Sequence[bool],
    unnamed: bool,
    *,
    classes: Sequence[ClassClaim] = (),
    much: bool,
) -> Verdict:
    """left: per joint whether misfit remains beside the findings; unnamed: whether it does on held-out recordings, or
    torque is there that is too weak for a name.

    classes: what the torque depends on; one of which the names leave something is a mismatch without a name.
    much: noise was not measured, and more is left than the level above the compared band would give (`much_is_left`);
    beside names that may be misfit too.
    """
    unnamed = unnamed or not all(item.named for item in classes)
    if findings:
        return "partly_explained" if any(left) or unnamed or much else "explained"
    if bool(np.any(baseline.detected)) or unnamed:
        return "unexplained"
    return "undecided" if much else "no_mismatch"


def much_is_left(rms_nm: FloatArray, evidences: Sequence[Evidence]) -> bool:
    """Whether a model leaves more (n,) Nm on some joint than three times the noise that the quietest octave above the
    compared band would give within it, where noise is not measured: it may be misfit, or noise of another colour.
    """
    floors = [item.noise if item.white_noise is None else item.white_noise for item in evidences]
    square = sum((floor**2).sum(axis=0) for floor in floors) / sum(item.samples for item in evidences)
    return not all(item.noise_is_measured for item in evidences) and bool(np.any(rms_nm > MUCH * np.sqrt(square)))
