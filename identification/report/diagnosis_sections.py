"""What a diagnosis says, as sections: the verdict and every finding with its figures, the held-out check, how the base
parameters move, what these data could not show. Plain language first, numbers behind it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from identification.mismatch.between_recordings import one_a_line
from identification.mismatch.findings import Diagnosis, HeldOut
from identification.mismatch.set_up_answer import set_up_sentences, set_up_verdict
from identification.report.class_section import class_section
from identification.report.document import Block, Figure, Heading, Paragraph, Section, Table, Tone
from identification.report.finding_blocks import claim, curve_panel, effect_name, finding_blocks, place_name
from identification.report.numbers import joint_heads, listed, rounded, row_of, unit_of, with_sigma

_MANY = 6
_NOTABLE = 0.02


def verdict_sentence(diagnosis: Diagnosis) -> str:
    """The answer in one or two sentences."""
    names = listed([claim(finding) for finding in diagnosis.findings])
    against_model = diagnosis.model_comparison is not None
    begin = "".join(f"{sentence} " for sentence in set_up_sentences(diagnosis) if against_model)
    if diagnosis.data_faults:
        begin += f"The recording itself is faulty: {diagnosis.data_faults[0].sentence.rstrip('.')}. "
    detected = [str(joint + 1) for joint in np.flatnonzero(diagnosis.baseline.detected)]
    where = f" on {'joint' if len(detected) == 1 else 'joints'} {listed(detected)}" if detected else ""
    sentences = {
        "no_mismatch": "The model explains these recordings: no missing physics shows above the noise.",
        "explained": f"The model left something out, and it is found: {names}.",
        "partly_explained": f"Part of what the model leaves out is found: {names}. Another part stays unexplained.",
        "undecided": "What the model leaves is a great deal, and may be noise or missing physics: none is shown, "
        "and none is ruled out. A motion that is repeated would tell.",
        "unexplained": f"Measured and modelled torque differ by more than the noise{where}, and no effect that is "
        "known here explains it.",
    }
    if diagnosis.too_weak:
        sentences["unexplained"] = (
            f"Measured and modelled torque differ by more than the noise{where}. What fits this is too weak here for a "
            "name: other physics acts nearly the same."
        )
    if diagnosis.heldout is not None and any(item.differs for item in diagnosis.heldout.misfits):
        sentences["unexplained"] = "The model does not hold on the held-out recordings: something differs between them."
        if diagnosis.audit is not None and not against_model:
            sentences["unexplained"] += "".join(f" {item.sentence}" for item in diagnosis.audit.differences)
        sentences["partly_explained"] += " The held-out recordings disagree with the fitted ones."
        if diagnosis.audit is not None and not against_model:
            differs = " ".join(item.sentence for item in diagnosis.audit.differences)
            begun = sentences["explained"] if diagnosis.findings else "The model explains the fitted recordings."
            sentences["explained"] = f"{begun} The held-out recordings differ from them by what is named: {differs}"
    if diagnosis.unnamed:
        said = " What the torque depends on is said below, whatever its form."
        sentences["unexplained"] += said
        sentences["partly_explained"] += said
    if diagnosis.heldout is None and diagnosis.findings:
        for verdict in ("explained", "partly_explained"):
            sentences[verdict] += " No held-out recording has confirmed it."
    if not diagnosis.baseline.noise_is_measured:
        begin += "The noise was not measured (a recording needs two periods or more): "
        begin += "what of the misfit is noise cannot be told. "
        sentences["no_mismatch"] = "No missing physics is shown, and none is ruled out."
    return begin + (set_up_verdict(diagnosis) or sentences[diagnosis.verdict])


def tone_of(diagnosis: Diagnosis) -> Tone:
    """How the verdict is coloured: what is faulty or unexplained wants attention."""
    if diagnosis.every_fault or diagnosis.verdict in ("unexplained", "partly_explained"):
        return "attention"
    return "good" if diagnosis.verdict == "no_mismatch" and diagnosis.baseline.noise_is_measured else "neutral"


def diagnosis_sections(diagnosis: Diagnosis) -> list[Section]:
    """Findings, held-out check, parameter shift and limits of what these data can show, each where there is any."""
    sections = [
        _findings(diagnosis),
        class_section(diagnosis),
        _heldout(diagnosis),
        _shift(diagnosis),
        _limits(diagnosis),
    ]
    return [section for section in sections if section is not None]


def _findings(diagnosis: Diagnosis) -> Section:
    blocks: list[Block] = [Paragraph(f"{fault.sentence}", "warning") for fault in diagnosis.data_faults]
    if diagnosis.findings and diagnosis.heldout is None:
        blocks.append(Paragraph("No held-out recording was given: the names below are unconfirmed.", "warning"))
    for number, finding in enumerate(diagnosis.findings, 1):
        blocks += finding_blocks(number, finding, diagnosis)
    blocks.append(Heading("What remains"))
    blocks.extend(map(Paragraph, one_a_line(diagnosis.remaining)))
    # A class has a curve of its own, over what the torque depends on.
    drawn = {item.joint for item in diagnosis.unnamed if item.curve is not None}
    curves = [curve for curve in diagnosis.curves if curve.joint not in drawn]
    if curves:
        blocks.append(
            Figure(
                "What stays unexplained, as a curve over what describes it best (no cause is named)",
                tuple(curve_panel(curve, f"Joint {curve.joint}") for curve in curves),
                (("after", "residual, mean of each bin ± its noise"),),
            )
        )
    blocks.append(_baseline_table(diagnosis))
    blocks += [Paragraph(note, "note") for note in diagnosis.notes]
    return Section("findings", "What the model leaves out", tuple(blocks))


def _baseline_table(diagnosis: Diagnosis) -> Table:
    baseline = diagnosis.baseline
    rows = [
        ("nominal model", *row_of(baseline.rms_nm)),
        *([("with the findings", *row_of(diagnosis.rms_after_nm))] if diagnosis.findings else []),
        ("noise alone", *row_of(baseline.noise_floor_nm)),
        ("misfit beyond noise in the compared band, nominal", *row_of(baseline.excess_nm, 2)),
        ("… its 95 % interval", *_intervals(baseline.excess_low_nm, baseline.excess_high_nm)),
        ("misfit detected", *("yes" if value else "no" for value in baseline.detected)),
    ]
    if not baseline.noise_is_measured:
        rows = [row for row in rows if "noise" not in row[0] and "interval" not in row[0]]
    return Table(
        "Fitted recordings: RMS of measured minus modelled torque by joint, Nm",
        ("", *joint_heads(baseline.rms_nm.size)),
        tuple(rows),
    )


def _heldout(diagnosis: Diagnosis) -> Section | None:
    heldout = diagnosis.heldout
    if heldout is None:
        return None
    rows = [
        ("nominal model", *row_of(heldout.rms_before_nm)),
        ("with the findings", *row_of(heldout.rms_after_nm)),
        ("… its 95 % interval", *_intervals(*heldout.ci95_after_nm.T)),
        *([("extended model", *row_of(diagnosis.offer.heldout_rms))] if diagnosis.offer else []),
        ("noise alone", *row_of(heldout.noise_floor_nm)),
        ("misfit beyond noise, nominal", *row_of(heldout.excess_before_nm, 2)),
        ("misfit beyond noise, with the findings", *row_of(heldout.excess_after_nm, 2)),
    ]
    if not diagnosis.findings:
        rows = [row for row in rows if "with the findings" not in row[0]]
    measured = diagnosis.baseline.noise_is_measured
    if not measured:
        rows = [row for row in rows if "noise" not in row[0] and "interval" not in row[0]]
    return Section(
        "heldout",
        "Does it hold on another recording?",
        (
            Paragraph(_heldout_sentence(heldout, bool(diagnosis.findings), measured), "lead"),
            Paragraph("All parameters come from the fitted recordings only; this motion was not used.", "note"),
            Table(
                "Held-out recordings: RMS of measured minus modelled torque by joint, compared band, Nm",
                ("", *joint_heads(heldout.rms_before_nm.size)),
                tuple(rows),
            ),
        ),
    )


def _heldout_sentence(heldout: HeldOut, added: bool, measured: bool) -> str:
    """The joint whose torque changes most, in RMS beside the noise; added: whether the model has findings at all.

    measured: whether the noise is known; it stands in no sentence otherwise.
    """
    if not added and not measured:
        least, most = (
            rounded(float(value)) for value in (np.nanmin(heldout.rms_before_nm), np.nanmax(heldout.rms_before_nm))
        )
        return f"On a motion that was not fitted, the model leaves {least} to {most} Nm RMS, by joint."
    if not added:
        times = heldout.rms_before_nm / heldout.noise_floor_nm
        return (
            f"On a motion that was not fitted, the model leaves {rounded(float(np.nanmin(times)), 2)} to "
            f"{rounded(float(np.nanmax(times)), 2)} times what the noise alone would, by joint."
        )
    change = heldout.rms_before_nm - heldout.rms_after_nm
    joint = int(np.nanargmax(np.abs(change)))
    if measured and abs(change[joint]) < _NOTABLE * heldout.noise_floor_nm[joint]:
        return "The findings change the torque of a motion that was not fitted by less than 2 % of its noise."
    before, after, noise = (
        rounded(float(values[joint]))
        for values in (heldout.rms_before_nm, heldout.rms_after_nm, heldout.noise_floor_nm)
    )
    verb = "falls" if change[joint] > 0.0 else "RISES"
    beside = f"; the noise alone would give {noise} Nm" if measured else ""
    return f"On a motion that was not fitted, the RMS of joint {joint + 1} {verb} from {before} to {after} Nm{beside}."


def _shift(diagnosis: Diagnosis) -> Section | None:
    if not diagnosis.findings:
        return None
    moved = [
        (abs(item.after - item.before) / item.std if item.std > 0.0 else 0.0, item)
        for item in diagnosis.parameter_shift
    ]
    shown = sorted((pair for pair in moved if pair[0] >= 1.0), key=lambda pair: -pair[0])
    rows = []
    for steps, item in shown:
        after, sigma = with_sigma(item.after, item.std)
        rows.append(
            (item.name, with_sigma(item.before, item.std)[0], after, sigma, rounded(steps, 2), unit_of(item.unit))
        )
    quiet = len(moved) - len(shown)
    blocks: list[Block] = [
        Paragraph(
            "Before, the fit had hidden part of the missing physics in these base parameters. "
            f"{quiet} others move by less than one σ."
            if shown
            else "No base parameter moves by one σ or more."
        )
    ]
    if rows:
        head = ("parameter", "without", "with the findings", "σ", "shift in σ", "unit")
        blocks.append(Table("Base parameters that move", head, tuple(rows)))
    return Section("shift", "What that does to the parameters", tuple(blocks))


def _limits(diagnosis: Diagnosis) -> Section | None:
    """Smallest detectable sizes as effects by joint, and what no size would show, with the reasons."""
    blocks: list[Block] = []
    joints = diagnosis.baseline.rms_nm.size
    smallest: dict[tuple[str, str], dict[int | None, float]] = {}
    for item in diagnosis.minimum_detectable:
        cells = smallest.setdefault((item.effect, item.unit), {})
        joint = item.place.joint
        cells[joint] = min(cells.get(joint, math.inf), item.size)
    if smallest:
        places = (*range(1, joints + 1), None)
        rows = tuple(
            (effect_name(effect), unit_of(unit), *row_of((cells.get(place) for place in places), 2))
            for (effect, unit), cells in smallest.items()
        )
        blocks += [
            Paragraph(
                "An effect smaller than this would not have shown in this motion and this noise: that nothing was "
                "found says nothing about it."
            ),
            Table("Smallest size that would have shown", ("effect", "unit", *joint_heads(joints), "whole arm"), rows),
        ]
    reasons: dict[tuple[str, str], list[str]] = {}
    for hidden in diagnosis.not_identifiable:
        reasons.setdefault((hidden.effect, hidden.reason), []).append(place_name(hidden.place))
    if reasons:
        rows = tuple((effect_name(effect), _some(places), reason) for (effect, reason), places in reasons.items())
        blocks.append(Table("Not to be seen at any size in these data", ("effect", "where", "why"), rows, "words"))
    return Section("limits", "What these data could not show", tuple(blocks)) if blocks else None


def _some(places: Sequence[str]) -> str:
    """Places without repetition, the first of them where there are many."""
    unique = list(dict.fromkeys(places))
    return listed(unique) if len(unique) <= _MANY else f"{', '.join(unique[:_MANY])} and {len(unique) - _MANY} more"


def _intervals(low: Iterable[float], high: Iterable[float]) -> list[str]:
    return [f"{rounded(first, 2)} … {rounded(last, 2)}" for first, last in zip(low, high, strict=True)]
