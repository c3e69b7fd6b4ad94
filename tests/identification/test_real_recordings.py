"""Claims about fits of real robots. Truth: recordings made by others, and baseline figures measured without this code
(recordings/README.md: plain model, weighted least squares, zero-phase low-pass, the same splits).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from identification.estimators.feasibility import violations
from identification.recording_fit import FitResult, FitSettings, fit_recordings
from identification.recordings import read_recording
from identification.recordings.reader import robot_of
from identification.robots import load_robot
from identification.validation import validate_model
from tests.reference import recording_file

ALLOWED = 1.15


def _fit(*files: str, settings: FitSettings) -> FitResult:
    recordings = [read_recording(recording_file(file)) for file in files]
    return fit_recordings(recordings, load_robot(robot_of(recordings)), settings)


@pytest.mark.parametrize(
    ("file", "settings", "baseline"),
    [
        (
            "panda_excitation.npz",
            FitSettings(low_pass_hz=10.0, split="first:0.6", starts=1),
            (9.2, 1.2, 2.3, 1.2, 7.4, 3.7, 19.7),
        ),
        (
            "tx40_excitation.npz",
            FitSettings(low_pass_hz=40.0, split="blocks:0.5:3", starts=1),
            (7.0, 8.0, 11.0, 13.0, 62.0, 29.0),
        ),
    ],
)
def test_no_joint_is_worse_than_the_baseline_on_held_out_rows(
    file: str, settings: FitSettings, baseline: tuple[float, ...]
) -> None:
    result = _fit(file, settings=settings)
    percent = result.rms.row("held out, base").percent
    assert np.all(percent < ALLOWED * np.array(baseline)), percent.round(1)
    assert result.constrained is not None
    assert violations(result.constrained.rules, result.constrained.physical, result.regressor.options.symbols) == ()


def test_kr300_fitted_on_one_run_predicts_the_other() -> None:
    """10 s leave many of the parameters open: feasible ones stay useful on the other run (a third of the torque)."""
    result = _fit("kr300_a.npz", settings=FitSettings(low_pass_hz=8.0, starts=2))
    other = read_recording(recording_file("kr300_b.npz"))
    physical = validate_model(result, [other]).row("kr300_b.npz, physical").percent
    assert np.all(physical < 45.0), physical.round(1)
    assert np.median(physical) < 18.0


def test_the_exported_set_predicts_the_run_on_which_the_free_fit_fails() -> None:
    """It leaves more on the fitted run, as bodies have no negative inertia, and far less on the other."""
    result = _fit("kr300_a.npz", settings=FitSettings(low_pass_hz=8.0, starts=1))
    assert result.constrained is not None
    assert result.consistent is not None
    exported = replace(result, constrained=replace(result.constrained, base_values=result.consistent.base_values))
    table = validate_model(exported, [read_recording(recording_file("kr300_b.npz"))])
    free, bodies = (table.row(f"kr300_b.npz, {label}").rms_nm for label in ("base", "physical"))
    assert np.all(bodies < free)
    assert bodies.sum() < 0.5 * free.sum()


def test_kr300_standstill_does_not_enter_the_fit() -> None:
    result = _fit("kr300_a.npz", settings=FitSettings(low_pass_hz=8.0, physical=False))
    shares = result.provenance["inputs"][0]["stretches"][0]["standstill_share"]
    assert min(shares) > 0.05


def test_panda_rows_are_those_of_its_control_cycle_which_the_stamps_only_follow() -> None:
    """Truth: Franka's controller runs at 1 kHz; stamps are 0.7 to 2.1 ms apart, and libfranka's velocity is its own."""
    recording = read_recording(recording_file("panda_excitation.npz"))
    (held,) = recording.report.of_kind("repeated_rows")
    (trembling,) = recording.report.of_kind("trembling_stamps")
    assert held.count > 1000
    assert "whole cycles of 0.9999" in trembling.sentence
    assert np.abs(np.diff(recording.time) / 1e-3 - np.rint(np.diff(recording.time) / 1e-3)).max() < 1e-3
    assert recording.velocity is not None
    between = 0.5 * (recording.velocity[1:] + recording.velocity[:-1]) * np.diff(recording.time)[:, None]
    left = np.diff(recording.position, axis=0) - between
    assert np.sqrt((left**2).mean()) < 0.05 * np.sqrt((between**2).mean())


def test_kr300_second_encoder_exists_on_three_joints_only() -> None:
    recording = read_recording(recording_file("kr300_a.npz"))
    assert recording.link_position is not None
    assert np.isfinite(recording.link_position[:, :3]).all()
    assert np.isnan(recording.link_position[:, 3:]).all()
    assert [finding.joint for finding in recording.report.of_kind("no_second_encoder")] == [4, 5, 6]


def test_robot_named_by_the_file_is_found_beside_it() -> None:
    recording = read_recording(recording_file("tx40_excitation.npz"))
    assert load_robot(robot_of([recording])).n == recording.n == 6
