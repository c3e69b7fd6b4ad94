"""Claims about the command `import` and about what no command may do: write over a recording.

Truth: the bytes of the files before and after.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from daemon.cli.app import app
from daemon.cli.protection import is_recording
from identification.errors import RecordingError
from identification.recordings import read_recording
from tests.identification.bags import messages_of, write_bag, write_mcap

IIWA = [f"A{joint}" for joint in range(1, 8)]
TIME = np.arange(400) * 0.005
POSITION = np.sin(2.0 * TIME[:, None] + np.arange(7))
TORQUE = 10.0 * np.cos(2.0 * TIME[:, None] + np.arange(7))


def call(*words: Any) -> Result:
    return CliRunner().invoke(app, [str(word) for word in words])


def save(path: Path, **changes: Any) -> Path:
    np.savez(path, **{"t": TIME, "q": POSITION, "tau": TORQUE, "robot": "iiwa14", **changes})
    return path


def save_csv(path: Path) -> Path:
    columns = ["t", *(f"q{j}" for j in range(1, 8)), *(f"tau{j}" for j in range(1, 8))]
    np.savetxt(path, np.column_stack([TIME, POSITION, TORQUE]), delimiter=",", header=",".join(columns), comments="")
    return path


def robots_log(path: Path) -> Path:
    """Stands for any log that is not an import: a bag that someone recorded."""
    return write_mcap(path, messages_of(TIME, IIWA, POSITION, TORQUE))


def test_an_import_never_writes_over_a_robots_log(tmp_path: Path) -> None:
    log, other = robots_log(tmp_path / "recording.mcap"), save(tmp_path / "recording.npz")
    before = log.read_bytes()
    for words in (["--out", log], [], ["--force"], ["--out", log, "--force"]):
        result = call("import", other, *words)
        assert result.exit_code == 2
        assert "not written over" in result.output
    assert log.read_bytes() == before


def test_an_earlier_import_is_written_over_only_when_asked(tmp_path: Path) -> None:
    source, log = save(tmp_path / "a.npz"), tmp_path / "a.mcap"
    assert call("import", source).exit_code == 0
    before = log.read_bytes()
    save(source, tau=2.0 * TORQUE)
    result = call("import", source)
    assert result.exit_code == 2
    assert "--force" in result.output
    assert log.read_bytes() == before
    assert call("import", source, "--force").exit_code == 0
    np.testing.assert_array_equal(read_recording(log).torque, 2.0 * TORQUE)
    assert call("import", log, "--out", log, "--force").exit_code == 2


def test_force_writes_over_nothing_else(tmp_path: Path) -> None:
    source, note = save(tmp_path / "a.npz"), tmp_path / "a.mcap"
    note.write_text("a note that is not a log")
    assert call("import", source, "--force").exit_code == 2
    assert note.read_text() == "a note that is not a log"


def test_two_inputs_never_become_one_file(tmp_path: Path) -> None:
    files = [save(tmp_path / "a.npz"), save_csv(tmp_path / "a.csv")]
    result = call("import", *files)
    assert result.exit_code == 2
    assert "a.mcap" in result.output
    assert not (tmp_path / "a.mcap").exists()
    assert call("import", files[0], files[0]).exit_code == 2


@pytest.mark.parametrize(
    ("command", "option"),
    [
        (["fit", "IN"], "--out"), (["fit", "IN"], "--report"), (["fit", "IN"], "--json"),
        (["simulate", "model.json"], "--out"), (["simulate", "model.json"], "--figure"),
        (["export", "model.json", "--format", "urdf"], "--out"), (["design"], "--out"),
        (["validate", "model.json", "IN"], "--json"),
    ],
)  # fmt: skip
def test_no_command_writes_over_a_recording(tmp_path: Path, command: list[str], option: str) -> None:
    source = save(tmp_path / "in.npz")
    words = [str(source) if word == "IN" else word for word in command]
    for log in (robots_log(tmp_path / "log.mcap"), save(tmp_path / "b.npz"), save_csv(tmp_path / "c.csv")):
        before = log.read_bytes()
        result = call(*words, option, log)
        assert result.exit_code == 2
        assert "is a recording" in result.output
        assert log.read_bytes() == before


def test_what_is_a_recording_is_seen_by_its_contents(tmp_path: Path) -> None:
    (database,) = write_bag(tmp_path / "bag", messages_of(TIME, IIWA, POSITION, TORQUE)).glob("*.db3")
    named_otherwise = tmp_path / "measured.dat"
    named_otherwise.write_bytes(robots_log(tmp_path / "log.mcap").read_bytes())
    from_zero = tmp_path / "one_joint.csv"
    from_zero.write_text("t,q0,tau0\n0,1,2\n")
    for file in (database, named_otherwise, save(tmp_path / "a.npz"), save_csv(tmp_path / "a.csv"), from_zero):
        assert is_recording(file)
    np.savez(tmp_path / "series.npz", time=TIME, simulated_torque=TORQUE)
    (tmp_path / "table.csv").write_text("t,q1,q2\n0,1,2\n")
    (tmp_path / "model.json").write_text("{}")
    for name in ("series.npz", "table.csv", "model.json", "nothing.mcap"):
        assert not is_recording(tmp_path / name)


def test_units_are_stated_where_the_file_does_not(tmp_path: Path) -> None:
    source = save(tmp_path / "a.npz", q=np.rad2deg(POSITION), t=1e3 * TIME)
    refused = call("import", source).exception
    assert isinstance(refused, RecordingError)
    assert refused.exit_code == 65
    assert "--unit q=deg --unit t=ms" in str(refused)
    assert call("import", source, "--unit", "q=deg", "--unit", "t=ms").exit_code == 0
    recording = read_recording(tmp_path / "a.mcap")
    np.testing.assert_allclose(recording.position, POSITION, atol=1e-12)
    np.testing.assert_allclose(recording.time, TIME, atol=1e-12)
    assert call("import", source, "--unit", "q=feet", "--force").exit_code == 2
    assert call("import", source, "--unit", "degrees", "--force").exit_code == 2
    assert call("import", source, "--unit", "t=s", "--unit", "t=ms", "--force").exit_code == 2
