"""Claims about real recordings whose answer others published. Truth: the EMPS benchmark's own least squares
(nonlinearbenchmark.org), and what is known of the LBR Med 7's stack (recordings/README.md). docs/real-recordings.md
prints the same figures with the commands.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from identification.errors import RecordingError
from identification.recording_fit import FitResult, FitSettings, fit_recordings
from identification.recordings import read_recording
from identification.robots import load_robot
from identification.validation import validate_model
from tests.reference import recording_file

BASE_ONLY = FitSettings(physical=False)
PUBLISHED_EMPS = {"M_1": (95.109, 0.109), "FV_1": (203.50, 1.15), "FS_1": (20.39, 0.0), "OFF_1": (-3.165, 0.0)}
"""Value and deviation; zero where ours alone is taken."""


@pytest.fixture(scope="module")
def emps() -> FitResult:
    return fit_recordings(
        [read_recording(recording_file("emps_a.npz"))], load_robot(recording_file("emps.urdf")), BASE_ONLY
    )


@pytest.mark.parametrize("name", sorted(PUBLISHED_EMPS))
def test_the_emps_axis_has_its_published_parameters(emps: FitResult, name: str) -> None:
    value, published_std = PUBLISHED_EMPS[name]
    place = emps.names.index(name)
    assert abs(emps.values[place] - value) < 2.0 * np.hypot(emps.std[place], published_std)


def test_the_emps_model_predicts_the_run_with_pulses_better_than_the_published_one(emps: FitResult) -> None:
    """Published: 4.083 % on the run it was fitted to, 5.982 % on the other; those hold all frequencies, these fewer."""
    other = read_recording(recording_file("emps_b.npz"))
    assert emps.rms.row("fit, base").percent[0] < 4.083
    assert validate_model(emps, [other]).row("emps_b.npz, base").percent[0] < 5.982


@pytest.fixture(scope="module")
def med7() -> FitResult:
    return fit_recordings(
        [read_recording(recording_file("lbrmed7.npz"))], load_robot(recording_file("med7dock.urdf")), BASE_ONLY
    )


def test_the_med_7_s_torque_is_as_late_as_its_stack_makes_it(med7: FitResult) -> None:
    """Late by 28 ± 1.7 ms, 16 to 43 by joint: that stack low-passes at 10 Hz."""
    delay = med7.torque_delay
    assert abs(1e3 * delay.common - 28.0) < 2.0 * np.hypot(1e3 * delay.std_between_joints, 1.7)
    assert 1e3 * delay.common > 10.0 * 1e3 * delay.common_std


def test_the_sign_that_the_med_7_s_source_has_is_refused_with_all_joints() -> None:
    recording = read_recording(recording_file("lbrmed7.npz"))
    turned = replace(recording, torque=-recording.torque)
    with pytest.raises(RecordingError, match="joint 1, 2, 3, 4, 5, 6, 7 would be negative"):
        fit_recordings([turned], load_robot(recording_file("med7dock.urdf")), BASE_ONLY)
