"""Rows that stand in a file twice are measured once. Truth: the rows of the first time, as others recorded them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from identification.arrays import IntArray
from identification.recordings import Recording, read_recording
from tests.reference import ARM_OF, recording_file

FIRST, AGAIN = 1000, 300


def read(path: Path, rows: IntArray) -> Recording:
    values = np.load(recording_file("ur10.npz"))
    step = float(np.median(np.diff(values["t"])))
    np.savez(path, t=step * np.arange(len(rows)), q=values["q"][rows], tau=values["tau"][rows])
    return read_recording(path, robot=str(recording_file(ARM_OF["ur10"])))


@pytest.mark.parametrize("overwritten", [0, AGAIN])
def test_a_stretch_that_comes_again_under_an_even_clock_is_a_gap(tmp_path: Path, overwritten: int) -> None:
    """It was fitted as a motion with a leap: inertias 10 σ off, under a note on rows that may be missing."""
    number = np.arange(3441)
    end = FIRST + AGAIN
    rows = np.concatenate([number[:end], number[FIRST:end], number[end + overwritten :]])
    recording = read(tmp_path / "again.npz", rows)
    once = np.load(recording_file("ur10.npz"))["q"][np.concatenate([number[:end], number[end + overwritten :]])]
    np.testing.assert_array_equal(recording.position, once)
    (finding,) = recording.report.of_kind("repeated_rows")
    assert (finding.first_row, finding.count) == (end + 1, AGAIN)
    assert recording.report.of_kind("gap")


@pytest.mark.parametrize("name", [name for name in ARM_OF if name != "panda_excitation"])
def test_no_real_recording_loses_a_row_to_that(name: str) -> None:
    findings = read_recording(recording_file(f"{name}.npz")).report.findings
    assert all("second time" not in each.sentence for each in findings)


def test_a_simulated_motion_without_noise_may_repeat(tmp_path: Path) -> None:
    """Its rows come again bit by bit, and the motion goes on without a leap."""
    time = 0.01 * np.arange(3000)
    turns = 2.0 * np.pi * (np.arange(3000) % 500)[:, None] / 500.0 * np.array([1.0, 2.0, 3.0])
    np.savez(tmp_path / "again.npz", t=time, q=np.sin(turns), tau=5.0 * np.cos(turns), robot="three.urdf")
    assert read_recording(tmp_path / "again.npz").samples == 3000
