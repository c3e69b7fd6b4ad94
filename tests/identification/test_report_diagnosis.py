"""What a diagnosis becomes on the page: the verdict first, doubts beside every name, limits of what was seen."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from identification.audit.difference import Audit, Difference, Number
from identification.mismatch.baseline import LinkDeviation, ModelComparison, ParameterDeviation
from identification.mismatch.effects.base import Parameter, Place
from identification.mismatch.figures import Curve, Spectrum, TimeSeries
from identification.mismatch.findings import (
    Alternative,
    Baseline,
    DataFault,
    Detectable,
    Diagnosis,
    Finding,
    HeldOut,
    NotIdentifiable,
    ParameterShift,
)
from identification.mismatch.set_up import SetUpCheck
from identification.report import build_document, write_report
from identification.report.document import Facts, Figure, Paragraph, Section, Table
from identification.report.set_up_section import set_up_section

JOINTS = 3


def series() -> TimeSeries:
    time = np.arange(400) * 0.01
    wave = np.column_stack([np.sin(3 * time + joint) for joint in range(JOINTS)])
    return TimeSeries(time, wave, wave, wave, 0.2 * wave, 0.02 * wave)


def finding(**changes: Any) -> Finding:
    speed = np.linspace(-1.0, 1.0, 20)
    plain = Finding(
        effect="stribeck_friction",
        place=Place(joint=2),
        parameters=(Parameter("amplitude", 0.18123, 0.0042, "Nm"), Parameter("velocity", 0.0512, 0.0031, "rad/s")),
        coefficients=np.array([0.18]),
        covariance=np.array([[1.0]]),
        shape={},
        absorbed_fraction=0.4,
        score=312.0,
        significance=1e-30,
        sentence="Joint 2 has 0.18 Nm more friction near standstill.",
        where={"joints": [2], "bands_hz": [[0.1, 2.0]]},
        heldout_gain_nm=np.array([0.0, 0.031, 0.0]),
        confirmed=True,
        share_removed=0.93,
        curve=Curve(
            2, "velocity", "rad/s", speed, np.sign(speed), 0.1 * speed, np.full(20, 0.05), 0.9 * np.sign(speed)
        ),
    )
    return replace(plain, **changes)


def diagnosis(**changes: Any) -> Diagnosis:
    frequency = np.arange(1, 200) * 0.1
    rows = np.outer(1.0 / frequency, np.ones(JOINTS))
    plain = Diagnosis(
        robot="iiwa14",
        verdict="explained",
        mode="complete",
        baseline=Baseline(*(np.full(JOINTS, value) for value in (0.2, 0.1, 0.15, 0.14, 0.16)), np.arange(JOINTS) == 1),
        findings=(finding(),),
        data_faults=(),
        not_identifiable=(NotIdentifiable("payload", Place(link=3), "the base parameters take up all of it"),),
        minimum_detectable=(
            Detectable("torque_ripple", Place(joint=1), 0.012, "Nm", 0.0),
            Detectable("torque_ripple", Place(joint=3), 0.034, "Nm", 0.0),
            Detectable("base_tilt", Place(), 0.0011, "rad", 0.8),
        ),
        heldout=HeldOut(
            np.array([0.11, 0.21, 0.1]), np.array([0.11, 0.12, 0.1]), np.array([[0.1, 0.12]] * JOINTS),
            np.full(JOINTS, 0.1), np.full(JOINTS, 0.1), np.zeros(JOINTS),
        ),
        parameter_shift=(
            ParameterShift("FS_2", 0.31, 0.11, 0.01, "Nm"),
            ParameterShift("MY_3", 0.2, 0.2004, 0.01, "kg m"),
        ),
        remaining="Nothing above the noise remains.",
        spectra=(Spectrum(frequency, rows, 0.1 * rows, 0.1 * rows),),
        series=(series(),),
        heldout_series=(series(),),
        rms_after_nm=np.full(JOINTS, 0.1),
    )  # fmt: skip
    return replace(plain, **changes)


def sections_of(case: Diagnosis) -> dict[str, Section]:
    return {section.name: section for section in build_document(diagnosis=case).sections}


def texts(section: Section, kind: str) -> list[str]:
    return [block.text for block in section.blocks if isinstance(block, Paragraph) and block.kind == kind]


def table(section: Section, caption: str) -> dict[str, tuple[str, ...]]:
    found = next(block for block in section.blocks if isinstance(block, Table) and caption in block.caption)
    return {row[0]: row[1:] for row in found.rows}


@pytest.mark.parametrize(
    ("changes", "tone", "words"),
    [
        ({}, "neutral", ["is found", "stribeck friction (joint 2)"]),
        ({"heldout": None}, "neutral", ["is found", "No held-out recording has confirmed it."]),
        ({"verdict": "no_mismatch", "findings": ()}, "good", ["no missing physics"]),
        ({"verdict": "partly_explained"}, "attention", ["stribeck friction (joint 2)", "stays unexplained"]),
        ({"verdict": "unexplained", "findings": ()}, "attention", ["on joint 2", "no effect"]),
    ],
)
def test_first_sentence_is_the_verdict(changes: dict[str, Any], tone: str, words: list[str]) -> None:
    document = build_document(diagnosis=diagnosis(**changes))
    assert document.tone == tone
    assert all(word in document.verdict for word in words)
    assert document.sections[0].name == "findings"


def test_a_fault_of_the_data_comes_before_any_physics() -> None:
    fault = DataFault("inverted_torque_sign", (3,), "The torque of joint 3 has the opposite sign.")
    document = build_document(diagnosis=diagnosis(data_faults=(fault,)))
    assert document.verdict.startswith("The recording itself is faulty: The torque of joint 3")
    assert document.tone == "attention"


def test_a_finding_shows_its_size_its_figures_and_what_confirms_it() -> None:
    section = sections_of(diagnosis())["findings"]
    assert texts(section, "lead") == ["Joint 2 has 0.18 Nm more friction near standstill."]
    assert texts(section, "warning") == []
    assert table(section, "Size") == {
        "amplitude": ("0.1812", "0.0042", "Nm"),
        "velocity": ("0.0512", "0.0031", "rad/s"),
    }
    figure = next(block for block in section.blocks if isinstance(block, Figure))
    assert [len(panel.lines) for panel in figure.panels] == [3, 3, 2]
    facts = dict(next(block for block in section.blocks if isinstance(block, Facts)).entries)
    assert facts["Confirmed on held-out data"] == "yes"
    assert facts["Held-out RMS"] == "falls by 0.031 Nm on joint 2"
    assert facts["At frequencies"] == "0.1 … 2 Hz"
    assert facts["Explains"] == "93 % of the misfit's energy on its joints"


def test_a_name_that_could_be_another_says_so_and_which_experiment_decides() -> None:
    doubtful = finding(
        alternatives=(Alternative("presliding_hysteresis", 2), Alternative("base_tilt", None)),
        separating_experiment="Run the path at two speeds.",
        confirmed=False,
    )
    warnings = texts(sections_of(diagnosis(findings=(doubtful,)))["findings"], "warning")
    assert warnings[0] == "The held-out recording does not support it."
    assert "presliding hysteresis (joint 2) and base tilt (the whole arm)" in warnings[1]
    assert warnings[1].endswith("To tell them apart: Run the path at two speeds.")


def test_a_name_that_held_out_data_do_not_support_is_doubted_in_the_first_sentence() -> None:
    verdict = build_document(diagnosis=diagnosis(findings=(finding(confirmed=False),))).verdict
    assert "stribeck friction (joint 2, not supported by the held-out recording)" in verdict


def test_an_effect_that_the_parameters_swallow_is_not_drawn_over_a_residual_it_dwarfs() -> None:
    plain = finding().curve
    assert plain is not None
    assert plain.fitted is not None
    swallowed = finding(curve=replace(plain, fitted=100.0 * plain.fitted))
    figure = next(
        block for block in sections_of(diagnosis(findings=(swallowed,)))["findings"].blocks if isinstance(block, Figure)
    )
    assert [line.style for line in figure.panels[0].lines] == ["before", "after"]
    assert "fitted" not in dict(figure.legend)


def test_without_a_held_out_recording_names_are_called_unconfirmed() -> None:
    found = sections_of(diagnosis(heldout=None, heldout_series=(), findings=(finding(confirmed=None),)))
    assert "heldout" not in found
    assert any("unconfirmed" in text for text in texts(found["findings"], "warning"))


@pytest.mark.parametrize(
    ("after", "words"),
    [(0.12, "joint 2 falls from 0.210 to 0.120 Nm"), (0.3, "joint 2 RISES"), (0.2101, "by less than 2 % of its noise")],
)
def test_held_out_sentence_says_what_changed_even_if_it_is_worse(after: float, words: str) -> None:
    plain = diagnosis().heldout
    assert plain is not None
    changed = replace(plain, rms_after_nm=np.array([0.11, after, 0.1]))
    assert words in texts(sections_of(diagnosis(heldout=changed))["heldout"], "lead")[0]


def test_without_findings_nothing_is_said_about_them() -> None:
    found = sections_of(diagnosis(findings=(), verdict="no_mismatch"))
    assert "shift" not in found
    # 0.1 and 0.21 Nm beside 0.1 Nm of noise.
    assert "1.0 to 2.1 times" in texts(found["heldout"], "lead")[0]
    assert not [row for row in table(found["heldout"], "Held-out") if "findings" in row]


@pytest.mark.parametrize("found", [(finding(),), ()])
def test_noise_that_was_not_measured_stands_in_no_figure_and_no_table(found: tuple[Finding, ...]) -> None:
    """Without periods the floor is a weight: a tenth of the misfit, and no one's noise."""
    case = diagnosis(findings=found, verdict="unexplained")
    sections = sections_of(replace(case, baseline=replace(case.baseline, noise_is_measured=False)))
    assert "noise" not in texts(sections["heldout"], "lead")[0]
    assert not [row for row in table(sections["heldout"], "Held-out") if "noise" in row]
    figures = [block for section in sections.values() for block in section.blocks if isinstance(block, Figure)]
    assert figures
    assert not [text for figure in figures for style, text in figure.legend if style in ("noise", "floor")]
    floors = [panel.floor for figure in figures for panel in figure.panels if panel.floor is not None]
    assert not np.isfinite(floors).any()


def test_only_parameters_that_move_are_listed_and_the_others_counted() -> None:
    section = sections_of(diagnosis())["shift"]
    assert table(section, "move") == {"FS_2": ("0.310", "0.110", "0.010", "20", "Nm")}
    assert "1 others move by less than one σ" in texts(section, "plain")[0]


def test_limits_are_a_table_of_effects_by_joint() -> None:
    section = sections_of(diagnosis())["limits"]
    smallest = table(section, "Smallest")
    assert smallest["torque ripple"] == ("Nm", "0.012", "–", "0.034", "–")
    assert smallest["base tilt"] == ("rad", "–", "–", "–", "0.0011")
    assert table(section, "Not to be seen") == {"payload": ("link 3", "the base parameters take up all of it")}


def test_a_change_between_periods_and_an_effect_of_the_whole_arm_have_a_page_too(tmp_path: Path) -> None:
    sizes = Curve(1, "period", "", np.arange(1.0, 5.0), np.ones(4), np.zeros(4), np.zeros(4), np.ones(4))
    drift = finding(effect="torque_sensor_drift", place=Place(joint=1), curve=sizes, where={"periods": [2, 3]})
    tilt = finding(
        effect="base_tilt", place=Place(), curve=None, heldout_gain_nm=np.zeros(0), share_removed=float("nan")
    )
    write_report(tmp_path / "report.html", diagnosis=diagnosis(findings=(drift, tilt), verdict="partly_explained"))
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "torque sensor drift" in page
    assert "base tilt" in page
    assert ">nan" not in page


def test_a_given_model_is_judged_first_link_by_link() -> None:
    parts = [np.full(JOINTS, value) for value in (3.0, 2.9, 0.2, 0.1)]
    off = ParameterDeviation("MY_2", 2, 1.0, 1.4, 0.01, "kg m", 2.9)
    fine = ParameterDeviation("MX_3", 3, 0.1, 0.101, 0.01, "kg m", 0.01)
    links = (LinkDeviation(2, 0.0, 2.9), LinkDeviation(3, 0.6, 0.01))
    comparison = ModelComparison("cell.urdf", *parts, (off, fine), links)
    found = sections_of(diagnosis(model_comparison=comparison))
    assert next(iter(found)) == "comparison"
    assert table(found["comparison"], "refute") == {"MY_2": ("2", "1.000", "1.400", "0.010", "−40", "kg m")}
    assert table(found["comparison"], "links")["3"] == ("right within σ", "0.0100", "0.60")
    assert table(found["comparison"], "RMS")["left with its parameters put right"] == ("0.200", "0.200", "0.200")
    assert [item["wrong"] for item in comparison.to_json()["links"]] == [True, False]
    # What is named in the set-up moves links and parameters: nobody calls any wrong then.
    settled = replace(comparison, set_up="A load of 2 kg.")
    for key in ("links", "parameters"):
        assert {item["wrong"] for item in settled.to_json()[key]} == {None}
    found = sections_of(diagnosis(model_comparison=settled))
    captions = [block.caption for block in found["comparison"].blocks if isinstance(block, Table)]
    assert captions == ["RMS of measured minus modelled torque by joint, Nm"]


def test_the_page_has_the_set_up_with_each_difference_and_verdict() -> None:
    mass = Number("mass", 2.804, 0.056, "kg")
    load = Difference("payload", None, 6, (mass,), 0.97, 90.0, "model", "A load of 2.80 ± 0.11 kg on the flange.")
    audit = Audit("old.json", "named", (load,), (5.0,), (0.3,), "A load of 2.80 ± 0.11 kg on the flange.")
    checks = (SetUpCheck("gravity", "ok", "As stated."), SetUpCheck("clock", "failed", "The clock is 2 % slow."))
    section = set_up_section(audit, checks)
    assert section is not None
    lead, differences, verdicts = section.blocks
    assert isinstance(lead, Paragraph)
    assert lead.text == audit.sentence
    assert isinstance(differences, Table)
    assert differences.rows == (("payload", "link 6", "2.80", "0.11", "kg", "97 %", "model"),)
    assert isinstance(verdicts, Table)
    assert [row[:2] for row in verdicts.rows] == [("gravity", "as stated"), ("clock", "not as stated")]
    # Numbers stand in one line, at the right: sentences so were outside a narrow window, and of a printed page.
    assert verdicts.kind == "words"
    assert set_up_section(None, ()) is None
    # Held-out recordings against the fitted ones: "these" would be the wrong ones.
    between = sections_of(diagnosis(audit=audit))["set-up"]
    captions = [block.caption for block in between.blocks if isinstance(block, Table)]
    assert captions == ["What differs between old.json and the held-out recordings"]


def test_what_remains_is_said_joint_by_joint() -> None:
    remaining = "Something differs. Joint 2: 20.4 Nm RMS stay. Joint 4: 1.2 Nm RMS stay, 0.1 Nm before. On the fitted "
    found = sections_of(diagnosis(remaining=remaining + "recordings nothing remains."))["findings"]
    said = [block.text for block in found.blocks if isinstance(block, Paragraph)]
    assert said[-4:] == [
        "Something differs.", "Joint 2: 20.4 Nm RMS stay.", "Joint 4: 1.2 Nm RMS stay, 0.1 Nm before.",
        "On the fitted recordings nothing remains.",
    ]  # fmt: skip


def test_torques_and_velocities_under_other_joints_are_both_faults_of_the_data() -> None:
    torques = Difference("wrong_joint_order", None, None, (), 0.99, 50.0, "recording", "Torques 1 and 2.", (), (1, 2))
    velocities = DataFault("wrong_joint_order", (3,), "a.npz: joint 3: the recorded velocity is another's.")
    given = Audit("arm.json", "named", (torques,), (1.0,) * JOINTS, (0.1,) * JOINTS, "One difference.")
    faults = diagnosis(data_faults=(velocities,), audit=given).to_json()["data_faults"]
    assert [fault["joints"] for fault in faults] == [[3], [1, 2]]
