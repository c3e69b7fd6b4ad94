"""Claims about recordings that cannot be read, or only in part: what is said of them, and what is lost."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from identification.errors import RecordingError, RecordingNotFoundError
from identification.recordings import read_recording
from identification.recordings.reader import robot_of
from tests.identification.recording_files import JOINTS, ROWS, refused, save_csv, save_npz, whole_arrays


def test_last_line_broken_off_costs_one_row(tmp_path: Path) -> None:
    path = save_csv(tmp_path / "a.csv", whole_arrays())
    path.write_text(path.read_text()[:-30])
    recording = read_recording(path)
    assert recording.samples == ROWS - 1
    assert recording.report.of_kind("truncated_row")


# --- what is refused ---------------------------------------------------------------------------------------------


def test_missing_file_ends_with_66(tmp_path: Path) -> None:
    with pytest.raises(RecordingNotFoundError) as caught:
        read_recording(tmp_path / "none.npz")
    assert caught.value.exit_code == 66


def test_other_suffixes_and_other_contents_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.bag").write_bytes(b"x")
    refused(tmp_path / "a.bag", ".bag", ".npz")
    for name in ("a.npz", "a.mcap"):
        (tmp_path / name).write_bytes(b"this is neither")
        refused(tmp_path / name, name)
    (tmp_path / "a.csv").write_bytes(bytes(range(256)))
    refused(tmp_path / "a.csv", "a.csv")


@pytest.mark.parametrize("name", ["t", "q", "tau"])
def test_missing_field_is_named(tmp_path: Path, name: str) -> None:
    arrays = whole_arrays()
    del arrays[name]
    assert refused(save_npz(tmp_path / "a.npz", **arrays), f"'{name}'").field == name


def test_wrong_shapes_are_named(tmp_path: Path) -> None:
    arrays = whole_arrays()
    refused(save_npz(tmp_path / "a.npz", **{**arrays, "q": arrays["q"][:-1]}), "q has shape")
    refused(save_npz(tmp_path / "b.npz", **{**arrays, "tau": arrays["tau"][:, :2]}), "tau has 2")
    refused(save_npz(tmp_path / "c.npz", **{**arrays, "t": arrays["t"][:, None]}), "t has shape")
    refused(save_npz(tmp_path / "d.npz", **{**arrays, "dq": arrays["q"][:, :2]}), "velocity")
    refused(save_npz(tmp_path / "e.npz", **{**arrays, "q": arrays["q"].astype(str)}), "'q'")


def test_letters_in_many_rows_of_a_csv_are_named_by_line_and_column(tmp_path: Path) -> None:
    path = save_csv(tmp_path / "a.csv", whole_arrays())
    lines = path.read_text().splitlines()
    for index in range(17, len(lines), 3):
        cells = lines[index].split(",")
        cells[1 + JOINTS] = "abc"
        lines[index] = ",".join(cells)
    path.write_text("\n".join(lines))
    assert refused(path, "line 18", "'tau1'", "'abc'").field == "tau1"


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ("abc", "line 18: 1 columns where the header has"),
        ("{}x", f"line 18, column 'tau{JOINTS}': "),
        ("{},7", "line 18: "),
        ("t{}", "line 18, column 't': "),
    ],
)
def test_a_garbled_line_of_a_csv_costs_itself_and_is_named(tmp_path: Path, row: str, said: str) -> None:
    """As a logger leaves it that was disturbed in the middle of a line, or that wrote its header once more."""
    path = save_csv(tmp_path / "a.csv", whole_arrays())
    lines = path.read_text().splitlines()
    lines[17] = row.format(lines[17])
    path.write_text("\n".join(lines))
    recording = read_recording(path)
    assert recording.samples == ROWS - 1
    (unreadable,) = recording.report.of_kind("unreadable_rows")
    assert (unreadable.first_row, unreadable.last_row, unreadable.count) == (17, 17, 1)
    assert unreadable.sentence.startswith(said)
    (left_out,) = recording.report.of_kind("garbled_rows")
    assert left_out.first_row == left_out.last_row == 17


@pytest.mark.parametrize("every", [1, 50])
def test_words_in_a_column_that_is_not_read_cost_no_row(tmp_path: Path, every: int) -> None:
    path = save_csv(tmp_path / "a.csv", whole_arrays())
    header, *lines = path.read_text().splitlines()
    remarked = [f"{line},{'' if number % every else 'moving'}" for number, line in enumerate(lines)]
    path.write_text("\n".join([f"{header},remark", *remarked]))
    recording = read_recording(path)
    np.testing.assert_array_equal(recording.torque, whole_arrays()["tau"])
    assert recording.report.findings == ()


def test_csv_without_its_columns_says_which(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("t,q1,q2,tau1\n0,1,2,3\n")
    assert refused(path, "'tau2'").joint == 2
    path.write_text("t,q0,q1,tau1,tau2\n0,1,2,3,4\n")
    refused(path, "'tau0'")  # as the header counts: tau1 is there
    path.write_text("clock,q1,tau1\n0,1,2\n")
    refused(path, "'t'")
    path.write_text("t,q1,tau1\n")
    refused(path, "no rows")
    path.write_text("Zeit;q1;tau1\n0,5;1;2\n")
    refused(path, "t,q1,…,qn,tau1,…,taun is needed, and the header is: Zeit, q1, tau1")
    path.write_text("t,q1,tau1\n0,1,2\n", encoding="utf-16")
    refused(path, "is no text in UTF-8; save it so")


@pytest.mark.parametrize(("separator", "point"), [(";", ","), (";", "."), ("\t", ","), ("\t", ".")])
def test_a_table_of_semicolons_or_tabs_holds_the_same_numbers(tmp_path: Path, separator: str, point: str) -> None:
    """As spreadsheets write it where the comma is the decimal sign; it was refused."""
    path = save_csv(tmp_path / "a.csv", whole_arrays())
    other = path.read_text().replace(",", separator).replace(".", point)
    (tmp_path / "b.csv").write_text(other, encoding="utf-8-sig")
    expected, found = read_recording(path), read_recording(tmp_path / "b.csv")
    for name in ("time", "position", "torque"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


def test_a_tenth_of_a_second_is_too_short(tmp_path: Path) -> None:
    arrays = {name: values[:21] for name, values in whole_arrays().items()}
    refused(save_npz(tmp_path / "a.npz", **arrays), "0.1 s")


def test_time_that_stands_still_or_runs_back_is_refused(tmp_path: Path) -> None:
    arrays = whole_arrays()
    refused(save_npz(tmp_path / "a.npz", **{**arrays, "t": np.ones(ROWS)}), "stands still")
    refused(save_npz(tmp_path / "b.npz", **{**arrays, "t": arrays["t"][::-1]}), "backwards", "row 2")
    restart = np.concatenate([arrays["t"][:300], arrays["t"][:300]])
    refused(save_npz(tmp_path / "c.npz", **{**arrays, "t": restart}), "row 301")


def test_more_bad_rows_than_a_fifth_are_refused(tmp_path: Path) -> None:
    arrays = whole_arrays()
    arrays["tau"][::4] = np.nan
    refused(save_npz(tmp_path / "a.npz", **arrays), f"150 of {ROWS}", "row 1 in tau1, tau2")
    unmeasured = np.where(np.arange(JOINTS) == 3, np.nan, whole_arrays()["tau"])
    refused(
        save_npz(tmp_path / "c.npz", **{**whole_arrays(), "tau": unmeasured}), f"{ROWS} of {ROWS}", "row 1 in tau4)"
    )
    arrays["tau"] = 1e300 * whole_arrays()["tau"]
    refused(save_npz(tmp_path / "b.npz", **arrays), "beyond any number measured")


def test_unknown_units_and_periods_are_refused(tmp_path: Path) -> None:
    refused(save_npz(tmp_path / "a.npz", **whole_arrays(), tau_unit="lbf ft"), "lbf ft")
    refused(save_npz(tmp_path / "b.npz", **whole_arrays(), period_s=-1.0), "-1")
    refused(save_npz(tmp_path / "c.npz", **whole_arrays(), period_s=np.array([1.0, 2.0])), "period_s")


def test_currents_are_read_as_currents(tmp_path: Path) -> None:
    assert read_recording(save_npz(tmp_path / "a.npz", **whole_arrays(), tau_unit="A")).torque_unit == "A"


# --- which robot -------------------------------------------------------------------------------------------------


def test_robot_is_the_files_unless_the_caller_says_otherwise(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text("<robot/>")
    path = save_npz(tmp_path / "a.npz", **whole_arrays(), robot="arm.urdf")
    assert read_recording(path).robot == str(tmp_path / "arm.urdf")
    assert read_recording(path, robot="iiwa14").robot == "iiwa14"


def test_no_robot_or_two_robots_are_said(tmp_path: Path) -> None:
    one = read_recording(save_npz(tmp_path / "a.npz", **whole_arrays(), robot="iiwa14"))
    other = read_recording(save_npz(tmp_path / "b.npz", **whole_arrays(), robot="iiwa7"))
    none = read_recording(save_npz(tmp_path / "c.npz", **whole_arrays()))
    assert robot_of([one]) == "iiwa14"
    spelt = [replace(one, robot=name) for name in ("arm.urdf", "runs/../arm.urdf", str(Path("arm.urdf").resolve()))]
    assert Path(robot_of(spelt)).name == "arm.urdf"  # an import names the file from its own folder
    with pytest.raises(RecordingError, match="--robot"):
        robot_of([none])
    with pytest.raises(RecordingError, match="iiwa7"):
        robot_of([one, other])
