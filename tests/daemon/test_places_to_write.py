"""Claims about files that a command is told to write: what cannot be written is said before the work and the motion."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from daemon.cli.app import main
from daemon.errors import sentence_of
from tests.ports import free_udp_port
from tests.short_motion import short_trajectory


def run(*words: str) -> int:
    try:
        main(list(words))
    except SystemExit as end:
        return int(end.code or 0)
    return 0


@pytest.mark.parametrize(
    ("words", "option"),
    [
        (["design", "--budget", "3600"], "--out"),
        (["design", "--budget", "3600"], "--json"),
        (["run", "--no-confirm", "--start-timeout", "3600"], "--json"),
        (["check"], "--json"),
    ],
)
@pytest.mark.parametrize("place", ["file/in-the-way.json", "folder"])
def test_what_cannot_be_written_is_said_before_anything_begins(
    words: list[str], option: str, place: str, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("kept")
    (tmp_path / "folder").mkdir()
    if words[0] == "run":
        words = [*words, "--out", "out", "--bind", f"127.0.0.1:{free_udp_port()}"]
    assert run(*words, option, place) == 74
    assert place in capsys.readouterr().err
    assert {file.name for file in tmp_path.iterdir()} == {"file", "folder"}


@pytest.mark.parametrize(
    "words",
    [
        ["diagnose", "nowhere.npz"],
        ["batch", "fit", "nowhere.npz"],
        ["compare", "a.npz", "b.npz", "c.npz", "d.npz"],
        ["twin"],
        ["demo"],
        ["prove", "--cases", "1"],
    ],
    ids=" ".join,
)
@pytest.mark.parametrize("place", ["file", "file/in-the-way"])
def test_a_folder_that_cannot_be_is_said_before_anything_begins(
    words: list[str], place: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("kept")
    assert run(*words, "--out", place) == 74
    assert capsys.readouterr().err == f"iiwa-ident: {place}: Not a directory.\n"
    assert (tmp_path / "file").read_text() == "kept"
    assert {file.name for file in tmp_path.iterdir()} == {"file"}


@pytest.mark.parametrize("command", ["run", "daemon"])
def test_a_folder_whose_name_is_no_text_is_said_before_anything_begins(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Linux takes any bytes for a name; run.json, jobs and answers to clients are UTF-8 and could not name it."""
    odd = tmp_path / os.fsdecode(b"caf\xe9")
    odd.mkdir()
    monkeypatch.chdir(odd)
    port = free_udp_port()
    (tmp_path / "service.yaml").write_text(json.dumps({"fri": {"bind_port": port}}))
    words = {
        "run": [
            str(short_trajectory(tmp_path / "short.json")),
            "--start-timeout",
            "0.1",
            "--bind",
            f"127.0.0.1:{port}",
        ],
        "daemon": ["--config", str(tmp_path / "service.yaml")],
    }[command]
    assert run(command, *words) == 78
    assert "is no UTF-8 text" in capsys.readouterr().err
    assert not list(odd.rglob("*"))


def test_a_folder_that_is_not_there_yet_is_made_for_the_result(tmp_path: Path) -> None:
    file = tmp_path / "new" / "folder" / "found.json"
    assert run("check", str(short_trajectory(tmp_path / "short.json")), "--json", str(file)) == 0
    assert json.loads(file.read_text())["safe"] is True


@pytest.mark.parametrize(
    ("name", "said"),
    [(b"\xc3\x9cbung 1", "behind LC_ALL=C.UTF-8."), (b"caf\xe9", "give that file or folder another name.")],
)
def test_a_name_in_utf8_is_not_blamed_for_the_locale(name: bytes, said: str) -> None:
    """A terminal whose locale is not UTF-8 reads each byte of the first as it reads the last of the second."""
    with pytest.raises(UnicodeEncodeError) as refused:
        name.decode("ascii", "surrogateescape").encode("utf-8")
    assert sentence_of(refused.value).endswith(said)
