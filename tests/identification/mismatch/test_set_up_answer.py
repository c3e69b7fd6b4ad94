"""Claims about a diagnosis against a model whose arm stands, or is set up, otherwise.

Truth: Pinocchio's inverse dynamics of the arm of the model under another gravity.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from daemon.cli.diagnosis import set_up_lines, verdict_lines
from identification.audit import audit
from identification.base_parameters import BaseRegressor
from identification.mismatch.diagnosis import diagnose
from identification.model_file import Model
from identification.physical_parameters import PhysicalParameters
from identification.report.comparison_section import comparison_section
from identification.report.diagnosis_sections import verdict_sentence
from identification.report.document import Table
from identification.robots import Installation, RobotModel, load_robot
from tests.identification.mismatch.plant import NOISE_NM, on_joint, record

LEAN = np.radians(40.0)
GRAVITY = (float(9.81 * np.sin(LEAN)), 0.0, float(-9.81 * np.cos(LEAN)))


@pytest.fixture
def level(iiwa14_base: BaseRegressor, table3: PhysicalParameters) -> Model:
    """The true parameters of the arm on a floor."""
    values = iiwa14_base.base_from_physical(table3)
    std, none = np.full(iiwa14_base.size, 1e-4), np.zeros(0)
    return Model("iiwa14", iiwa14_base.names, values, std, iiwa14_base.units, None, none, none, iiwa14_base.options)


def test_a_leaning_arm_is_fitted_under_the_gravity_that_it_felt(
    iiwa14: RobotModel, table3: PhysicalParameters, level: Model
) -> None:
    """Fitted as if level it left several Nm, which was called missing physics, or noise as likely."""
    recording = record(load_robot("iiwa14", Installation(GRAVITY)), table3, periods=1)
    known = replace(level, data={"rms_nm": {"fit": 7 * [NOISE_NM]}})
    diagnosis = diagnose([recording], iiwa14, model=known)
    audit, compared = diagnosis.audit, diagnosis.model_comparison
    assert audit is not None
    assert [item.effect for item in audit.differences] == ["base_tilt"]
    assert diagnosis.baseline.rms_nm == pytest.approx(np.full(7, NOISE_NM), rel=0.05)
    assert not diagnosis.baseline.detected.any()
    assert diagnosis.gravity == pytest.approx(GRAVITY, abs=0.05)
    # The model is compared as it stands: weight on joint 2 of a level arm and of one that leans differ by tens of Nm.
    assert compared is not None
    assert compared.model_nm.max() > 10.0
    assert compared.missing_nm.max() < 1.1 * NOISE_NM
    section = comparison_section(compared)
    assert section is not None
    # Page and terminal say the same: the turn, which is all, and no link that would be wrong.
    assert diagnosis.verdict == "explained"
    (said,) = set_up_lines(diagnosis)
    answer = verdict_lines(diagnosis)[-1]
    assert said == f"Set-up: {audit.differences[0].sentence}"
    assert answer.startswith("Explained: ")
    headline = verdict_sentence(diagnosis)
    assert headline.startswith(audit.differences[0].sentence)
    assert headline.endswith(answer)
    assert [block.caption[:3] for block in section.blocks if isinstance(block, Table)] == ["RMS"]
    assert diagnosis.standing(iiwa14).to_json()["installation"]["gravity_m_s2"] == list(diagnosis.gravity)


def test_the_rest_is_asked_of_the_recording_as_the_model_shows_that_it_is_to_be_read(
    iiwa14: RobotModel, table3: PhysicalParameters, level: Model
) -> None:
    """Exchanged torques got two wrong signs besides, and a table and a model.json with 31 Nm on joint 4."""
    sound, unseen = (record(iiwa14, table3, periods=1, motion=motion) for motion in (3, 4))
    exchanged = replace(sound, torque=sound.torque[:, [0, 3, 2, 1, 4, 5, 6]])
    known = replace(level, data={"rms_nm": {"fit": 7 * [NOISE_NM]}})
    # The held-out one is of a day on which the columns were right.
    diagnosis = diagnose([exchanged], iiwa14, heldout=[unseen], model=known)
    (said,) = set_up_lines(diagnosis)
    assert "that of joint 2 stands under joint 4, that of joint 4 stands under joint 2" in said
    assert not diagnosis.data_faults
    assert [fault["fault"] for fault in diagnosis.to_json()["data_faults"]] == ["wrong_joint_order"]
    assert diagnosis.heldout is not None
    for left in (diagnosis.baseline.rms_nm, diagnosis.heldout.rms_before_nm):
        assert left.max() < 1.05 * NOISE_NM
    (read,) = diagnosis.as_read([exchanged], iiwa14)
    np.testing.assert_array_equal(read.torque, sound.torque)


def test_physics_is_named_in_a_recording_whose_columns_are_put_right(
    iiwa14: RobotModel, table3: PhysicalParameters, level: Model
) -> None:
    """Nothing was asked of it, as long as it was fitted as it stands."""
    sound = record(iiwa14, table3, lambda q, _dq, _torque: on_joint(3, 0.8 * np.sin(9.0 * q[:, 2])), periods=2)
    exchanged = replace(sound, torque=sound.torque[:, [0, 3, 2, 1, 4, 5, 6]])
    diagnosis = diagnose([exchanged], iiwa14, model=level)
    (finding,) = diagnosis.findings
    assert finding.place.joint == 3
    assert finding.effect in ("position_dependent_torque", "torque_ripple")


def test_a_clock_that_the_model_tells_is_read_right(
    iiwa14: RobotModel, table3: PhysicalParameters, level: Model
) -> None:
    sound = record(iiwa14, table3, periods=2)
    slow = replace(sound, time=1.25 * sound.time, sampling_period_s=1.25 * sound.sampling_period_s, period_s=12.5)
    reading = audit([slow], iiwa14, level).reading
    assert reading is not None
    read = reading.of(slow, iiwa14.kinematics.revolute)
    np.testing.assert_allclose(read.time, sound.time, rtol=1e-3)
    assert (read.period_s, read.sampling_period_s) == pytest.approx((10.0, sound.sampling_period_s), rel=1e-3)


def test_a_lean_too_small_for_the_recording_alone_is_taken_as_the_model_tells_it(
    iiwa14: RobotModel, table3: PhysicalParameters, level: Model
) -> None:
    gravity = (9.81 * np.sin(0.04), 0.0, -9.81 * np.cos(0.04))
    recording = record(load_robot("iiwa14", Installation(gravity)), table3, periods=8)
    diagnosis = diagnose([recording], iiwa14, model=level)
    assert diagnosis.gravity == pytest.approx(gravity, abs=0.02)
    assert diagnosis.baseline.rms_nm == pytest.approx(np.full(7, NOISE_NM / np.sqrt(8.0)), rel=0.05)
