"""A copy with fewer decimals is the recording itself; a second run of the same motion is not, coarse as it may be.

What is a copy is known from how it was made; the noise of two runs is drawn apart, or was measured by others.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from identification.arrays import FloatArray
from identification.errors import RecordingError
from identification.model_file import read_model, write_model
from identification.recording_fit import fit_recordings
from identification.recordings import Recording, read_recording, refuse_repeated, refuse_shared_samples
from identification.recordings.rounded import Rows, last_decimal, moving_rows, rows_that_agree
from identification.robots import load_robot
from tests.identification.synthetic import coloured_noise, fourier_motion, recording_of
from tests.reference import ARM_OF, recording_file

REAL = ("emps_a", "kr300_a", "tx40_excitation", "lbrmed7", "ur10")


def in_text(style: str, values: FloatArray) -> FloatArray:
    """Numbers as they come back from a table that was written in a printf style."""
    return np.array([float(style % value) for value in values.ravel()]).reshape(values.shape)


def written(run: Recording, style: str, *, unit: float = 1.0) -> Recording:
    """A copy by way of a table, positions in another unit, with its clock set to zero."""
    position, torque = in_text(style, run.position / unit) * unit, in_text(style, run.torque)
    source = replace(run.source, sha256=f"{style} {position.sum()}", metadata={})
    return replace(run, time=run.time - run.time[0], position=position, torque=torque, source=source)


def thinned(run: Recording) -> Recording:
    keep = np.arange(run.samples) % 5 == 2
    return replace(written(run, "%.4f").rows(keep), sampling_period_s=5.0 * run.sampling_period_s)


def cut(run: Recording) -> Recording:
    place = np.arange(run.samples)
    return written(run.rows((place > run.samples // 3) & (place < 2 * run.samples // 3)), "%.4f")


COPIES: dict[str, Callable[[Recording], Recording]] = {
    "four decimals": lambda run: written(run, "%.4f"),
    "degrees": lambda run: written(run, "%.3f", unit=np.pi / 180.0),
    "five digits": lambda run: written(run, "%.5g"),
    "every fifth row": thinned,
    "a third": cut,
}


@pytest.mark.parametrize("copy", COPIES)
@pytest.mark.parametrize("name", REAL)
def test_a_rounded_copy_of_a_real_recording_is_the_recording(name: str, copy: str) -> None:
    run = read_recording(recording_file(f"{name}.npz"))
    again = COPIES[copy](run)
    for first, second in ((run, again), (again, run)):
        with pytest.raises(RecordingError, match=r"rows running, to within the last decimals|shares"):
            refuse_shared_samples([first], [second])
    with pytest.raises(RecordingError, match="counts once"):
        refuse_repeated([run, again])


def test_the_file_of_a_model_knows_rounded_copies(tmp_path: Path) -> None:
    name = "ur10"
    run = read_recording(recording_file(f"{name}.npz"))
    robot = load_robot(recording_file(ARM_OF[name]))
    for fitted in (run, written(run, "%.4f")):
        fit = fit_recordings([fitted], robot)
        model = read_model(write_model(fit.to_model_json(notes=False), tmp_path / "model.json"))
        for copy, make in COPIES.items():
            assert model.fitted_among([make(run)]), copy
        assert model.fitted_among([run])
        late = run.rows(run.time > 14.0)
        early = fit_recordings([run.rows(run.time < 14.0)], robot)
        model = read_model(write_model(early.to_model_json(notes=False), tmp_path / "early.json"))
        assert not model.fitted_among([written(late, "%.4f")])


@pytest.mark.parametrize("pair", ["emps", "kr300"])
def test_two_real_runs_stay_two_however_coarse_their_files(pair: str) -> None:
    first, second = (read_recording(recording_file(f"{pair}_{run}.npz")) for run in "ab")
    for style in ("%.5f", "%.4f", "%.3f", "%.2f", "%.1f", "%.4g", "%.3g"):
        assert rows_that_agree(moving_rows(written(first, style)), written(second, style)) == 0
        assert rows_that_agree(moving_rows(first), written(second, style)) == 0


@pytest.mark.parametrize("name", REAL)
def test_parts_of_a_real_recording_stay_two(name: str) -> None:
    """EMPS repeats its motion, with a force in steps that its position decides."""
    run = read_recording(recording_file(f"{name}.npz"))
    half = np.arange(run.samples) < run.samples // 2
    for style in ("%.5f", "%.4f", "%.3f", "%.1f"):
        first, second = written(run.rows(half), style), written(run.rows(~half), style)
        assert rows_that_agree(moving_rows(first), second) == 0
        refuse_repeated([first, second])  # samples of EMPS that were alike by chance, 15 of 8774, made them one


@pytest.mark.parametrize("correlation", [0.0, 0.95])
@pytest.mark.parametrize("noise", [0.1, 0.3, 1.0])
@pytest.mark.parametrize("samples", [500, 5000])
@pytest.mark.parametrize("joints", [1, 3, 7])
def test_runs_whose_noise_is_below_their_decimals_stay_two(
    joints: int, samples: int, noise: float, correlation: float
) -> None:
    """noise: in steps of the torque's last decimal. A torque in whole steps then agrees in most rows of two runs."""
    q, dq, ddq = fourier_motion(joints, period_s=5.0, samples=samples, seed=1)
    torque = 5.0 * ddq + 3.0 * np.tanh(dq / 0.05) + 10.0 * np.sin(q)

    def run(seed: int, decimals: int) -> Recording:
        drawn = coloured_noise(q.shape, deviation=noise, correlation=correlation, seed=seed)
        return recording_of(q.round(max(decimals, 2)), (torque + drawn * 10.0**-decimals).round(decimals), period_s=5.0)

    for decimals in range(4):
        first, second = run(1, decimals), run(2, decimals)
        for rows in (moving_rows(first), Rows.from_text(moving_rows(first).to_text())):
            assert rows_that_agree(rows, second) == 0


@pytest.mark.parametrize("joints", [1, 6])
@pytest.mark.parametrize("noise", [0.03, 0.1, 0.3])
def test_two_coarse_runs_of_a_motion_that_repeats_are_two(noise: float, joints: int) -> None:
    """Up to 95 % of the rows of one stand in the other, hundreds of them one after the other; all of a copy's do.

    noise: in steps of the last decimal.
    """
    q, dq, ddq = fourier_motion(joints, period_s=5.0, samples=1000, seed=1)
    torque = 5.0 * ddq + 3.0 * np.tanh(dq / 0.05) + 10.0 * np.sin(q)
    eight = np.tile(np.hstack([q, torque]), (8, 1))

    def run(seed: int) -> Recording:
        drawn = eight + noise * np.repeat([1e-3, 0.1], joints) * np.random.default_rng(seed).normal(size=eight.shape)
        return recording_of(drawn[:, :joints].round(3), drawn[:, joints:].round(1), period_s=5.0, periods=8)

    first, second = run(1), run(2)
    refuse_repeated([first, second])
    refuse_shared_samples([first], [second])
    for copy in (written(first, "%.4f"), cut(first)):
        with pytest.raises(RecordingError, match="shares"):
            refuse_repeated([first, copy])


@pytest.mark.parametrize("largest", [1.005, 10.1])
def test_the_largest_numbers_near_one_multiple_tell_of_no_step(largest: float) -> None:
    """A joint with torques up to 10.1 Nm was one in steps of 10 Nm, and its noise one that rounding makes."""
    torque = largest * np.sin(np.linspace(0.0, 200.0, 5000))
    assert last_decimal(torque) < 1e-4
    assert last_decimal(torque.round(2)) == pytest.approx(0.01)
