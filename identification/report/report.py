"""The report's front door: results in, one HTML file out. Here: which sections there are, in which order, and the first
sentence. The sections are built in their own modules; called by the command line and the worker.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from identification.fitting.result import FitResult
from identification.fitting.rms import RmsTable
from identification.mismatch.findings import Diagnosis
from identification.recordings.recording import Recording
from identification.report.diagnosis_sections import diagnosis_sections, tone_of, verdict_sentence
from identification.report.document import Document, Section
from identification.report.model_sections import (
    feasibility_section,
    parameter_section,
    provenance_section,
    rms_section,
    undetermined,
)
from identification.report.motion_sections import excitation_section, residual_section
from identification.report.numbers import rounded
from identification.report.page import render
from identification.report.recording_section import recording_section
from identification.report.stretches import Stretch, stretches_of_diagnosis, stretches_of_fit

__all__ = ["build_document", "write_report"]

# Figures of more recordings than this fill pages without telling more.
MOST_DRAWN = 2


def write_report(
    path: Path,
    *,
    fit: FitResult | None = None,
    model: Mapping[str, Any] | None = None,
    diagnosis: Diagnosis | None = None,
    recordings: Sequence[Recording] = (),
    heldout: Sequence[Recording] = (),
    validation: RmsTable | None = None,
    title: str | None = None,
) -> None:
    """Write one self-contained HTML file with everything that is given; what is not given is left out.

    fit: adds excitation and residual figures. model: `model.json` as a mapping, of the fit by default. diagnosis: adds
    findings, first on the page. recordings: those that were fitted, of the fit by default; heldout: those that were
    not. validation: RMS lines on other recordings. The same arguments give the same bytes. Raises OSError where the
    file cannot be written.
    """
    document = build_document(
        fit=fit,
        model=model,
        diagnosis=diagnosis,
        recordings=recordings,
        heldout=heldout,
        validation=validation,
        title=title,
    )
    path.write_text(render(document), encoding="utf-8")


def build_document(
    *,
    fit: FitResult | None = None,
    model: Mapping[str, Any] | None = None,
    diagnosis: Diagnosis | None = None,
    recordings: Sequence[Recording] = (),
    heldout: Sequence[Recording] = (),
    validation: RmsTable | None = None,
    title: str | None = None,
) -> Document:
    """The report as value objects; arguments as in `write_report`."""
    if model is None and fit is not None:
        model = fit.to_model_json()
    if model is None and diagnosis is not None:
        model = diagnosis.extended_model_json()
    model = model if model is not None else {}
    recordings = recordings or (() if fit is None else fit.recordings)
    stretches, what = _stretches(fit, diagnosis, recordings)
    robot = None if fit is None else fit.robot
    answer = None if fit is None or fit.feasibility is None else fit.feasibility.sentence()
    sections: list[Section | None] = [] if diagnosis is None else [*diagnosis_sections(diagnosis)]
    sections += [recording_section(recordings, heldout), excitation_section(stretches, robot)]
    if model.get("base_parameters"):
        sections += [rms_section(model, validation), residual_section(stretches, what), parameter_section(model)]
        sections.append(feasibility_section(model, answer))
    provenances = [("Fit", model.get("provenance")), ("Diagnosis", None if diagnosis is None else diagnosis.provenance)]
    sections.append(provenance_section([(name, value) for name, value in provenances if value]))
    return Document(
        title=title or f"Identification of {model.get('robot', 'a robot')}",
        verdict=_fit_sentence(model) if diagnosis is None else verdict_sentence(diagnosis),
        sections=tuple(section for section in sections if section is not None),
        tone="neutral" if diagnosis is None else tone_of(diagnosis),
    )


def _stretches(
    fit: FitResult | None, diagnosis: Diagnosis | None, recordings: Sequence[Recording]
) -> tuple[tuple[Stretch, ...], str]:
    """What is drawn over time and frequency, and of which model its residual is."""
    if fit is not None:
        return stretches_of_fit(fit, MOST_DRAWN), "the base parameters and no further effect"
    if diagnosis is not None:
        names = tuple(Path(recording.source.path).name for recording in recordings)
        return stretches_of_diagnosis(diagnosis, names)[:MOST_DRAWN], "the findings added to the model"
    return (), ""


def _fit_sentence(model: Mapping[str, Any]) -> str:
    """What a reader should know first of a fit without a diagnosis."""
    items = model.get("base_parameters", ())
    if not items:
        return "This report holds no fitted model."
    left = [value for value in model.get("rms_nm", {}).get("fit", ()) if value is not None]
    known = len(items) - len(undetermined(model))
    torque = (
        f"The model meets the measured torque to {rounded(min(left), 2)} … {rounded(max(left), 2)} Nm RMS by joint; "
    )
    return f"{torque if left else ''}{known} of {len(items)} base parameters are told apart from zero."
