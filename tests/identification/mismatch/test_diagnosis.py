"""The whole way, on plants computed by Pinocchio with torque the tests wrote themselves."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from identification.errors import EstimationError
from identification.mismatch.diagnosis import diagnose
from identification.mismatch.findings import Diagnosis, Finding
from identification.physical_parameters import PhysicalParameters
from identification.robots import RobotModel
from tests.identification.mismatch.plant import NOISE_NM, PERIOD_S, SAMPLES, on_joint, record
from tests.identification.synthetic import fourier_motion, inverse_dynamics


def finding_of(diagnosis: Diagnosis, effect: str, joint: int | None) -> Finding:
    return next(item for item in diagnosis.findings if (item.effect, item.place.joint) == (effect, joint))


def test_nothing_hidden_and_noisy_feedback_gives_no_name(clean_diagnosis: Diagnosis) -> None:
    assert clean_diagnosis.verdict == "no_mismatch"
    assert not clean_diagnosis.findings
    assert not clean_diagnosis.baseline.detected.any()
    # White noise of 0.05 Nm and eight periods, compared up to 60 of 100 Hz.
    assert f"No mismatch above {NOISE_NM / np.sqrt(8) * np.sqrt(0.6):.2g} Nm over the compared band" in (
        clean_diagnosis.remaining
    )
    assert len(clean_diagnosis.minimum_detectable) > 50


def test_two_hidden_effects_are_both_named_and_nothing_else(pair_diagnosis: Diagnosis) -> None:
    named = {(item.effect, item.place.joint) for item in pair_diagnosis.findings}
    assert named == {("cable_spring", 6), ("stribeck_friction", 1)}
    assert pair_diagnosis.verdict == "explained"


def test_sizes_are_the_true_ones_within_their_intervals(pair_diagnosis: Diagnosis) -> None:
    stribeck = {item.name: item for item in finding_of(pair_diagnosis, "stribeck_friction", 1).parameters}
    spring = {item.name: item for item in finding_of(pair_diagnosis, "cable_spring", 6).parameters}
    for item, truth in (
        (stribeck["amplitude"], 0.3),
        (stribeck["stribeck_velocity"], 0.05),
        (spring["stiffness"], 0.4),
    ):
        assert abs(item.value - truth) < 4.0 * item.std
        assert item.std < 0.1 * truth


def test_names_are_confirmed_on_a_motion_that_was_not_fitted(pair_diagnosis: Diagnosis) -> None:
    heldout = pair_diagnosis.heldout
    assert heldout is not None
    for joint in (0, 5):
        assert heldout.rms_after_nm[joint] < heldout.rms_before_nm[joint]
        assert heldout.ci95_after_nm[joint, 0] <= heldout.rms_after_nm[joint] <= heldout.ci95_after_nm[joint, 1]
        removed = 1.0 - (heldout.excess_after_nm[joint] / heldout.excess_before_nm[joint]) ** 2
        assert removed > 0.9
    assert all(item.confirmed for item in pair_diagnosis.findings)


def test_joints_without_an_effect_stay_clean(pair_diagnosis: Diagnosis) -> None:
    assert pair_diagnosis.baseline.detected[[0, 5]].all()
    assert finding_of(pair_diagnosis, "cable_spring", 6).where["joints"] == [6]


def test_with_the_findings_nothing_but_noise_is_left_of_the_fit(pair_diagnosis: Diagnosis) -> None:
    """Nothing else is hidden in this plant, and its noise is known. Friction near standstill reaches beyond 60 Hz: what
    the findings take off the rows of the diagnosis, which end there, left a quarter more of joint 1.
    """
    np.testing.assert_allclose(pair_diagnosis.rms_after_nm, NOISE_NM / np.sqrt(8), rtol=0.06)


def test_json_is_the_contracts_and_holds_no_number_that_is_not_finite(pair_diagnosis: Diagnosis) -> None:
    data = json.loads(json.dumps(pair_diagnosis.to_json(), allow_nan=False))
    assert data["format"] == "iiwa-ident/diagnosis/1"
    assert {
        "verdict", "baseline", "findings", "data_faults", "not_identifiable_here", "minimum_detectable", "heldout",
        "parameter_shift", "remaining",
    } <= set(data)  # fmt: skip
    finding = data["findings"][0]
    assert {
        "effect", "joint", "link", "where", "parameters", "absorbed_fraction", "score", "significance",
        "heldout_gain_nm", "alternatives", "separating_experiment", "sentence",
    } <= set(finding)  # fmt: skip
    model = json.loads(json.dumps(pair_diagnosis.extended_model_json(), allow_nan=False))
    assert len(model["base_parameters"]) == 57
    assert len(model["effects"]) == 2


def test_base_parameters_move_towards_the_truth(
    pair_diagnosis: Diagnosis, iiwa14_base: object, table3: PhysicalParameters
) -> None:
    truth = dict(zip(iiwa14_base.names, iiwa14_base.base_from_physical(table3), strict=True))  # type: ignore[attr-defined]
    shift = next(item for item in pair_diagnosis.parameter_shift if item.name == "FS_1")
    assert abs(shift.after - truth["FS_1"]) < abs(shift.before - truth["FS_1"])
    assert abs(shift.after - truth["FS_1"]) < 5.0 * shift.std


def test_without_held_out_recording_the_name_is_unconfirmed(iiwa14: RobotModel, table3: PhysicalParameters) -> None:
    def loaded(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
        return on_joint(4, 0.02 * np.sign(dq[:, 3]) * np.abs(torque[:, 3]))

    diagnosis = diagnose([record(iiwa14, table3, loaded)], iiwa14)
    finding = finding_of(diagnosis, "load_dependent_friction", 4)
    assert finding.confirmed is None
    assert "nconfirmed" in finding.sentence
    assert "nconfirmed" in diagnosis.remaining
    share = finding.parameters[0]
    assert share.unit == "%"
    assert share.value == pytest.approx(2.0, abs=4.0 * share.std)


def test_a_late_acquisition_is_one_finding_of_no_joint(iiwa14: RobotModel, table3: PhysicalParameters) -> None:
    def late(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
        return np.roll(torque, 4, axis=0) - torque  # 20 ms at 200 Hz

    diagnosis = diagnose([record(iiwa14, table3, late)], iiwa14)
    assert [(item.effect, item.place.joint) for item in diagnosis.findings] == [("torque_delay", None)]
    assert diagnosis.findings[0].parameters[0].value == pytest.approx(20.0, rel=0.02)


def test_misfit_of_no_known_kind_is_located_and_not_named(iiwa14: RobotModel, table3: PhysicalParameters) -> None:
    def notches(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
        return on_joint(5, 0.3 * np.where(np.modf(np.abs(q[:, 4]) * 4.3)[0] < 0.15, 1.0, 0.0) * np.sign(q[:, 4]))

    fitted = record(iiwa14, table3, notches)
    unseen = record(iiwa14, table3, notches, periods=4, motion=9, seed=2)
    diagnosis = diagnose([fitted], iiwa14, heldout=[unseen])
    assert diagnosis.verdict == "unexplained"
    assert diagnosis.baseline.detected.tolist() == [joint == 4 for joint in range(7)]
    assert [curve.joint for curve in diagnosis.curves] == [5]
    assert diagnosis.curves[0].coordinate == "position"


def test_a_torque_without_any_noise_is_diagnosed(iiwa14: RobotModel, table3: PhysicalParameters) -> None:
    """As a simulator gives it: weights without end have no solution."""
    recording = record(iiwa14, table3, periods=4)
    exact = inverse_dynamics(iiwa14, table3, *fourier_motion(7, period_s=PERIOD_S, samples=SAMPLES, seed=3))
    found = diagnose([replace(recording, torque=np.tile(exact, (4, 1)))], iiwa14)
    assert not found.findings
    assert np.all(found.rms_after_nm < 1e-3)
    assert found.verdict == "no_mismatch"


def test_no_recording_is_refused(iiwa14: RobotModel) -> None:
    with pytest.raises(EstimationError, match="No recording"):
        diagnose([], iiwa14)
