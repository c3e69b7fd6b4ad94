"""The report's front door: results in, one HTML file out. Here: which sections there are, in which order, and the first
sentence. The sections are built in their own modules.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path, PurePath
from typing import Any, Concatenate, ParamSpec

from identification.fitting.result import FitResult
from identification.fitting.rms import RmsTable
from identification.mismatch.findings import Diagnosis
from identification.mismatch.set_up import SetUpCheck
from identification.recordings.recording import Recording
from identification.report.comparison_section import comparison_section
from identification.report.diagnosis_sections import diagnosis_sections, tone_of, verdict_sentence
from identification.report.document import Document, Section
from identification.report.fit_verdict import fit_verdict
from identification.report.model_sections import feasibility_section, parameter_section, provenance_section, rms_section
from identification.report.motion_sections import excitation_section, residual_section
from identification.report.page import render
from identification.report.recording_section import recording_section
from identification.report.set_up_section import set_up_section
from identification.report.stretches import Stretch, stretches_of_diagnosis, stretches_of_fit
from identification.report.units import in_units_of_joints
from identification.robots import RobotModel
from identification.robots.installation import ON_THE_FLOOR
from identification.whole_file import write_whole

_Results = ParamSpec("_Results")

# Figures of more recordings than this fill pages without telling more.
MOST_DRAWN = 2


def build_document(
    *,
    fit: FitResult | None = None,
    model: Mapping[str, Any] | None = None,
    diagnosis: Diagnosis | None = None,
    set_up: Sequence[SetUpCheck] = (),
    recordings: Sequence[Recording] = (),
    heldout: Sequence[Recording] = (),
    validation: RmsTable | None = None,
    robot: RobotModel | None = None,
    title: str | None = None,
    links: Sequence[tuple[str, str]] = (),
) -> Document:
    """The report as value objects, of everything that is given; what is not given is left out.

    fit: adds excitation and residual figures. model: `model.json` as a mapping, of the fit by default. diagnosis: adds
    findings, first on the page; set_up: how its recordings were made. recordings: those that were fitted, of the fit by
    default; heldout: those that were not. validation: RMS lines on other recordings. robot: for units and the path of
    its last link, of the fit by default. links: pages that belong to this one, as address relative to it and text.
    """
    if model is None and fit is not None:
        model = fit.to_model_json()
    if model is None and diagnosis is not None:
        model = diagnosis.extended_model_json()
    model = model if model is not None else {}
    recordings = recordings or (() if fit is None else fit.recordings)
    stretches, what = _stretches(fit, diagnosis, recordings)
    robot = robot if robot is not None or fit is None else fit.robot
    answer = None if fit is None or fit.feasibility is None else fit.feasibility.sentence()
    sections: list[Section | None] = []
    if diagnosis is not None:
        sections.append(set_up_section(diagnosis.audit, set_up, between=diagnosis.model_comparison is None))
        sections += [comparison_section(diagnosis.model_comparison), *diagnosis_sections(diagnosis)]
    stand = ON_THE_FLOOR if robot is None else robot.installation
    sections += [recording_section(recordings, heldout, stand), excitation_section(stretches, robot)]
    if model.get("base_parameters"):
        sections += [rms_section(model, validation), residual_section(stretches, what), parameter_section(model)]
        sections.append(feasibility_section(model, answer))
    sections.append(provenance_section(_provenances(model, diagnosis)))
    kind = "Fit" if diagnosis is None else "Diagnosis"
    verdict, tone = fit_verdict(model) if diagnosis is None else (verdict_sentence(diagnosis), tone_of(diagnosis))
    document = Document(
        title=title or f"{kind} of {PurePath(model.get('robot') or 'a robot').stem}",
        verdict=verdict,
        sections=tuple(section for section in sections if section is not None),
        tone=tone,
        links=tuple(links),
    )
    units = diagnosis.torque_units if diagnosis is not None else robot.units if robot is not None else ()
    return in_units_of_joints(document, units)


def _written(build: Callable[_Results, Document]) -> Callable[Concatenate[Path, _Results], None]:
    def write_report(path: Path, /, *results: _Results.args, **named: _Results.kwargs) -> None:
        """Write one self-contained HTML file; arguments as in `build_document`, the same ones give the same bytes.

        Raises OSError where the file cannot be written.
        """
        write_whole(path, render(build(*results, **named)))

    return write_report


write_report = _written(build_document)


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


def _provenances(model: Mapping[str, Any], diagnosis: Diagnosis | None) -> list[tuple[str, Mapping[str, Any]]]:
    """Of the fit and of the diagnosis; an extended model has the latter's."""
    of_diagnosis = {} if diagnosis is None else dict(diagnosis.provenance)
    of_model = model.get("provenance") or {}
    found = [("Fit", of_model)] if of_model and of_model != of_diagnosis else []
    return [*found, ("Diagnosis", of_diagnosis)] if of_diagnosis else found
