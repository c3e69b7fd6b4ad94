"""Claims about where a recording may lie: bags of ROS 2 as folders and databases, folders of runs.

Truth: the same messages, packed by rosbags into each form.
"""

from __future__ import annotations

import shutil
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from identification.audit.trend import date_of
from identification.errors import RecordingError
from identification.recordings import read_recording, write_recording
from identification.recordings.bag import MOST_ENTRIES, bag_files
from identification.recordings.reader import file_digest, recording_file
from tests.identification.bags import JointMessage, messages_of, write_bag, write_mcap

NAMES = [f"A{joint}" for joint in range(1, 8)]
ROWS = 400
TIME = 3.0 + np.arange(ROWS) * 0.005
POSITION = np.sin(2.0 * TIME[:, None] + np.arange(7))
TORQUE = 10.0 * np.cos(2.0 * TIME[:, None] + np.arange(7))


@pytest.fixture(scope="module")
def messages() -> list[JointMessage]:
    return messages_of(TIME, NAMES, POSITION, TORQUE)


def assert_whole(path: Path) -> None:
    recording = read_recording(path, robot="iiwa14")
    np.testing.assert_array_equal(recording.position, POSITION)
    np.testing.assert_array_equal(recording.torque, TORQUE)
    np.testing.assert_allclose(recording.time, TIME - TIME[0], atol=1e-9)


FORMS = [(storage, compression) for storage in StoragePlugin for compression in (None, CompressionMode.FILE)]
FORMS.append((StoragePlugin.SQLITE3, CompressionMode.MESSAGE))
"""rosbag2 knows no messages compressed one by one in MCAP."""


@pytest.mark.parametrize(("storage", "compression"), FORMS)
def test_every_form_of_a_bag_holds_the_same_rows(
    tmp_path: Path, messages: list[JointMessage], storage: StoragePlugin, compression: CompressionMode | None
) -> None:
    folder = write_bag(tmp_path / "bag", messages, storage=storage, compression=compression)
    assert_whole(folder)
    (file,) = bag_files(folder)
    if compression is None:
        assert_whole(file)
        assert read_recording(folder).source.sha256 == read_recording(file).source.sha256 == file_digest(file)
    (folder / "metadata.yaml").unlink()
    assert_whole(folder)


@pytest.mark.parametrize("storage", StoragePlugin)
def test_the_date_of_a_bag_is_the_recorders_start(tmp_path: Path, storage: StoragePlugin) -> None:
    """A series of ROS bags had no dates. A simulator's clock, which counts from zero, is none."""
    begun = datetime(2025, 6, 1, 12, 30, tzinfo=UTC)
    dated = messages_of(begun.timestamp() + TIME[:200] - TIME[0], NAMES, POSITION[:200], TORQUE[:200], stamped=False)
    assert date_of(read_recording(write_bag(tmp_path / "a", dated, storage=storage), robot="iiwa14")) == begun
    simulated = messages_of(TIME[:200], NAMES, POSITION[:200], TORQUE[:200])
    assert date_of(read_recording(write_bag(tmp_path / "b", simulated, storage=storage), robot="iiwa14")) is None


def test_the_files_of_a_split_bag_are_read_in_the_order_of_their_numbers(
    tmp_path: Path, messages: list[JointMessage]
) -> None:
    folder = tmp_path / "bag"
    folder.mkdir()
    pieces = np.array_split(np.arange(ROWS), 12)
    for number, piece in enumerate(pieces):
        write_mcap(folder / f"bag_{number}.mcap", [messages[row] for row in piece])
    assert_whole(folder)


def test_the_folder_of_a_run_is_its_recording(tmp_path: Path, messages: list[JointMessage]) -> None:
    log = write_mcap(tmp_path / "recording.mcap", messages)
    (tmp_path / "run.json").write_text("{}")
    assert recording_file(tmp_path) == log
    assert_whole(tmp_path)
    assert read_recording(tmp_path).source.sha256 == read_recording(log).source.sha256


def test_a_run_in_parts_is_not_read_in_part(tmp_path: Path, messages: list[JointMessage]) -> None:
    write_mcap(tmp_path / "recording.mcap", messages[:200])
    write_mcap(tmp_path / "recording.part1.mcap", messages[200:])
    with pytest.raises(RecordingError, match="iiwa-ident recover"):
        read_recording(tmp_path)
    shutil.move(tmp_path / "recording.mcap", tmp_path / "recording.broken.mcap")
    write_mcap(tmp_path / "recording.mcap", messages)
    assert_whole(tmp_path)


def test_other_folders_and_databases_are_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="neither"):
        read_recording(tmp_path)
    (tmp_path / "a.db3").write_bytes(b"no database")
    with pytest.raises(RecordingError, match=r"a\.db3"):
        read_recording(tmp_path / "a.db3")
    other = write_bag(tmp_path / "empty", [])
    with pytest.raises(RecordingError, match="neither"):
        read_recording(other)


def test_a_database_that_breaks_off_gives_its_rows_or_an_error(tmp_path: Path, messages: list[JointMessage]) -> None:
    (file,) = bag_files(write_bag(tmp_path / "bag", messages))
    data = file.read_bytes()
    for share in (0.3, 0.6, 0.9):
        file.write_bytes(data[: int(share * len(data))])
        try:
            recording = read_recording(file, robot="iiwa14")
        except RecordingError:
            continue
        assert recording.samples < ROWS
        assert recording.report.of_kind("truncated_file")
        np.testing.assert_array_equal(recording.position, POSITION[: recording.samples])


def test_an_import_of_a_bag_is_the_bag(tmp_path: Path, messages: list[JointMessage]) -> None:
    folder = write_bag(tmp_path / "bag", messages)
    assert_whole(write_recording(read_recording(folder, robot="iiwa14"), tmp_path / "import.mcap"))


def test_a_folder_of_other_things_is_refused_before_it_is_read(tmp_path: Path) -> None:
    """Runs of a day side by side, or somebody's downloads, are not one recording."""
    for name in ("monday.mcap", "tuesday_0.mcap", "tuesday_1.mcap"):
        (tmp_path / name).write_bytes(b"never read")
    with pytest.raises(RecordingError, match=r"3 logs of different names \(monday, tuesday"):
        read_recording(tmp_path, robot="iiwa14")
    crowd = tmp_path / "crowd"
    crowd.mkdir()
    for number in range(MOST_ENTRIES + 1):
        (crowd / str(number)).touch()
    with pytest.raises(RecordingError, match=f"more than {MOST_ENTRIES} files"):
        recording_file(crowd)


def test_a_clock_that_is_set_back_in_a_bag_leaves_a_gap_and_mixes_no_moments(tmp_path: Path) -> None:
    time = TIME.copy()
    time[250:] -= 0.1521
    file = write_mcap(tmp_path / "a.mcap", messages_of(time, NAMES, POSITION, TORQUE))
    recording = read_recording(file, robot="iiwa14")
    assert not recording.report.of_kind("late_messages")
    assert [item.first_row for item in recording.report.of_kind("time_backwards")] == [221, 251]
    rows = [int(np.flatnonzero((position == POSITION).all(axis=1))[0]) for position in recording.position]
    assert np.all(np.diff(rows) > 0)
