"""What is known after some recordings, and what is open: the diagnosis, the hypotheses alive, and the answer so far.

The diagnosis alone gives names; the hypotheses say what could still take a name's place, and what weak effect may be
there that no name stands out for. Here: both of the same recordings, and the questions they leave. Not here: the next
motion (`choice`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.arrays import FloatArray
from identification.base_parameters import BaseRegressor, Widths
from identification.errors import RecordingError
from identification.investigation.actions import (
    Action,
    Outcome,
    added_mass,
    differences,
    levelled,
    turned_tool,
    warmed_up,
)
from identification.investigation.added_mass import AddedMass, less_torque, without_added_mass
from identification.investigation.assessment import assess
from identification.investigation.choice import Chooser
from identification.investigation.columns import Form, scaled_inverse
from identification.investigation.day_terms import DayTerm, day_terms
from identification.investigation.hypotheses import Assessment, describe
from identification.investigation.separation import agreement
from identification.mismatch.data_faults.faults import all_upright, stops_physics
from identification.mismatch.diagnosis import diagnose
from identification.mismatch.effects import effect_named
from identification.mismatch.effects.base import Place
from identification.mismatch.evidence import Evidence, fit_parameters, with_parameters
from identification.mismatch.findings import Diagnosis, Finding
from identification.mismatch.reduction import build_evidence
from identification.mismatch.settings import DiagnosisSettings
from identification.recordings.recording import Recording
from identification.robots import RobotModel
from identification.signals.alike import one_of_alike

Progress = Callable[[str, float], None]

CERTAIN = 0.8
"""Probability from which on "nothing more" is taken for the answer: a motion more is asked for below it."""


@dataclass(frozen=True, slots=True)
class Question:
    """One thing that is open, in words, and how it is answered where motion alone will not do."""

    sentence: str


@dataclass(frozen=True, slots=True, eq=False)
class Study:
    """diagnosis: of all recordings together. assessment: hypotheses on what is not settled. questions: what is open.

    agreements: of each settled finding and of the leading hypothesis, the chance that its coefficients differ between
    the recordings by so much if they are one. day_terms: what changed from the first recording to others, and was taken
    out of them before all else.
    """

    diagnosis: Diagnosis
    assessment: Assessment
    chooser: Chooser
    questions: tuple[Question, ...]
    agreements: tuple[tuple[str, float], ...] = ()
    day_terms: tuple[DayTerm, ...] = ()

    @property
    def settled(self) -> bool:
        """Whether nothing is open."""
        return not self.questions

    @property
    def answer(self) -> str:
        """What is known, in one sentence."""
        said = [item.sentence for item in self.diagnosis.findings]
        said += [item.sentence for item in self.diagnosis.unnamed]
        if said:
            return " ".join(said)
        if self.diagnosis.verdict == "no_mismatch":
            return "No effect of the library stands out from the nominal model and its noise."
        return "More is left than noise explains, and no effect of the library stands out from it."


def study(
    recordings: Sequence[Recording],
    robot: RobotModel,
    *,
    heldout: Sequence[Recording] = (),
    masses: Sequence[AddedMass | None] = (),
    mass_now: AddedMass | None = None,
    settings: DiagnosisSettings | None = None,
    progress: Progress | None = None,
) -> Study:
    """Diagnose recordings with periods and weigh every hypothesis on all of them, held-out ones too.

    masses: known mass that was on the flange of each recording, then of each held-out one; empty: none on any.
    mass_now: on the flange when the next motion is driven.
    Raises RecordingError for a recording without periods (its noise is not known, so that nothing can be foretold) or
    with a fault that makes every name worthless, and the errors of `diagnose`.
    """
    refuse_without_periods((*recordings, *heldout))
    settings = settings or DiagnosisSettings()
    on_flange = [*masses, *[None] * (len(recordings) + len(heldout) - len(masses))]
    cleared = [
        item if mass is None else without_added_mass(item, robot, mass)
        for item, mass in zip((*recordings, *heldout), on_flange, strict=True)
    ]
    count = len(recordings)
    found = _study_of(cleared, count, on_flange, robot, mass_now, settings, progress)
    bare = found.assessment.evidences
    leader = found.assessment.leader
    forms = () if leader.best is None else (leader.best,)
    terms = day_terms(bare, forms, found.assessment.discrepancies, leader.beside)
    if not terms:
        return found
    speed = bare[0].motion.coulomb_velocity
    faults = found.diagnosis.data_faults
    turned = [_without(item, number, terms, speed) for number, item in enumerate(all_upright(cleared, faults))]
    cleared = all_upright(turned, faults)  # as they were recorded again
    found = _study_of(cleared, count, on_flange, robot, mass_now, settings, progress)
    return replace(found, day_terms=terms)


def refuse_without_periods(recordings: Iterable[Recording]) -> None:
    """Raise RecordingError for one whose noise is not known, so that nothing can be foretold."""
    for item in recordings:
        if not one_of_alike(item).repeats:
            raise RecordingError(
                f"{item.source.path} has no periods, or such as are alike to rounding, so that its noise is not known; "
                "record a periodic motion, four periods or more",
                file=item.source.path,
            )


def _without(recording: Recording, number: int, terms: Sequence[DayTerm], coulomb_velocity: Widths) -> Recording:
    """The recording as it would be had nothing changed since the first one."""
    own = [term for term in terms if term.recording == number]
    if not own:
        return recording

    def along(position: FloatArray, velocity: FloatArray, acceleration: FloatArray) -> FloatArray:
        del acceleration
        torque = np.zeros_like(position)
        for term in own:
            torque[:, term.joint] += term.torque(velocity, coulomb_velocity)
        return torque

    return less_torque(recording, along)


def _study_of(
    cleared: Sequence[Recording],
    count: int,
    on_flange: Sequence[AddedMass | None],
    robot: RobotModel,
    mass_now: AddedMass | None,
    settings: DiagnosisSettings,
    progress: Progress | None,
) -> Study:
    """The study of recordings of which nothing has to be taken out any more, the first `count` of them fitted."""
    recordings, heldout = cleared[:count], cleared[count:]
    diagnosis = diagnose(recordings, robot, heldout=heldout, settings=settings, progress=progress)
    if stops_physics(diagnosis.data_faults):
        raise RecordingError(diagnosis.data_faults[0].sentence, file=diagnosis.data_faults[0].recording)
    regressor, values, evidences = weighed_rows(diagnosis, cleared, on_flange, robot, settings)
    settled = [item for item in diagnosis.findings if _is_settled(item)]
    known = [
        Form.of(item.effect, item.place, item.shape)
        for item in settled
        if effect_named(item.effect).stage == "repeatable"
    ]
    assessment = assess(evidences, known, _asked(diagnosis))
    chooser = Chooser.of(assessment, evidences, regressor, values, known, mass_now)
    leading = () if assessment.leader.best is None else (assessment.leader.best,)
    # With the noise of the assessment, but no settled finding among their nominal columns.
    bare = [replace(own, noise=item.noise) for own, item in zip(evidences, assessment.evidences, strict=True)]
    beside, variances = assessment.discrepancies, assessment.leader.beside
    agreements = tuple(
        (describe(form.effect, form.place), agreement(bare, form, beside, variances)) for form in (*known, *leading)
    )
    return Study(diagnosis, assessment, chooser, questions_of(diagnosis, assessment), agreements)


def weighed_rows(
    diagnosis: Diagnosis,
    recordings: Sequence[Recording],
    on_flange: Sequence[AddedMass | None],
    robot: RobotModel,
    settings: DiagnosisSettings,
) -> tuple[BaseRegressor, FloatArray, list[Evidence]]:
    """The nominal model of a diagnosis, its parameters (p,) on all recordings together, and these beside it.

    With another model than the one that names are judged beside, some would be foretold and never given.
    """
    regressor = diagnosis.nominal_model(robot)
    settings = replace(settings, low_pass_hz=diagnosis.provenance["low_pass_hz"])
    turned = all_upright(recordings, diagnosis.data_faults)
    parts = [(part, mass) for item, mass in zip(turned, on_flange, strict=True)
             for part in build_evidence(item, regressor.robot, regressor, settings)]  # fmt: skip
    values = fit_parameters([part for part, _ in parts])
    return regressor, values, [_loaded(with_parameters(part, regressor, values), mass) for part, mass in parts]


def what_it_told(
    action: Action,
    before: Recording,
    after: Sequence[Recording],
    found: Study,
    robot: RobotModel,
    mass: AddedMass | None = None,
) -> tuple[Outcome, ...]:
    """What an action told by one motion, recorded before it and once or more after it, the last one after all of it.

    mass: the known one, on the flange in the last. Raises RecordingError where the motions are not one.
    """
    regressor, values = found.chooser.regressor, found.chooser.values
    found_after = differences(*(build_evidence(item, robot, regressor)[0] for item in (before, *after)))
    difference = found_after[-1]
    if action is Action.ADD_MASS:
        return () if mass is None else (added_mass(difference, mass),)
    if action is Action.TURN_TOOL:
        return (turned_tool(difference),)
    if action is Action.LEVEL_BASE:
        return (levelled(difference),)
    told = []
    for finding in found.diagnosis.findings:
        if finding.effect == "torque_offset" and finding.place.joint is not None:
            joint = finding.place.joint - 1
            size = float(finding.coefficients[0]), math.sqrt(float(finding.covariance[0, 0]))
            told.append(warmed_up(found_after, joint, size, _coulomb(found, regressor, values, joint)))
    return tuple(told)


def _coulomb(found: Study, regressor: BaseRegressor, values: FloatArray, joint: int) -> tuple[float, float]:
    """Coulomb friction of a joint (from 0) and its deviation, Nm."""
    sums = found.chooser.recorded
    column = regressor.position_of(f"FS_{joint + 1}")
    covariance = scaled_inverse(sums.gram[: sums.base, : sums.base])
    return float(values[column]), math.sqrt(float(covariance[column, column]))


def _loaded(evidence: Evidence, mass: AddedMass | None) -> Evidence:
    """The evidence whose effects see the torque of an added mass too; its own torque has none of it."""
    return evidence if mass is None else replace(evidence, motion=mass.carried(evidence.motion))


def questions_of(diagnosis: Diagnosis, assessment: Assessment) -> tuple[Question, ...]:
    """What a diagnosis and the hypotheses on the same recordings leave open."""
    found = []
    for finding in diagnosis.findings:
        name = describe(finding.effect, finding.place)
        if finding.alternatives:
            others = " or ".join(
                describe(item.effect, finding.place if item.joint == finding.place.joint else Place(item.joint))
                for item in finding.alternatives
            )
            found.append(Question(f"{name.capitalize()}, or {others}?"))
        elif finding.confirmed is not True:
            found.append(Question(f"{name.capitalize()}: is it there on another motion too?"))
    named = {(item.effect, item.place.joint) for item in diagnosis.findings}
    leader = assessment.leader
    if leader.effect is not None and (leader.effect, leader.place.joint) not in named:
        rivals = [item.name for item in assessment.alive[1:3] if item.probability > 0.01]
        others = "".join(f", or {name}" for name in rivals)
        found.append(Question(f"{leader.name.capitalize()}{others}? Nothing has a name yet."))
    elif leader.effect is None and assessment.certain < CERTAIN:
        rival = assessment.alive[1]
        found.append(
            Question(f"Is there {rival.name}, at {100 * rival.probability:.0f} % probability, or {leader.name}?")
        )
    settled = {item.place.joint for item in diagnosis.findings}
    near = [item for item in assessment.alive if item.effect is not None and item.place.joint not in settled]
    for claim in diagnosis.unnamed:
        forms = [item.name for item in near if item.place.joint == claim.joint]
        if not found and forms and claim.joint not in settled:
            found.append(Question(f"{forms[0].capitalize()}, or a torque of joint {claim.joint} without such a form?"))
    if not found and diagnosis.verdict in ("partly_explained", "unexplained", "undecided"):
        found.append(Question("What is it that is left? It has no name."))
    return tuple(found)


def _is_settled(finding: Finding) -> bool:
    return finding.confirmed is True and not finding.alternatives


def _asked(diagnosis: Diagnosis) -> set[tuple[str, int | None]]:
    """Effects with their joints that stay alive: claimed but open, alternatives, too weak, nearest forms of classes."""
    asked: set[tuple[str, int | None]] = {(item.effect, item.joint) for item in diagnosis.too_weak}
    for finding in diagnosis.findings:
        if not _is_settled(finding):
            asked.add((finding.effect, finding.place.joint))
            asked.update((item.effect, item.joint) for item in finding.alternatives)
    settled = {item.place.joint for item in diagnosis.findings if _is_settled(item)}
    for claim in diagnosis.classes:
        if claim.joint not in settled:
            asked.update((form.effect, claim.joint) for form in claim.nearest_forms)
    return asked
