"""Claims about what an investigation begins with: recordings that it refuses before anything moves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from daemon.errors import ConfigurationError
from daemon.investigate import loop as loop_module
from daemon.investigate.driver import FriDriver
from daemon.investigate.same_arm import refuse_other_arms
from identification.recordings import Recording
from identification.recordings.reader import read_recording
from identification.robots import RobotModel
from tests.daemon.command_line import run
from tests.reference import recording_file


def recording(
    file: Path, seed: int = 0, robot: str | None = "iiwa14", joints: int = 7, period_s: float | None = 1.0
) -> Path:
    time = np.arange(4000) * 1e-3
    q = 0.2 * np.sin(2.0 * np.pi * time[:, None] + np.arange(joints) + seed)
    more = {} if robot is None else {"robot": np.array(robot)}
    if period_s is not None:
        more["period_s"] = np.array(period_s)
    noise = 1e-3 * np.random.default_rng(seed).normal(size=q.shape)  # periods alike to rounding tell none
    np.savez(file, t=time, q=q, tau=q + noise, **more)
    return file


@pytest.mark.parametrize(
    ("words", "code", "sentence"),
    [
        (("--budget", "0.5", "--from", "a.npz", "--from", "b.npz"), 78, "too short"),
        (("--budget", "2", "--from", "missing.npz"), 66, "no such recording"),
        (("--budget", "3", "--from", "a.npz", "--robot", "iiwa7"), 78, "it is of iiwa14"),
        (("--budget", "3", "--from", "nameless.npz"), 65, "does not say which robot it is of; give --robot"),
        (("--budget", "3", "--from", "a.npz", "--from", "seven.npz"), 65, "is of robot iiwa7"),
        (("--budget", "4", "--robot", str(recording_file("med7dock.urdf"))), 78, "motions for an iiwa 14 or 7 only"),
        (("--budget", "3", "--from", "other.npz"), 78, "`iiwa-ident design --robot ur10`"),
        (
            ("--budget", "3", "--from", "a.npz", "--from", "a.npz"),
            65,
            "a recording cannot confirm what was fitted to it",
        ),
        (("--budget", "3", "--from", "six.npz", "--robot", "iiwa14"), 65, "it has 6 joints and iiwa14 has 7"),
        (("--budget", "3", "--from", "once.npz"), 65, "has no periods"),
        (("--budget", "3", "--from", "a.npz", "--added-mass", "two"), 2, "KG@X,Y,Z"),
        (("--budget", "3", "--plan-only", "--added-mass", "2@0,0,50"), 2, "from the flange"),
        (("--budget", "3", "--plan-only", "--added-mass", "2000@0,0,0"), 2, "kg"),
        (("--budget", "2", "--bind", "192.168.1.2:30200", "--yes"), 2, "--yes is for a fake robot"),
        ((), 2, "--budget"),
    ],
)
def test_bad_input_is_one_sentence_and_an_exit_code(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    words: tuple[str, ...],
    code: int,
    sentence: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    recording(tmp_path / "a.npz")
    recording(tmp_path / "b.npz", 1)
    recording(tmp_path / "seven.npz", 1, "iiwa7")
    recording(tmp_path / "other.npz", 1, "ur10")
    recording(tmp_path / "nameless.npz", 1, None)
    recording(tmp_path / "six.npz", 1, None, joints=6)
    recording(tmp_path / "once.npz", 1, period_s=4.0)
    assert run("investigate", *words, "--out", "folder") == code
    assert sentence in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "folder" / "investigation.json").exists()
    assert not list(tmp_path.glob("folder/motion-*"))


def test_recordings_that_name_no_robot_are_of_the_one_of_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def studied(recordings: Sequence[Recording], robot: RobotModel, **_: object) -> None:
        raise ConfigurationError(f"{len(recordings)} recording is studied as one of {robot.name}.")

    monkeypatch.undo()  # the scripted study
    monkeypatch.setattr(loop_module, "study", studied)
    monkeypatch.chdir(tmp_path)
    given = [recording(tmp_path / f"{name}.npz", seed, None) for seed, name in enumerate("ab")]
    words = ("--from", given[0].name, "--from", given[1].name, "--robot", "iiwa14")
    assert run("investigate", *words, "--budget", "3", "--out", "folder", "--plan-only") == 78
    assert "1 recording is studied as one of iiwa14." in capsys.readouterr().err
    # Nor is the arm of an investigation changed by a word.
    assert run("investigate", "--robot", "iiwa7", "--out", "folder", "--plan-only") == 78
    assert "its investigation is of iiwa14; --robot says iiwa7." in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("--serial", "82", "--tool", "2@0,0,0.1"), "its serial is '81'"),
        (("--tool", "none"), "its tool is '2 kg at (0, 0, 0.1) m'"),
        (("--tool", "2@0,0,0.1", "--mount", "wall"), "the arm stood in gravity (0, 0, -9.81) m/s²"),
    ],
)
def test_what_the_recordings_were_not_made_with_is_refused_before_it_moves(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    words: tuple[str, ...],
    sentence: str,
) -> None:
    """A run with a tool of 2 kg on arm 81: a motion without that tool would leave it out of the distances."""

    def drive(*_: object, **__: object) -> None:
        raise AssertionError("a motion was driven")

    def run_of_81(file: str) -> Recording:
        read = read_recording(file)
        return replace(read, source=replace(read.source, metadata={"serial": "81", "tool": "2 kg at (0, 0, 0.1) m"}))

    recording(tmp_path / "a.npz")
    monkeypatch.setattr(loop_module, "read_recording", run_of_81)
    monkeypatch.setattr(FriDriver, "drive", drive)
    monkeypatch.setattr(FriDriver, "objection", lambda *_: "")
    monkeypatch.chdir(tmp_path)
    assert run("investigate", "--from", "a.npz", "--budget", "3", "--out", "folder", "--yes", *words) == 78
    said = " ".join(capsys.readouterr().err.split())
    assert sentence in said
    assert "nothing was moved" in said
    # The same command with what is so goes on.
    words = ("--tool", "2@0,0,0.1", "--mount", "floor", "--serial", "81", "--plan-only")
    assert run("investigate", "--out", "folder", *words) == 0


def test_recordings_of_two_arms_or_tools_are_refused() -> None:
    def of(path: str, **metadata: str) -> Any:
        return SimpleNamespace(source=SimpleNamespace(path=path, metadata=metadata))

    refuse_other_arms([of("a.mcap", serial="81", tool="none"), of("b.mcap", serial="81"), of("c.mcap")])
    with pytest.raises(ConfigurationError, match=r"b\.mcap.*serial is '82'.*a\.mcap is '81'"):
        refuse_other_arms([of("a.mcap", serial="81"), of("b.mcap", serial="82")])
    with pytest.raises(ConfigurationError, match="tool"):
        refuse_other_arms([of("a.mcap", tool="none"), of("b.mcap", tool="2 kg at (0, 0, 0.1) m")])
