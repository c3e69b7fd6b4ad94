"""Claims about files that were written faster than their source. Truth: the source's own rows, written alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from identification.errors import RecordingError
from identification.recordings import Recording, read_recording
from identification.recordings.cleaning import build_recording
from identification.recordings.table import RawTable
from identification.signals.periods import average_periods, period_table
from tests.identification.synthetic import fourier_motion

ROWS, EVERY, STEP = 2000, 10, 0.002


def arrays(seed: int = 0) -> dict[str, np.ndarray]:
    """Three joints in motion for 4 s, with noisy torques."""
    time = STEP * np.arange(ROWS)
    phases = np.outer(time, [1.0, 1.7, 2.3])
    noise = np.random.default_rng(seed).normal(scale=0.01, size=phases.shape)
    return {"t": time, "q": np.sin(phases), "tau": 5.0 * np.cos(phases) + noise}


def read(folder: Path, name: str, **values: Any) -> Recording:
    np.savez(folder / f"{name}.npz", robot="three.urdf", **values)
    return read_recording(folder / f"{name}.npz")


@pytest.mark.parametrize("held", [("q", "tau"), ("q",), ("tau",)])
def test_of_a_file_faster_than_its_source_only_rows_with_news_are_taken(tmp_path: Path, held: tuple[str, ...]) -> None:
    """All rows were taken: positions that stand for 20 ms and jump gave a friction of -3 Nm where 5 Nm were put in."""
    values = arrays()
    source = read(tmp_path, "source", **{name: value[::EVERY] for name, value in values.items()})
    values.update({name: np.repeat(values[name][::EVERY], EVERY, axis=0) for name in held})
    recording = read(tmp_path, "held", **values)
    assert recording.sampling_period_s == pytest.approx(EVERY * STEP)
    np.testing.assert_array_equal(recording.position, source.position)
    np.testing.assert_array_equal(recording.torque, source.torque)
    (finding,) = recording.report.of_kind("repeated_rows")
    assert finding.count == ROWS - ROWS // EVERY
    assert f"no new {held[0]}, which comes once in {EVERY} rows" in finding.sentence


def test_a_source_that_is_late_now_and_then_is_a_slower_source_still(tmp_path: Path) -> None:
    values = arrays()
    news = np.cumsum(np.random.default_rng(1).choice([9, 10, 10, 10, 11], size=ROWS // EVERY))
    row = np.concatenate([[0], news[news < ROWS]])
    last = row[np.searchsorted(row, np.arange(ROWS), side="right") - 1]
    recording = read(tmp_path, "late", t=values["t"], q=values["q"][last], tau=values["tau"])
    np.testing.assert_array_equal(recording.position, values["q"][row])


def test_rest_of_a_slower_source_stays(tmp_path: Path) -> None:
    values = arrays()
    values["q"] = np.repeat(values["q"][::EVERY], EVERY, axis=0)
    values["q"][1000:1500] = values["q"][1000]
    recording = read(tmp_path, "rest", **values)
    at_rest = (recording.time > 1000 * STEP) & (recording.time < 1490 * STEP)
    assert at_rest.sum() >= 20
    assert np.ptp(recording.position[at_rest], axis=0).max() == 0.0


def test_a_coarse_sensor_is_no_slower_source_and_no_row_is_said_to_be_left_out(tmp_path: Path) -> None:
    values = arrays()
    values["q"] = np.round(values["q"], 1)
    values["tau"] = 5.0 * values["q"]
    recording = read(tmp_path, "coarse", **values)
    assert recording.samples == ROWS
    (finding,) = recording.report.of_kind("repeated_rows")
    assert finding.sentence.endswith("the row was kept, as so many do")


def test_a_source_that_comes_at_no_regular_time_is_a_slower_source_still(tmp_path: Path) -> None:
    """Once in 8 to 16 rows: of 60 ms a fit left up to 15 Nm of an arm's torque, with periods and without."""
    values = arrays()
    news = np.cumsum(np.random.default_rng(1).integers(8, 17, size=ROWS))
    row = np.concatenate([[0], news[news < ROWS]])
    last = row[np.searchsorted(row, np.arange(ROWS), side="right") - 1]
    recording = read(tmp_path, "irregular", t=values["t"], q=values["q"][last], tau=values["tau"])
    np.testing.assert_array_equal(recording.position, values["q"][row])


THREE = (
    '<robot name="three"><link name="l0"/>'
    + "".join(
        f'<link name="l{k}"/><joint name="j{k}" type="continuous"><parent link="l{k - 1}"/><child link="l{k}"/>'
        f'<axis xyz="0 {k % 2} {1 - k % 2}"/></joint>'
        for k in (1, 2, 3)
    )
    + "</robot>"
)


def staggered(every: int) -> np.ndarray:
    """Three joints, each of which is told once in so many rows, one after the other."""
    q = arrays()["q"]
    for joint in range(3):
        row = np.maximum(0, (np.arange(ROWS) - joint) // every * every + joint)
        q[:, joint] = q[row, joint]
    return q


def test_joints_that_leap_one_after_the_other_are_refused_where_no_motion_is_left(tmp_path: Path) -> None:
    """Where nobody says which joints are the robot's, a gripper may be the slow one."""
    values = arrays()
    assert read(tmp_path, "nobodys", **(values | {"q": staggered(30)})).samples == ROWS
    (tmp_path / "three.urdf").write_text(THREE)
    with pytest.raises(RecordingError, match=r"joint 1 leaps once in 30 rows \(60 ms\)") as caught:
        read(tmp_path, "slow", **(values | {"q": staggered(30)}))
    assert (caught.value.field, caught.value.joint) == ("q", 1)
    assert read(tmp_path, "fast", **(values | {"q": staggered(5)})).samples == ROWS


@pytest.mark.parametrize("step", [1e-3, 0.05])
def test_a_single_coarse_encoder_is_no_staircase(tmp_path: Path, step: float) -> None:
    values = {name: value if name == "t" else value[:, :1] for name, value in arrays().items()}
    values["q"] = np.round(values["q"] / step) * step
    (tmp_path / "three.urdf").write_text(THREE.split('<link name="l2"/>')[0] + "</robot>")
    assert read(tmp_path, "coarse", **values).samples == ROWS


def test_an_arm_that_rests_most_of_the_time_is_no_staircase(tmp_path: Path) -> None:
    """At rest its encoder turns over by noise once in a while, as different each time as noise is."""
    values = arrays()
    random = np.random.default_rng(3)
    rest = values["q"][500] + 1e-6 * np.repeat(random.normal(size=(50, 3)), 30, axis=0)
    values["q"][500:] = rest
    (tmp_path / "three.urdf").write_text(THREE)
    assert read(tmp_path, "resting", **values).samples == ROWS


def labelled(every: int, phase: int, per_period: int = 1000, periods: int = 4) -> RawTable:
    """A run's own rows with labels, whose positions come once in so many rows, from row `phase` on."""
    motion, _, acceleration = fourier_motion(3, period_s=5.0, samples=per_period, seed=1)
    rows = np.arange(periods * per_period)
    torque = 5.0 * np.tile(acceleration, (periods, 1)) + 0.01 * np.random.default_rng(0).normal(size=(rows.size, 3))
    held = np.maximum((rows - phase) // every * every + phase, 0)
    return RawTable(
        Path("run.mcap"), "log", 5.0 / per_period * rows, np.tile(motion, (periods, 1))[held], torque,
        period_s=5.0, samples_per_period=per_period, period_index=rows // per_period,
        sample_in_period=rows % per_period,
    )  # fmt: skip


@pytest.mark.parametrize(("every", "phase"), [(2, 0), (2, 1), (4, 1)])
def test_periods_of_a_log_whose_positions_are_held_are_those_of_the_rows_with_news(every: int, phase: int) -> None:
    """They were refused with "record at least one period more"; from row 1 on, half the rows were taken for motion."""
    recording = build_recording(labelled(every, phase), sha256="x")
    table = period_table(recording)
    motion, _, _ = fourier_motion(3, period_s=5.0, samples=1000, seed=1)
    assert table.sampling_period_s == pytest.approx(every * 0.005)
    for period in table.position:
        known = np.isfinite(period[:, 0])
        assert known.sum() >= 1000 // every - 1
        np.testing.assert_array_equal(period[known], motion[phase::every][known])
    assert len(average_periods(table).position) == 1000 // every


def test_a_log_whose_news_are_at_other_samples_of_each_period_is_used_without_periods() -> None:
    recording = build_recording(labelled(3, 0), sha256="x")
    assert not recording.is_periodic
    assert "once in 3 rows is at other samples" in recording.report.of_kind("periods_not_used")[0].sentence
