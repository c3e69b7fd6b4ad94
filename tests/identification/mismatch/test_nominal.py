"""The diagnosis starts from the fit that the user has: same band, weights, options and values. Truth: that fit itself,
made by another call.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from identification.errors import UndeterminedParametersError
from identification.mismatch.diagnosis import diagnose
from identification.mismatch.findings import Diagnosis
from identification.mismatch.nominal import after_findings
from identification.model_file import read_model, write_model
from identification.physical_parameters import PhysicalParameters
from identification.recording_fit import FitResult, FitSettings, fit_recordings
from identification.recordings import Recording
from identification.robots import RobotModel
from tests.identification.mismatch.plant import on_joint, record
from tests.identification.synthetic import fourier_motion, inverse_dynamics, recording_of

FloatArray = npt.NDArray[np.float64]
BASE_ONLY = FitSettings(physical=False)


def _unknown(q: FloatArray, dq: FloatArray, torque: FloatArray) -> FloatArray:
    """Torque of no known form on joint 2, and constants on the whole arm."""
    return on_joint(2, 0.4 * np.sin(7.0 * q[:, 1] + 3.0 * q[:, 3]) * np.tanh(dq[:, 0])) + np.linspace(0.2, 0.5, 7)


@pytest.fixture(scope="module")
def recording(iiwa14: RobotModel, table3: PhysicalParameters) -> Recording:
    return record(iiwa14, table3, _unknown)


@pytest.fixture(scope="module")
def fit(recording: Recording, iiwa14: RobotModel) -> FitResult:
    return fit_recordings([recording], iiwa14, BASE_ONLY)


@pytest.fixture(scope="module")
def diagnosis(
    recording: Recording, fit: FitResult, iiwa14: RobotModel, tmp_path_factory: pytest.TempPathFactory
) -> Diagnosis:
    """Of the recording, against the user's own model of it."""
    model = read_model(write_model(fit.to_model_json(notes=False), tmp_path_factory.mktemp("fit") / "model.json"))
    return diagnose([recording], iiwa14, model=model)


def test_before_is_the_fit_of_the_user(diagnosis: Diagnosis, fit: FitResult) -> None:
    before = {item.name: item.before for item in diagnosis.parameter_shift}
    assert tuple(before) == fit.names
    np.testing.assert_allclose(list(before.values()), fit.values, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(diagnosis.baseline.rms_nm, fit.rms.row("fit, base").rms_nm, rtol=1e-9)
    np.testing.assert_allclose(diagnosis.baseline.noise_floor_nm, fit.noise_floor_nm, rtol=1e-9)
    assert diagnosis.provenance["nominal_fit"] == fit.provenance["digest"]
    assert fit.regressor.options.offset


def test_the_users_own_model_put_right_is_the_model(diagnosis: Diagnosis, fit: FitResult) -> None:
    compared = diagnosis.model_comparison
    assert compared is not None
    np.testing.assert_allclose(compared.missing_nm, compared.model_nm, rtol=1e-6)


def test_a_digest_changes_with_the_inputs_and_the_settings_that_matter_only(
    recording: Recording, fit: FitResult, iiwa14: RobotModel
) -> None:
    def digest(**settings: object) -> object:
        chosen = FitSettings(physical=False, **settings)  # type: ignore[arg-type]
        return fit_recordings([recording], iiwa14, chosen).provenance["digest"]

    assert digest(seed=3, starts=2) == fit.provenance["digest"]
    assert digest(estimator="ols") != fit.provenance["digest"]


def test_a_motion_of_one_joint_is_diagnosed_although_it_leaves_parameters_open(
    iiwa14: RobotModel, table3: PhysicalParameters
) -> None:
    """`fit` refuses it; a torque of q³ on the joint that moves is still told."""
    random = np.random.default_rng(5)
    q, dq, ddq = fourier_motion(7, period_s=10.0, samples=2000, seed=3)
    still = np.arange(7) != 5
    q[:, still], dq[:, still], ddq[:, still] = 0.4, 0.0, 0.0
    torque = inverse_dynamics(iiwa14, table3, q, dq, ddq) + on_joint(6, 0.5 * q[:, 5] ** 3)
    measured = np.tile(torque, (8, 1)) + 0.05 * random.normal(size=(16000, 7))
    recording = recording_of(np.tile(q, (8, 1)), measured, period_s=10.0, periods=8)
    with pytest.raises(UndeterminedParametersError):
        fit_recordings([recording], iiwa14, BASE_ONLY)
    diagnosis = diagnose([recording], iiwa14)
    assert diagnosis.baseline.detected[5]
    assert any("leaves parameters open" in note for note in diagnosis.notes)


def test_findings_take_off_the_fit_what_they_take_off_the_rows_and_never_more_than_it_left() -> None:
    """Squares by hand: 5² − (3² − 0) = 4²; a third of the rows' squares is gone, so a third of 2²."""
    nominal, before, after = np.array([5.0, 2.0, 2.0]), np.array([3.0, 9.0, 9.0]), np.array([0.0, 9.0, np.sqrt(54.0)])
    np.testing.assert_allclose(after_findings(nominal, before, after), [4.0, 2.0, np.sqrt(4.0 * 2.0 / 3.0)])
