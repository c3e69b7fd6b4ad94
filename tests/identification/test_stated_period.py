"""Claims about a period that a file only states: rounded, of another clock, or with rows missing that nothing shows.

Truth: the period that the motion here was written with, and the mean motion in closed form.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from identification.errors import RecordingError
from identification.recordings import Recording, read_recording, write_recording
from identification.signals.periods import average_periods, period_table

PERIOD_S, STEP_S, PERIODS = 4.0, 0.005, 5
ROWS = round(PERIODS * PERIOD_S / STEP_S)


def _motion(time: np.ndarray) -> np.ndarray:
    turns = 2.0 * np.pi * time / PERIOD_S
    return np.column_stack([np.sin(turns) + 0.4 * np.cos(3.0 * turns), 0.7 * np.cos(turns) - 0.3 * np.sin(5.0 * turns)])


def _read(folder: Path, stated_s: float | None, *, noise: float = 1e-5, lost: tuple[int, int] = (0, 0)) -> Recording:
    time = np.delete(np.arange(ROWS + lost[1] - lost[0]) * STEP_S, np.arange(*lost))
    position = _motion(time) + np.random.default_rng(4).normal(scale=noise, size=(ROWS, 2))
    path = folder / "measured.npz"
    stated = {} if stated_s is None else {"period_s": stated_s}
    np.savez(path, t=np.arange(ROWS) * STEP_S, q=position, tau=3.0 * position, **stated)
    return read_recording(path)


@pytest.mark.parametrize("stated_s", [3.96, 3.996, 4.0004, 4.01, 4.15])
def test_a_period_stated_a_little_wrong_is_that_of_the_motion(tmp_path: Path, stated_s: float) -> None:
    """Over five periods 0.01 s became 0.04 s: the mean was of no motion, and the fit called the rest noise."""
    recording = _read(tmp_path, stated_s)
    assert recording.period_s == pytest.approx(PERIOD_S, abs=1e-5)
    (finding,) = recording.report.of_kind("other_period")
    assert f"not every {stated_s:.7g} s as stated" in finding.sentence
    average = average_periods(period_table(recording))
    exact = _motion(np.arange(len(average.position)) * average.sampling_period_s)
    assert np.abs(average.position - exact).max() < 2e-4


@pytest.mark.parametrize("noise", [0.0, 1e-5, 1e-2])
def test_a_period_stated_right_stays_as_it_is_stated(tmp_path: Path, noise: float) -> None:
    recording = _read(tmp_path, PERIOD_S, noise=noise)
    assert recording.period_s == PERIOD_S
    assert not recording.report.of_kind("other_period")


@pytest.mark.parametrize("noise", [0.0, 1e-2])
def test_a_motion_that_repeats_without_a_stated_period_is_noticed(tmp_path: Path, noise: float) -> None:
    """Bags state none: 16 periods were fitted as one long motion, "because no motion was repeated"."""
    recording = _read(tmp_path, None, noise=noise)
    assert not recording.is_periodic
    (finding,) = recording.report.of_kind("unstated_period")
    assert "repeats every 4 s, 5 times" in finding.sentence
    assert "--period 4`" in finding.sentence
    stated = read_recording(recording.source.path, period_s=4.0)
    assert stated.period_s == PERIOD_S
    assert stated.complete_periods == PERIODS
    assert not stated.report.of_kind("unstated_period")
    assert not read_recording(recording.source.path, period_s=0.0).report.findings


@pytest.mark.parametrize("seed", range(4))
def test_a_motion_that_does_not_repeat_is_not_said_to(tmp_path: Path, seed: int) -> None:
    random = np.random.default_rng(seed)
    time = np.arange(4000) * STEP_S
    rates = random.uniform(0.1, 1.0, (6, 1))  # in no ratio of small whole numbers
    waves = np.sin(2.0 * np.pi * rates * time + random.uniform(0.0, 6.0, (6, 1)))
    position = np.column_stack([waves[:3].sum(axis=0), waves[3:].sum(axis=0)])
    np.savez(tmp_path / "a.npz", t=time, q=position, tau=3.0 * position)
    assert not read_recording(tmp_path / "a.npz").report.findings


def test_a_log_that_numbers_its_periods_takes_no_other(tmp_path: Path) -> None:
    log = write_recording(_read(tmp_path, PERIOD_S), tmp_path / "import.mcap")
    with pytest.raises(RecordingError, match=r"state another where .* is imported"):
        read_recording(log, period_s=3.0)


def test_a_period_far_from_the_motions_is_not_replaced_by_another(tmp_path: Path) -> None:
    recording = _read(tmp_path, 3.0)
    assert recording.period_s == 3.0
    with pytest.raises(RecordingError, match="does not repeat every 3 s"):
        period_table(recording)


@pytest.mark.parametrize("never_seen", [False, True])
def test_rows_lost_behind_even_time_stamps_are_said_with_their_place(tmp_path: Path, never_seen: bool) -> None:
    """Eight rows are missing in the fourth period: what follows is 40 ms early, which was averaged in without a word.

    Also where a sample is missing in every period, which has no mean.
    """
    recording = _read(tmp_path, PERIOD_S, lost=(2700, 2708))
    assert recording.period_s == PERIOD_S
    if never_seen:
        assert recording.sample_in_period is not None
        recording = recording.rows(np.asarray(recording.sample_in_period != 300))
    (note,) = (note for note in period_table(recording).notes if "WARNING" in note)
    assert re.search(r"into period [45] is (3\d|4\d)(\.\d)? ms off. Rows may be missing there", note)


def test_a_slow_joint_that_stands_a_little_elsewhere_in_each_period_has_lost_no_row(tmp_path: Path) -> None:
    """A thousandth of its motion is 6 ms of it, where it is fastest: of one joint alone that looked like lost rows."""
    time = np.arange(40_000) * STEP_S
    elsewhere = np.array([0.0, 2e-4, -2e-4, 1e-4, 0.0])[(time // 40.0).astype(int)]
    position = 0.2 * np.sin(2.0 * np.pi * time / 40.0) + elsewhere
    np.savez(tmp_path / "a.npz", t=time, q=position[:, None], tau=3.0 * position[:, None], period_s=40.0)
    table = period_table(read_recording(tmp_path / "a.npz"))
    assert not [note for note in table.notes if "WARNING" in note]


def test_rows_lost_of_a_single_slow_joint_are_said(tmp_path: Path) -> None:
    time = np.delete(np.arange(40_010) * STEP_S, np.arange(22_000, 22_010))
    position = 0.2 * np.sin(2.0 * np.pi * time / 40.0)[:, None]
    np.savez(tmp_path / "a.npz", t=np.arange(40_000) * STEP_S, q=position, tau=3.0 * position, period_s=40.0)
    (note,) = (note for note in period_table(read_recording(tmp_path / "a.npz")).notes if "WARNING" in note)
    assert "Rows may be missing there" in note


def test_periods_that_begin_a_few_milliseconds_early_or_late_are_periods(tmp_path: Path) -> None:
    """Each was sent by itself, at 1 kHz: without periods the same rows left parameters three times as many σ off."""
    clock = np.arange(round(PERIODS * PERIOD_S / 0.001)) * 0.001
    late_s = np.array([0.0, 1.5, -1.5, 1.0, 0.0])[(clock // PERIOD_S).astype(int)] * 1e-3
    noise = np.random.default_rng(4).normal(size=(2, clock.size, 2))
    position, torque = _motion(clock - late_s) + 1e-5 * noise[0], 3.0 * _motion(clock - late_s) + 0.05 * noise[1]
    np.savez(tmp_path / "a.npz", t=clock, q=position, tau=torque, period_s=PERIOD_S)
    average = average_periods(period_table(read_recording(tmp_path / "a.npz")))
    assert average.periods == 5
    exact = _motion(np.arange(len(average.position)) * average.sampling_period_s - 2e-4)
    assert np.abs(average.position - exact).max() < 1e-2


def test_stamps_that_jitter_by_some_of_a_step_lose_no_sample_of_two_periods(tmp_path: Path) -> None:
    """By the median step the period had two samples less, and the recording was refused for samples that were there."""
    rows = round(2 * PERIOD_S / STEP_S)
    random = np.random.default_rng(2)
    clock = (np.arange(rows) + 0.3 * random.uniform(-1.0, 1.0, rows)) * STEP_S
    position = _motion(clock)
    np.savez(tmp_path / "a.npz", t=clock, q=position, tau=3.0 * position, period_s=PERIOD_S)
    average = average_periods(period_table(read_recording(tmp_path / "a.npz")))
    assert len(average.position) == round(PERIOD_S / STEP_S)
    assert average.counts.min() >= 1
    assert not average.filled.any()


@pytest.mark.parametrize("jitter", [0.37, 0.5])
@pytest.mark.parametrize("lost", [0, 20])
def test_stamps_that_are_uneven_hide_no_row_and_lose_none(tmp_path: Path, jitter: float, lost: int) -> None:
    """Rows measured when they are stamped. Steps of more than one and a half were called gaps, some hundred of them,
    and two periods refused for samples that two rows had come near to.
    """
    rows = round(2 * PERIOD_S / STEP_S)
    random = np.random.default_rng(2)
    clock = np.sort(np.arange(rows) + jitter * random.uniform(-1.0, 1.0, rows)) * STEP_S
    clock = np.delete(clock, slice(300, 300 + lost))
    position = _motion(clock)
    np.savez(tmp_path / "a.npz", t=clock, q=position, tau=3.0 * position, period_s=PERIOD_S)
    recording = read_recording(tmp_path / "a.npz")
    gaps = recording.report.of_kind("gap")
    crowded = sum(each.count for each in recording.report.of_kind("crowded_rows"))
    assert sum(each.count for each in gaps) <= crowded + 3 + bool(lost)
    assert recording.sampling_period_s == pytest.approx(STEP_S, rel=2e-3)
    average = average_periods(period_table(recording))
    assert average.filled.sum() <= 2
    exact = _motion(clock[0] + np.arange(len(average.position)) * average.sampling_period_s)
    shift = np.median((average.position - exact)[:, 0] / np.gradient(exact[:, 0], average.sampling_period_s))
    exact = _motion(clock[0] + shift + np.arange(len(average.position)) * average.sampling_period_s)
    assert np.abs(average.position - exact).max() < 1e-3


def test_coarse_stamps_lose_no_sample_of_the_period(tmp_path: Path) -> None:
    """300 Hz in whole milliseconds: steps of 3, 3 and 4 ms. By their median the period had 1333 samples, not 1200."""
    time = np.arange(6000) / 300.0
    position = _motion(time)
    np.savez(tmp_path / "a.npz", t=np.round(time, 3), q=position, tau=3.0 * position, period_s=PERIOD_S)
    average = average_periods(period_table(read_recording(tmp_path / "a.npz")))
    assert len(average.position) == 1200
    assert average.counts.min() == 5


@pytest.mark.parametrize(
    ("periods", "stated_s"), [(1, 4.0), *((periods, stated) for periods in (2, 3, 5) for stated in (3.96, 4.0, 4.01))]
)
@pytest.mark.parametrize(("before_s", "after_s"), [(0.2, 0.0), (0.0, 0.2), (0.6, 0.6)])
def test_an_arm_that_stands_before_and_after_the_motion_stands_in_no_period(
    tmp_path: Path, before_s: float, after_s: float, periods: int, stated_s: float
) -> None:
    """Recorded by hand: of two periods the mean was 0.1 rad off, of three it was said that rows are missing."""
    rows = round((before_s + periods * PERIOD_S + after_s) / STEP_S)
    time = np.arange(rows) * STEP_S
    position = _motion(np.clip(time - before_s, 0.0, periods * PERIOD_S))
    position += np.random.default_rng(4).normal(scale=1e-5, size=position.shape)
    np.savez(tmp_path / "a.npz", t=time, q=position, tau=3.0 * position, period_s=stated_s)
    recording = read_recording(tmp_path / "a.npz")
    assert recording.period_s == pytest.approx(PERIOD_S, abs=1e-5)
    assert "before the motion or after it the arm stands" in recording.report.of_kind("standing_ends")[0].sentence
    average = average_periods(period_table(recording))
    labels = recording.period_index
    assert labels is not None
    first = float(recording.time[labels >= 0][0])
    exact = _motion(np.arange(len(average.position)) * average.sampling_period_s + first - before_s)
    assert np.abs(average.position - exact).max() < 2e-4


def test_half_a_period_between_two_rests_is_no_period(tmp_path: Path) -> None:
    time = np.arange(ROWS) * STEP_S
    position = _motion(np.clip(time - 8.0, 0.0, 0.6 * PERIOD_S))
    np.savez(tmp_path / "a.npz", t=time, q=position, tau=3.0 * position, period_s=PERIOD_S)
    recording = read_recording(tmp_path / "a.npz")
    assert not recording.is_periodic
    assert "covers 2.39 s of a stated period of 4 s" in recording.report.of_kind("short_of_a_period")[0].sentence


def test_a_motion_that_rests_in_every_period_keeps_all_rows(tmp_path: Path) -> None:
    time = np.arange(ROWS) * STEP_S
    position = _motion(np.maximum(time % PERIOD_S - 0.5, 0.0) * PERIOD_S / (PERIOD_S - 0.5))
    np.savez(tmp_path / "a.npz", t=time, q=position, tau=3.0 * position, period_s=PERIOD_S)
    recording = read_recording(tmp_path / "a.npz")
    assert recording.period_index is not None
    assert (recording.period_index >= 0).all()
    assert not recording.report.of_kind("standing_ends")


def test_an_arm_that_goes_once_to_another_place_is_read(tmp_path: Path) -> None:
    time = np.arange(ROWS) * STEP_S
    position = np.where(time > 9.0, 0.5, 0.0)[:, None] + np.zeros(2)
    np.savez(tmp_path / "a.npz", t=time, q=position, tau=np.column_stack([np.sin(time), np.cos(time)]), period_s=4.0)
    assert read_recording(tmp_path / "a.npz").period_s == 4.0


def test_joints_that_stand_still_do_not_hide_the_period_of_the_others(tmp_path: Path) -> None:
    """Their noise, in units of itself, was more than what the other joints' motion differed by."""
    time = np.arange(ROWS) * STEP_S
    position = np.column_stack([_motion(time)[:, :1], np.full((ROWS, 6), 0.3)])
    position += np.random.default_rng(4).normal(scale=1e-5, size=position.shape)
    np.savez(tmp_path / "a.npz", t=time, q=position, tau=3.0 * position, period_s=3.96)
    assert read_recording(tmp_path / "a.npz").period_s == pytest.approx(PERIOD_S, abs=1e-5)
