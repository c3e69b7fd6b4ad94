"""Periods that are alike to rounding tell no noise. Truth: Pinocchio's torque with nothing, or known torque, on it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from identification.fitting.settings import FitSettings
from identification.mismatch.diagnosis import diagnose
from identification.recording_fit import fit_recordings
from identification.recordings import Recording
from identification.robots import load_robot
from identification.signals.alike import notes_on_alike, one_of_alike
from tests.identification.mismatch import plant
from tests.identification.synthetic import table_three

ROBOT, ARM = load_robot("iiwa14"), table_three()


def hump(q: plant.FloatArray, dq: plant.FloatArray, torque: plant.FloatArray) -> plant.FloatArray:
    return plant.on_joint(3, 0.3 / (1.0 + ((q[:, 2] - 0.1) / 0.3) ** 4))


def simulated(monkeypatch: pytest.MonkeyPatch, noise_nm: float, hidden: plant.Hidden = plant.no_effect) -> Recording:
    monkeypatch.setattr(plant, "NOISE_NM", noise_nm)
    return plant.record(ROBOT, ARM, hidden)


@pytest.mark.parametrize("step_nm", [0.0, 1e-6, 1e-3])
def test_periods_of_a_simulator_stand_for_one(monkeypatch: pytest.MonkeyPatch, step_nm: float) -> None:
    """To the last bits, and written with few decimals."""
    recording = simulated(monkeypatch, 1e-14)
    if step_nm:
        recording = replace(recording, torque=step_nm * np.rint(recording.torque / step_nm))

    one = one_of_alike(recording)
    assert one.samples == plant.SAMPLES
    assert "joints 1, 2, 3, 4, 5, 6, 7" in notes_on_alike(one)[0]


@pytest.mark.parametrize("step_nm", [0.0, 1e-3, 0.05])
def test_measured_noise_is_kept_also_beside_steps_of_its_size(monkeypatch: pytest.MonkeyPatch, step_nm: float) -> None:
    recording = simulated(monkeypatch, 0.05)
    if step_nm:
        recording = replace(recording, torque=step_nm * np.rint(recording.torque / step_nm))

    assert one_of_alike(recording) is recording
    assert not notes_on_alike(recording)


def test_fit_of_a_simulators_recording_knows_no_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    result = fit_recordings([simulated(monkeypatch, 0.0)], ROBOT, FitSettings(physical=False))

    assert not result.misfit.known
    assert any("tell no noise" in note for note in result.notes)


def test_parameters_of_a_joint_with_other_torque_are_determined_beside_joints_without_noise(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Weighed by what is left, 1e-10 Nm on the other joints, its friction was said to be undetermined by the motion."""
    result = fit_recordings([simulated(monkeypatch, 0.0, hump)], ROBOT, FitSettings(physical=False))

    assert 0.05 < result.rms.row("fit, base").rms_nm[2] < 0.3


def test_diagnosis_of_a_simulators_recording_finds_torque_of_unknown_form(monkeypatch: pytest.MonkeyPatch) -> None:
    found = diagnose([simulated(monkeypatch, 0.0, hump)], ROBOT)

    assert [(item.name, item.joint) for item in found.classes] == [("own_position", 3)]
    assert not found.baseline.noise_is_measured
    assert any("tell no noise" in note for note in found.notes)


def test_nothing_is_found_in_a_simulators_recording_of_one_period(monkeypatch: pytest.MonkeyPatch) -> None:
    """0.5 mNm of 50 Nm were a torque that depends on accelerations: that exact are rows without periods not."""
    monkeypatch.setattr(plant, "NOISE_NM", 0.0)
    found = diagnose([plant.record(ROBOT, ARM, periods=1)], ROBOT)

    assert not found.classes
    assert found.verdict == "no_mismatch"
