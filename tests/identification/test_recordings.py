"""Claims about reading recordings: what is refused, what is found and left out, what survives bit by bit.

Truth: files written here with numpy and as plain text.
"""

from __future__ import annotations

import errno
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from identification.errors import RecordingError
from identification.recordings import read_recording, write_recording
from identification.recordings.labels import label_by_time
from tests.identification.recording_files import JOINTS, ROWS, STEP, refused, save_csv, save_npz, whole_arrays

# --- what comes through ------------------------------------------------------------------------------------------


def test_npz_arrays_come_through_bit_by_bit(tmp_path: Path) -> None:
    arrays = whole_arrays()
    optional = {name: np.random.default_rng(3).normal(size=(ROWS, JOINTS)) for name in ("dq", "q_cmd", "tau_ext")}
    optional["dq"] = 2.0 * np.cos(2.0 * arrays["t"][:, None] + np.arange(JOINTS))
    recording = read_recording(save_npz(tmp_path / "a.npz", **arrays, **optional, robot="iiwa14"))
    np.testing.assert_array_equal(recording.time, arrays["t"])
    np.testing.assert_array_equal(recording.position, arrays["q"])
    np.testing.assert_array_equal(recording.torque, arrays["tau"])
    np.testing.assert_array_equal(recording.velocity, optional["dq"])
    np.testing.assert_array_equal(recording.command_position, optional["q_cmd"])
    np.testing.assert_array_equal(recording.external_torque, optional["tau_ext"])
    assert recording.robot == "iiwa14"
    assert recording.report.findings == ()
    assert not recording.is_periodic


def test_csv_equals_npz(tmp_path: Path) -> None:
    arrays = whole_arrays()
    from_csv = read_recording(save_csv(tmp_path / "a.csv", arrays, head="# robot=iiwa7\n# period_s=1.0\n"))
    from_npz = read_recording(save_npz(tmp_path / "a.npz", **arrays, robot="iiwa7", period_s=1.0))
    for name in ("time", "position", "torque", "period_index", "sample_in_period"):
        np.testing.assert_array_equal(getattr(from_csv, name), getattr(from_npz, name))
    assert from_csv.robot == from_npz.robot == "iiwa7"


def test_period_labels_follow_the_stated_period(tmp_path: Path) -> None:
    recording = read_recording(save_npz(tmp_path / "a.npz", **whole_arrays(), period_s=1.0))
    assert recording.samples_per_period == 200
    assert recording.complete_periods == 3
    np.testing.assert_array_equal(recording.sample_in_period, np.arange(ROWS) % 200)


def test_period_of_zero_or_longer_than_the_recording_means_not_periodic(tmp_path: Path) -> None:
    assert not read_recording(save_npz(tmp_path / "a.npz", **whole_arrays(), period_s=0.0)).is_periodic
    long = read_recording(save_npz(tmp_path / "b.npz", **whole_arrays(), period_s=100.0))
    assert not long.is_periodic
    assert long.report.of_kind("short_of_a_period")


@settings(max_examples=50, deadline=None)
@given(st.integers(2, 50), st.integers(2, 200), st.floats(0.0, 0.3), st.integers(0, 2**31))
def test_labels_survive_jitter_below_half_a_step(periods: int, samples: int, jitter: float, seed: int) -> None:
    generator = np.random.default_rng(seed)
    place = np.arange(periods * samples)
    time = (place + jitter * generator.uniform(-1.0, 1.0, place.size)) * 0.01
    time -= time[0]
    period, sample, per_period = label_by_time(time, samples * 0.01, 0.01)
    assert per_period == samples
    if jitter < 0.2:
        np.testing.assert_array_equal(period, place // samples)
        np.testing.assert_array_equal(sample, place % samples)
    labelled = period >= 0
    pairs = period[labelled] * samples + sample[labelled]
    assert np.unique(pairs).size == pairs.size


def test_a_header_that_counts_from_zero_loses_no_joint(tmp_path: Path) -> None:
    """q0 was no column, so the joint behind it was missing, and the numbers of the others were one too small."""
    arrays = whole_arrays()
    names = ["t", *(f"{name}{joint}" for name in ("q", "tau") for joint in range(JOINTS))]
    rows = np.column_stack([arrays["t"], arrays["q"], arrays["tau"]])
    lines = [",".join(names), *(",".join(repr(float(value)) for value in row) for row in rows)]
    (tmp_path / "a.csv").write_text("\n".join(lines))
    recording = read_recording(tmp_path / "a.csv")
    np.testing.assert_array_equal(recording.position, arrays["q"])
    np.testing.assert_array_equal(recording.torque, arrays["tau"])


def test_a_unit_of_something_else_is_no_reason_to_refuse(tmp_path: Path) -> None:
    time = np.arange(400) * 0.01
    motion = np.column_stack([np.sin(time), np.cos(time)])
    np.savez(tmp_path / "a.npz", t=time, q=motion, tau=motion, control_unit="KRC4")
    assert read_recording(tmp_path / "a.npz").samples == 400


@pytest.mark.parametrize("name", ["q_units", "tau_units", "units", "torque_unit"])
def test_a_unit_stated_under_another_name_is_refused_and_not_passed_over(tmp_path: Path, name: str) -> None:
    refused(save_npz(tmp_path / "a.npz", **whole_arrays(), **{name: "deg"}), name, "q_unit")
    refused(save_csv(tmp_path / "a.csv", whole_arrays(), f"# {name}: deg\n"), name, "q_unit")


# --- what is found and left out ----------------------------------------------------------------------------------


def test_non_finite_rows_are_left_out_with_their_place(tmp_path: Path) -> None:
    arrays = whole_arrays()
    arrays["q"][99, 1] = np.nan
    arrays["tau"][299, 0] = np.inf
    recording = read_recording(save_npz(tmp_path / "a.npz", **arrays))
    (finding,) = recording.report.of_kind("garbled_rows")
    assert (finding.first_row, finding.last_row, finding.count) == (100, 300, 2)
    assert recording.samples == ROWS - 2
    (gap,) = recording.report.of_kind("gap")
    assert gap.count == 2
    assert "2 samples missing, 2 of them rows that were left out;" in gap.sentence  # the file itself misses none


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.sets(st.integers(5, ROWS - 6), min_size=1, max_size=12), st.floats(3.0, 1e6), st.booleans())
def test_lone_wild_values_are_found_exactly(tmp_path: Path, rows: set[int], size: float, in_torque: bool) -> None:
    chosen = sorted(rows)
    lone = [row for index, row in enumerate(chosen) if index == 0 or row - chosen[index - 1] > 5]
    arrays = whole_arrays()
    arrays["tau" if in_torque else "q"][lone, 1] += 10.0 * size if in_torque else size
    recording = read_recording(save_npz(tmp_path / "a.npz", **arrays))
    (finding,) = recording.report.of_kind("garbled_rows")
    assert finding.count == len(lone)
    assert (finding.first_row, finding.last_row) == (lone[0] + 1, lone[-1] + 1)
    kept = np.delete(np.arange(ROWS), lone)
    np.testing.assert_array_equal(recording.time, arrays["t"][kept])


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(0, 2**31), st.floats(0.0, 2.0))
def test_clean_noisy_motion_loses_no_row(tmp_path: Path, seed: int, noise: float) -> None:
    arrays = whole_arrays()
    generator = np.random.default_rng(seed)
    arrays["tau"] = arrays["tau"] + generator.normal(scale=noise, size=arrays["tau"].shape)
    arrays["tau"] += np.sign(np.cos(2.0 * arrays["t"]))[:, None]
    arrays["q"] = arrays["q"] + generator.normal(scale=1e-5, size=arrays["q"].shape)
    assert read_recording(save_npz(tmp_path / "a.npz", **arrays)).samples == ROWS


def test_repeated_stamps_and_steps_back_are_left_out(tmp_path: Path) -> None:
    arrays = whole_arrays()
    arrays["t"][50] = arrays["t"][49]
    arrays["t"][200] = arrays["t"][190]
    recording = read_recording(save_npz(tmp_path / "a.npz", **arrays))
    assert recording.report.of_kind("repeated_rows")[0].first_row == 51
    assert recording.report.of_kind("time_backwards")[0].first_row == 201
    assert np.all(np.diff(recording.time) > 0.0)


@pytest.mark.parametrize("off", [0.0, 0.0021])
def test_a_clock_that_is_set_back_leaves_a_gap_and_no_leap(tmp_path: Path, off: float) -> None:
    """Truth: of 0.25 s that come twice, both times are left out; then no step in time holds two moments' motion."""
    arrays = whole_arrays()
    arrays["t"][300:] -= 0.25 + off
    recording = read_recording(save_npz(tmp_path / "a.npz", **arrays))
    before, behind = recording.report.of_kind("time_backwards")
    assert (before.first_row, before.last_row) == (251, 300)
    assert behind.first_row == 301
    assert recording.report.of_kind("gap")[0].count == 1
    steps = np.diff(recording.time)
    leaps = np.abs(np.diff(recording.position, axis=0)).max(axis=1)
    assert np.all(leaps[steps < 1.5 * STEP] < 2.0 * 1.01 * STEP)


def test_rows_that_come_late_cost_no_others(tmp_path: Path) -> None:
    arrays = whole_arrays()
    order = np.arange(ROWS)
    order[100:110] = [106, 107, 108, 109, 100, 101, 102, 103, 104, 105]
    recording = read_recording(save_npz(tmp_path / "a.npz", **{name: values[order] for name, values in arrays.items()}))
    assert recording.samples == ROWS - 6


def test_one_wild_stamp_costs_one_row(tmp_path: Path) -> None:
    arrays = whole_arrays()
    arrays["t"][300] = 1e9
    recording = read_recording(save_npz(tmp_path / "a.npz", **arrays))
    assert recording.samples == ROWS - 1
    assert recording.report.of_kind("garbled_rows")[0].first_row == 301


def test_held_samples_in_motion_are_left_out_but_rest_is_kept(tmp_path: Path) -> None:
    arrays = whole_arrays()
    for name in ("q", "tau"):
        arrays[name][101:104] = arrays[name][100]
        arrays[name][400:] = arrays[name][400]
    recording = read_recording(save_npz(tmp_path / "a.npz", **arrays))
    (finding,) = recording.report.of_kind("repeated_rows")
    assert (finding.first_row, finding.last_row, finding.count) == (102, 104, 3)
    assert recording.samples == ROWS - 3


def test_gaps_and_jitter_are_reported_with_their_size(tmp_path: Path) -> None:
    arrays = whole_arrays()
    keep = np.ones(ROWS, dtype=np.bool_)
    keep[100:120] = False
    arrays = {name: values[keep] for name, values in arrays.items()}
    arrays["t"] = arrays["t"] + np.random.default_rng(1).uniform(0.0, 0.2 * STEP, arrays["t"].size)
    arrays["q"] = np.sin(2.0 * arrays["t"][:, None] + np.arange(JOINTS))  # sampled when it was stamped
    recording = read_recording(save_npz(tmp_path / "a.npz", **arrays))
    (gap,) = recording.report.of_kind("gap")
    assert (gap.first_row, gap.last_row, gap.count) == (100, 101, 1)
    assert "20 samples missing;" in gap.sentence
    assert gap.sentence.startswith("1 gap longer than")
    assert recording.report.of_kind("jitter")


def test_second_encoder_of_zeros_is_no_encoder(tmp_path: Path) -> None:
    arrays = whole_arrays()
    link = arrays["q"].copy()
    link[:, 2] = 0.0
    recording = read_recording(save_npz(tmp_path / "a.npz", **arrays, q_link=link))
    assert recording.link_position is not None
    assert np.isnan(recording.link_position[:, 2]).all()
    assert recording.report.of_kind("no_second_encoder")[0].joint == 3


# --- imports as logs ---------------------------------------------------------------------------------------------


def test_an_import_is_read_back_bit_by_bit(tmp_path: Path) -> None:
    arrays = whole_arrays()
    arrays["t"] = arrays["t"] - 1.2345678901234
    arrays["q"][50] = np.nan
    extra = {"q_link": arrays["q"] + 1e-3, "temperature": 30.0 + arrays["q"], "dq": arrays["q"] * 2.0}
    recording = read_recording(save_npz(tmp_path / "a.npz", **arrays, **extra, period_s=1.0, robot="iiwa14"))
    again = read_recording(write_recording(recording, tmp_path / "a.mcap"))
    for name in (
        "time", "position", "torque", "velocity", "link_position", "temperature", "period_index", "sample_in_period",
    ):  # fmt: skip
        np.testing.assert_array_equal(getattr(again, name), getattr(recording, name))
    assert again.report == recording.report
    assert again.period_s == recording.period_s
    assert again.source.sha256 == recording.source.sha256
    assert again.robot == "iiwa14"


def test_arrays_that_lie_column_by_column_are_imported_alike(tmp_path: Path) -> None:
    """As a MATLAB file's do, or a transposed array's: numpy stores them so."""
    arrays = {name: np.asfortranarray(values) for name, values in whole_arrays().items()}
    source = save_npz(tmp_path / "a.npz", **arrays, dq=2.0 * arrays["q"])
    again = read_recording(write_recording(read_recording(source), tmp_path / "a.mcap"))
    np.testing.assert_array_equal(again.position, arrays["q"])
    np.testing.assert_array_equal(again.torque, arrays["tau"])


def test_an_import_keeps_finding_its_robot_beside_it(tmp_path: Path) -> None:
    (tmp_path / "data").mkdir()
    (tmp_path / "logs").mkdir()
    (tmp_path / "data" / "arm.urdf").write_text("<robot name='arm'/>")
    recording = read_recording(save_npz(tmp_path / "data" / "a.npz", **whole_arrays(), robot="arm.urdf"))
    again = read_recording(write_recording(recording, tmp_path / "logs" / "a.mcap"))
    assert again.robot is not None
    assert Path(again.robot).resolve() == (tmp_path / "data" / "arm.urdf").resolve()


def test_a_file_that_may_not_be_read_says_so_without_a_number(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> str:
        raise PermissionError(errno.EACCES, "Permission denied", "log.csv")

    (tmp_path / "log.csv").write_text("t,q1,tau1\n")
    monkeypatch.setattr(Path, "read_text", refuse)
    with pytest.raises(RecordingError, match=r"cannot be read as text \(Permission denied\)"):
        read_recording(tmp_path / "log.csv")
