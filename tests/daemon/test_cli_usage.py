"""Claims about values of options that nothing can be done with: exit code 2 before anything is read, as agreed.

A file that an option names and that cannot be used is no usage error: it is missing (66) or a configuration (78).
Nor is a value that only a recording contradicts, such as a joint that it does not hold (65).
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from daemon.cli.protection import not_a_recording
from daemon.errors import LogIOError
from daemon.folders import make_folder
from tests.daemon.command_line import run

RECORDING = str(Path(__file__).parents[2] / "fixtures/recordings/ur10.npz")


@pytest.mark.parametrize(
    "words",
    [
        ["fit", "nowhere.npz", "--hold-out", "the rest"],
        ["fit", "nowhere.npz", "--low-pass", "-5"],
        ["fit", "nowhere.npz", "--low-pass", "inf"],
        ["fit", "nowhere.npz", "--joints", "1,2,2"],
        ["diagnose", "nowhere.npz", "--joints", ","],
        ["import", "nowhere.npz", "--unit", "q=furlong"],
        ["import", "nowhere.npz", "--unit", "speed=rad"],
        ["diagnose", "nowhere.npz", "--split", "the rest"],
        ["check", "--picture", "path.gif"],
        ["check", "--amplitude", "-inf"],
        ["compare", "a.npz", "b.npz", "c.npz", "d.npz", "--hours", "1,2,3,nan"],
        ["compare", "a.npz", "b.npz", "c.npz", "d.npz", "--hours", "1,2,3,-4"],
        ["export", "nowhere.json", "--format", "obj", "--out", "arm.obj"],
        ["export", "nowhere.json", "--format", "urdf", "--parameters", "best", "--out", "arm.urdf"],
        ["simulate", "nowhere.json", "--parameters", "best"],
        ["simulate", "nowhere.json", "--controller", "psychic"],
        ["simulate", "nowhere.json", "--bandwidth", "-1"],
        ["simulate", "nowhere.json", "--controller", "impedance", "--stiffness", "0"],
        ["run", "--no-confirm", "--start-timeout", "inf"],
        ["run", "--no-confirm", "--heldout", "nowhere.mcap"],
        ["investigate", "--budget", "4", "--fri-version", "9", "--out", "question"],
        ["investigate", "--budget", "4", "--done", "turn_tool", "--plan-only", "--out", "question"],
    ],
    ids=" ".join,
)
def test_a_value_that_nothing_can_be_done_with_is_usage(
    words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(*words) == 2
    said = capsys.readouterr()
    assert "Error: Invalid value" in said.err
    assert not said.out
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("held", ["mass: [", "- 1\n", "weight: [0, 1]\n", "mass: [3, 1]\n", "mass: heavy\n", "\xff"])
def test_bounds_that_cannot_be_used_are_a_configuration_and_name_their_file(
    held: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "bounds.yaml"
    file.write_text(held, encoding="latin-1")
    assert run("fit", tmp_path / "nowhere.npz", "--bounds", file) == 78
    assert len(capsys.readouterr().err.strip().splitlines()) == 1
    assert run("fit", tmp_path / "nowhere.npz", "--bounds", tmp_path / "nowhere.yaml") == 66


@pytest.mark.parametrize(
    "words",
    [
        ["fit", RECORDING],
        ["design"],
        ["check"],
        ["run", "--no-confirm"],
        ["run", "--no-confirm", "path.json"],
        ["investigate", "--budget", "5"],
    ],
    ids=lambda words: words[0],
)
def test_a_robot_that_nobody_knows_is_missing_for_every_command(
    words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("path.json").write_text("{}")
    assert run(*words, "--robot", "kuka99") == 66
    assert "There is no robot 'kuka99'" in capsys.readouterr().err


def test_a_held_out_recording_that_is_not_there_is_missing(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("run", "--no-confirm", "--diagnose", "--heldout", "nowhere.mcap") == 66
    assert "nowhere.mcap does not exist" in capsys.readouterr().err


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs a folder in which nobody can make another")
@pytest.mark.parametrize("words", [("run", "--no-confirm"), ("investigate",), ("twin",), ("demo",)], ids=" ".join)
@pytest.mark.parametrize("place", ["/proc/nowhere", "/proc"])
def test_a_folder_in_which_nobody_can_make_a_file_is_no_missing_input(
    words: tuple[str, ...], place: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(*words, "--out", place) == 74
    assert capsys.readouterr().err == f"iiwa-ident: {place}: No such file or directory.\n"


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs a folder in which nobody can make another")
def test_a_folder_that_cannot_be_made_is_no_missing_input(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("check", "--amplitude", "0.1", "--json", "/proc/nowhere/found.json") == 74
    assert "/proc/nowhere/found.json" in capsys.readouterr().err


def test_a_folder_is_made_however_deep_it_lies(tmp_path: Path) -> None:
    deep = make_folder(tmp_path.joinpath(*["d"] * 1200))
    assert deep.is_dir()
    while deep != tmp_path:  # nor could pytest tidy up so deep
        deep.rmdir()
        deep = deep.parent
    (tmp_path / "file").write_text("")
    with pytest.raises(LogIOError, match=r"file/new/folder: Not a directory"):
        make_folder(tmp_path / "file" / "new" / "folder")
    with pytest.raises(LogIOError, match=r"file: File exists"):
        make_folder(tmp_path / "file")


@pytest.mark.parametrize("words", [("watch", "--json"), ("run", "--no-confirm", "--ladder")], ids=" ".join)
def test_frames_and_ladders_are_not_written_into_a_recording(
    words: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "recording.mcap"
    file.write_bytes(b"\x89MCAP0\r\n")
    assert run(*words, file) == 2
    assert "is a recording, and no command writes over one" in capsys.readouterr().err
    assert file.read_bytes() == b"\x89MCAP0\r\n"


def test_a_pipe_is_asked_nothing_before_it_is_written_to(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "frames")
    assert not_a_recording(tmp_path / "frames") == tmp_path / "frames"
