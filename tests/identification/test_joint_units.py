"""Claims about words: what is said of a prismatic joint is in N, m, N s/m and kg.

Truth: one axis with known mass and friction, whose missing friction a diagnosis names.
"""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from identification.fit import FitSettings, fit_recordings
from identification.mismatch.diagnosis import diagnose
from identification.robots import load_robot
from identification.robots.joint_units import for_prismatic
from tests.identification.synthetic import fourier_motion, recording_of

AXIS = """<robot name="axis"><link name="base"/><link name="carriage"/>
<joint name="x" type="prismatic"><parent link="base"/><child link="carriage"/><axis xyz="1 0 0"/>
 <limit lower="-1" upper="1" velocity="2" effort="400"/></joint></robot>"""
REVOLUTE_WORDS = re.compile(r"\b[mk]?Nm\b|\bm?rad\b|torque\b")


@pytest.mark.parametrize(
    ("revolute", "prismatic"),
    [
        ("Nm", "N"), ("mNm", "mN"), ("Nm s/rad", "N s/m"), ("Nm/rad", "N/m"),
        ("rad/Nm", "m/N"), ("rad/s", "m/s"), ("mrad", "mm"), ("1/rad²", "1/m²"),
        ("Nm/h", "N/h"), ("kg", "kg"), ("radius", "radius"),
        ("0.3 Nm at 1 rad/s", "0.3 N at 1 m/s"),
        ("a torque_offset, a torque sensor", "a torque_offset, a force sensor"),
    ],
)  # fmt: skip
def test_units_become_those_of_a_prismatic_joint(revolute: str, prismatic: str) -> None:
    assert for_prismatic(revolute) == prismatic


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
    wrong = [text for text in said if REVOLUTE_WORDS.search(text)]
    assert not wrong, wrong
    json.dumps(found.to_json())
