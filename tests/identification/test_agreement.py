"""Recordings that are fitted together and do not show one arm are said to, with periods and without.

Truth: Pinocchio's inverse dynamics of Table 3's arm, with and without 2 kg more on its last link; two real runs.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from identification.recording_fit import FitSettings, fit_recordings
from identification.recordings import Recording, read_recording
from identification.robots import load_robot
from tests.identification.synthetic import fourier_motion, inverse_dynamics, recording_of, table_three

RECORDINGS = Path(__file__).parents[2] / "fixtures" / "recordings"


def _recorded(seed: int, more_kg: float) -> Recording:
    robot, arm = load_robot("iiwa14"), table_three()
    position, velocity, acceleration = fourier_motion(7, period_s=10.0, samples=1000, seed=seed)
    loaded = replace(arm, mass=arm.mass + more_kg * np.eye(7)[6])
    torque = np.tile(inverse_dynamics(robot, loaded, position, velocity, acceleration), (2, 1))
    torque += np.random.default_rng(seed).normal(scale=0.05, size=torque.shape)
    recording = recording_of(np.tile(position, (2, 1)), torque, period_s=10.0, periods=2)
    return replace(recording, source=replace(recording.source, path=f"run{seed}.mcap", sha256=f"{seed}"))


@pytest.mark.parametrize("pipeline", ["periodic", "aperiodic"])
@pytest.mark.parametrize("more_kg", [0.0, 2.0])
def test_a_run_with_a_tool_among_runs_without_is_warned_of(pipeline: str, more_kg: float) -> None:
    """Without periods nothing was said: the arm between both left 8 to 30 % of the torque, with exit code 0."""
    settings = FitSettings(physical=False, pipeline=pipeline)  # type: ignore[arg-type]
    recordings = [_recorded(1, 0.0), _recorded(2, more_kg)]
    for order in (recordings, recordings[::-1]):
        fit = fit_recordings(order, load_robot("iiwa14"), settings)
        said = [note for note in fit.notes if "do not go together" in note]
        assert bool(said) == (more_kg > 0.0)
        if said:
            assert fit.notes[0].startswith("WARNING")
            assert "iiwa-ident compare" in said[0]
            assert all(f"times on run{number}.mcap" in said[0] for number in (1, 2))  # one of two was called the other


def test_two_runs_of_one_real_arm_go_together() -> None:
    """Two motions of the KR300, neither of which determines its parameters alone, and two of the EMPS."""
    for name in ("kr300", "emps"):
        robot = RECORDINGS / f"{name}.urdf"
        recordings = [read_recording(RECORDINGS / f"{name}_{run}.npz", robot=str(robot)) for run in "ab"]
        fit = fit_recordings(recordings, load_robot(robot), FitSettings(physical=False))
        assert not [note for note in fit.notes if "do not go together" in note]


def test_logs_of_two_arms_are_warned_of_however_alike_they_are() -> None:
    """Two arms of one build differ by less than a day's friction: nothing was said, with exit code 0."""
    recordings = [_recorded(1, 0.0), _recorded(2, 0.0)]
    for numbers, warned in (("A1", "B2"), True), (("A1", "A1"), False), (("A1", ""), False):
        stated = [
            replace(item, source=replace(item.source, metadata={"serial": number}))
            for item, number in zip(recordings, numbers, strict=True)
        ]
        said = fit_recordings(stated, load_robot("iiwa14"), FitSettings(physical=False)).notes
        assert any("2 arms (serial numbers A1, B2)" in note for note in said) == warned
        assert not warned or said[0].startswith("WARNING, the recordings are of 2 arms")
