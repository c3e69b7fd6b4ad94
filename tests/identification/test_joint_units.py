"""Claims about words: what is said of a prismatic joint is in N, m, N s/m and kg.

Truth: one axis with known mass and friction, whose missing friction a diagnosis names.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from daemon.cli.diagnosis import finding_lines
from daemon.cli.payload import lines_of
from identification.audit.audit import audit
from identification.audit.payload import weigh
from identification.interface import Answer
from identification.mismatch.diagnosis import diagnose
from identification.model_file import read_model, write_model
from identification.recording_fit import FitSettings, fit_recordings
from identification.recordings.reader import Inputs
from identification.report import build_document
from identification.report.document import Document, Facts, Figure, Heading, Line, Panel, Paragraph, Section, Table
from identification.report.units import in_units_of_joints
from identification.robots import load_robot
from identification.robots.joint_units import for_prismatic, in_units
from tests.identification.synthetic import fourier_motion, recording_of

AXIS = """<robot name="axis"><link name="base"/><link name="carriage"/>
<joint name="x" type="prismatic"><parent link="base"/><child link="carriage"/><axis xyz="1 0 0"/>
 <limit lower="-1" upper="1" velocity="2" effort="400"/></joint></robot>"""
REVOLUTE_WORDS = re.compile(r"\b[mk]?Nm\b|\bm?rad\b|torque\b")


def texts_of(section: Section) -> Iterator[str]:
    """What a reader of the page reads; not names of settings, nor of files."""
    for block in section.blocks if section.name not in ("provenance", "recordings") else ():
        if isinstance(block, Paragraph | Heading):
            yield block.text
        elif isinstance(block, Facts):
            yield from (text for entry in block.entries for text in entry)
        elif isinstance(block, Table):
            yield from (block.caption, *block.head, *(cell for row in block.rows for cell in row[1:]))
        else:
            yield block.caption
            for panel in block.panels:
                yield from (panel.title, panel.x_label, panel.y_label, panel.description)


@pytest.mark.parametrize(
    ("revolute", "prismatic"),
    [
        ("Nm", "N"), ("mNm", "mN"), ("Nm s/rad", "N s/m"), ("Nm/rad", "N/m"),
        ("rad/Nm", "m/N"), ("rad/s", "m/s"), ("mrad", "mm"), ("1/rad²", "1/m²"),
        ("Nm/h", "N/h"), ("kg", "kg"), ("radius", "radius"),
        ("0.3 Nm at 1 rad/s", "0.3 N at 1 m/s"),
        ("kg m²", "kg"), ("kg m^2", "kg"),
        ("a torque_offset, a torque sensor", "a torque_offset, a force sensor"),
    ],
)  # fmt: skip
def test_units_become_those_of_a_prismatic_joint(revolute: str, prismatic: str) -> None:
    assert for_prismatic(revolute) == prismatic


UNITS = ("N", "Nm", "N")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("Joint 1: 2 Nm of torque. Joint 2: 3 Nm of torque.", "Joint 1: 2 N of force. Joint 2: 3 Nm of torque."),
        ("RMS of joint 3: 4 mNm", "RMS of joint 3: 4 mN"),
        ("joints 1 to 3 by 4 mNm", "joints 1 to 3 by 4 mNm (mN of prismatic joints)"),
        ("RMS by joint, Nm", "RMS by joint, Nm (N of prismatic joints)"),
        ("It leaves 1 to 4 Nm RMS, by joint.", "It leaves 1 to 4 Nm (N of prismatic joints) RMS, by joint."),
    ],
)  # fmt: skip
def test_a_sentence_about_some_joints_is_in_their_units(text: str, expected: str) -> None:
    assert in_units(text, UNITS) == expected
    assert in_units(text, ("Nm",) * 3) == text
    assert not REVOLUTE_WORDS.search(in_units(text, ("N",) * 3))


def test_a_page_about_a_mixed_robot_gives_each_joint_its_own_units() -> None:
    line = Line("after", np.arange(3.0), np.arange(3.0))
    panels = tuple(Panel(f"Joint {j}", "velocity (rad/s)", "torque (Nm)", (line,), "RMS 2 Nm") for j in (1, 2))
    wave = Panel("Joint 1", "phase of the wave (rad)", "torque (Nm)", (line,), "RMS 2 Nm")
    size = Table("Size of the torque", ("parameter", "value", "unit"), (("phase", "1", "rad"),))
    blocks = (Heading("1. Ripple, joint 1"), Facts((("RMS", "2 Nm"),)), size, Figure("", (*panels, wave)))
    sections = (
        Section("findings", "Findings", blocks),
        Section("provenance", "Provenance", (Paragraph("torque band, Nm"),)),
    )
    page = in_units_of_joints(Document("Fit", "The model leaves 3 Nm on joint 1.", sections), UNITS)
    findings, provenance = page.sections
    _, facts, table, figure = findings.blocks
    assert page.verdict == "The model leaves 3 N on joint 1."
    assert isinstance(facts, Facts)
    assert facts.entries == (("RMS", "2 N"),)
    assert isinstance(table, Table)
    assert (table.caption, table.rows) == ("Size of the force", size.rows)
    assert isinstance(figure, Figure)
    assert [(panel.x_label, panel.y_label, panel.description) for panel in figure.panels] == [
        ("velocity (m/s)", "force (N)", "RMS 2 N"),
        ("velocity (rad/s)", "torque (Nm)", "RMS 2 Nm"),
        ("phase of the wave (rad)", "force (N)", "RMS 2 N"),
    ]
    assert provenance.blocks == (Paragraph("torque band, Nm"),)


def test_a_diagnosis_of_a_prismatic_axis_speaks_of_forces(tmp_path: Path) -> None:
    (tmp_path / "axis.urdf").write_text(AXIS)
    robot = load_robot(tmp_path / "axis.urdf")
    q, dq, ddq = fourier_motion(1, period_s=5.0, samples=1000, seed=2, speed=0.3)
    force = 95.0 * ddq + 200.0 * dq + 20.0 * np.sign(dq) + 60.0 * np.abs(dq)
    periods = 6
    noise = np.random.default_rng(4).normal(scale=0.5, size=(periods * 1000, 1))
    recording = recording_of(
        np.tile(q, (periods, 1)), np.tile(force, (periods, 1)) + noise, period_s=5.0, periods=periods,
        robot=str(tmp_path / "axis.urdf"),
    )  # fmt: skip
    fit = fit_recordings([recording], robot, FitSettings(physical=False))
    assert dict(zip(fit.names, fit.regressor.units, strict=True)) == {
        "M_1": "kg", "FV_1": "N s/m", "FS_1": "N", **{name: "N" for name in fit.names if name == "OFF_1"},
    }  # fmt: skip
    found = diagnose([recording], robot)
    assert found.findings, "the asymmetric viscous friction is there to be named"
    said = [found.remaining, *found.notes, *(curve.unit for curve in found.curves)]
    for finding in found.findings:
        said += [finding.sentence, finding.separating_experiment or "", *(item.unit for item in finding.parameters)]
    said += [item.unit for item in found.minimum_detectable]
    said += [line for finding in found.findings for line in finding_lines(finding, found.torque_units)]
    for results in ({"fit": fit, "recordings": [recording]}, {"diagnosis": found, "robot": robot}):
        document = build_document(**results)
        said += [document.verdict, *(text for part in document.sections for text in texts_of(part))]
    model = read_model(write_model(fit.to_model_json(notes=False), tmp_path / "model.json"))
    said += [audit([recording], robot, model).sentence, str(Answer(found, Inputs((recording,), robot)))]
    # On a single slide a scale of the force looks like a load: 10 kg are within what a scale of 10 % may be of 95 kg.
    other_noise = np.random.default_rng(5).normal(scale=0.5, size=noise.shape)
    loaded = recording.torque + 25.0 * np.tile(ddq, (periods, 1)) + other_noise - noise
    other = recording_of(recording.position, loaded, period_s=5.0, periods=periods, robot=recording.robot or "")
    said += lines_of(weigh(robot, [recording], [other]), [{}, {}], robot.torque_unit)
    wrong = [text for text in said if REVOLUTE_WORDS.search(text)]
    assert not wrong, wrong
    json.dumps(found.to_json())
