"""Claims about what a reader sees: whole words at any width, colour on a terminal only, every encoding, a closed pipe.

Truth: the words that were given, by `str.split`; Python's own codecs; closed pipes of the operating system.
"""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from daemon.api import RunEvent
from daemon.cli import output, progress
from daemon.cli.output import data, message, prepare_streams, show_table, write_json
from daemon.cli.progress import bar_put_away, progress_shown
from daemon.cli.rms_view import show_rms
from daemon.cli.run_view import run_shown
from daemon.cli.service import show_jobs
from daemon.cli.terminal import wrapped
from daemon.errors import LogIOError, exit_code_of, sentence_of
from daemon.queue.control_api import JobView
from identification.fitting.rms import RmsRow, RmsTable

SENTENCE = (
    "   - Joint 4 shows torque ripple of 0.517 ± 0.004 Nm that repeats 160.0 times per turn; see "
    "/home/lab/runs/2026-11-22/excitation-of-the-left-arm/diagnosis/report.html for more."
)


class Terminal(io.StringIO):
    """A stream that says it is a terminal."""

    encoding = "utf-8"

    def isatty(self) -> bool:
        return True


def on_terminal(monkeypatch: pytest.MonkeyPatch) -> Terminal:
    """A screen 80 wide in the place of both streams; not a fixture, because pytest sets the streams after those."""
    screen = Terminal()
    monkeypatch.setattr(sys, "stdout", screen)
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setenv("COLUMNS", "80")
    return screen


HEADS = ("recording", "1", "2", "what was found")
ROWS = (
    ("excitation/recording.mcap", "0.0931", "-12.0864", "acceleration of joint 3 is within its limit, ok"),
    ("unused/recording.mcap", "0.0590", "0.1", "NOT SAFE"),
)


@pytest.mark.parametrize("width", [20, 60, 80, 120])
def test_no_line_is_broken_inside_a_word(width: int) -> None:
    pieces = wrapped(SENTENCE, width)
    assert " ".join(pieces).split() == SENTENCE.split()
    assert all(len(piece) <= width or len(piece.split()) == 1 for piece in pieces)
    assert all(piece.startswith("   ") for piece in pieces)


@pytest.mark.parametrize("width", [12, 30, 44, 60, 80, 200])
def test_no_table_cuts_a_word(width: int, monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = on_terminal(monkeypatch)
    monkeypatch.setenv("COLUMNS", str(width))
    monkeypatch.setenv("NO_COLOR", "1")
    show_table(HEADS, ROWS)
    words = terminal.getvalue().split()
    for cell in ("excitation/recording.mcap", "-12.0864", "acceleration", "0.0590", "SAFE"):
        assert cell in words
    longest = max(len(line) for line in terminal.getvalue().splitlines())
    assert longest <= max(width, len("excitation/recording.mcap") + 2)


def test_a_piped_table_has_one_line_a_row(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "40")
    show_table(HEADS, ROWS)
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 4
    assert lines[2].endswith("acceleration of joint 3 is within its limit, ok")


def test_a_piped_table_stands_as_a_wide_terminal_draws_it(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rich is the truth here, and no part of a command that draws nothing: it takes longer to load than to fit."""
    show_table(HEADS, ROWS)
    piped = capsys.readouterr().out
    terminal = on_terminal(monkeypatch)
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setenv("NO_COLOR", "1")
    show_table(HEADS, ROWS)
    assert piped == terminal.getvalue()


def test_a_terminal_sees_colour_and_a_log_does_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    terminal = on_terminal(monkeypatch)
    bad, good, doubt = "\x1b[1;31m", "\x1b[32m", "\x1b[33m"
    data("the motion is NOT safe, the check failed")
    assert terminal.getvalue().count(bad) == 2
    data("safe to run")
    assert good in terminal.getvalue()
    data("the name is NOT confirmed")
    assert doubt in terminal.getvalue()
    monkeypatch.setenv("NO_COLOR", "1")
    terminal.truncate(0)
    data("NOT safe")
    assert "\x1b[" not in terminal.getvalue()
    monkeypatch.setattr(sys, "stdout", io.StringIO())
    data("NOT safe")
    assert isinstance(sys.stdout, io.StringIO)
    assert sys.stdout.getvalue() == "NOT safe\n"


@pytest.mark.parametrize(
    ("encoding", "shown"), [("ascii", "sigma 0.1 rad/s^2 +/- 2, ok"), ("latin-1", "sigma 0.1 rad/s² ± 2, ok")]
)
def test_every_encoding_shows_the_result(encoding: str, shown: str, monkeypatch: pytest.MonkeyPatch) -> None:
    raw = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(raw, encoding=encoding))
    prepare_streams()
    data("σ 0.1 rad/s² ± 2, ok")
    assert raw.getvalue().decode(encoding) == shown + "\n"
    show_table(("σ", "what"), [("0.1", "joint 1 → 2 λ …")])
    assert "sigma" in raw.getvalue().decode(encoding)
    assert "joint 1 -> 2 lambda ..." in raw.getvalue().decode(encoding)
    heads, _, row = raw.getvalue().decode(encoding).splitlines()[1:4]
    assert heads.index("what") == row.index("joint")
    start = len(raw.getvalue())
    write_json(Path("-"), {"unit": "rad/s² σ"})
    assert json.loads(raw.getvalue()[start:].decode(encoding)) == {"unit": "rad/s² σ"}


def test_a_reader_that_has_gone_is_no_failure() -> None:
    script = (
        "from daemon.cli.output import data, message, show_table\n"
        "import sys\n"
        "sys.stdin.readline()\n"
        "first = data('x'); show_table(['a'], [['b']]); second = data('y'); message('done')\n"
        "sys.exit(3 if (first, second) == (False, True) else 4)\n"
    )
    reading, writing = os.pipe()
    child = subprocess.Popen(
        [sys.executable, "-c", script], stdin=subprocess.PIPE, stdout=writing, stderr=subprocess.PIPE, text=True
    )
    os.close(writing)
    os.close(reading)  # as `head` does once it has its lines
    _, errors = child.communicate("\n")
    assert child.returncode == 3, errors
    assert errors == "done\n"


def test_a_filter_ends_when_nobody_reads_it() -> None:
    line = "0a080881800d10001801\n"
    reading, writing = os.pipe()
    command = [
        sys.executable,
        "-c",
        "from daemon.cli import main; main()",
        "fri",
        "decode",
        "--fri-version",
        "1.15",
        "--direction",
        "command",
    ]
    child = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=writing, stderr=subprocess.PIPE, text=True)
    os.close(writing)
    os.close(reading)
    assert child.stdin is not None
    child.stdin.write(line)  # and its end of the pipe stays open: a capture that goes on
    child.stdin.flush()
    assert child.wait(600) == 0
    assert child.stderr is not None
    assert child.stderr.read() == ""


def test_the_operating_systems_errors_have_no_number() -> None:
    with pytest.raises(FileNotFoundError) as missing:
        Path("/no/such/folder/model.json").write_text("")
    assert sentence_of(missing.value) == "/no/such/folder/model.json: No such file or directory."
    assert sentence_of(OSError(28, "No space left on device")) == "No space left on device."
    assert sentence_of(ValueError("joint 8 of 7")) == "joint 8 of 7"


def test_a_full_disk_is_named_with_the_file_that_found_no_room(tmp_path: Path) -> None:
    """/dev/full is the kernel's own full disk; its error carries no file. By a link, so that nothing can replace it."""
    full = tmp_path / "found.json"
    full.symlink_to("/dev/full")
    with pytest.raises(LogIOError) as caught:
        write_json(full, {"passed": True})
    assert sentence_of(caught.value) == f"{full}: No space left on device."
    assert exit_code_of(caught.value) == 74


@pytest.mark.parametrize("words", ["", "Unable to allocate 3.64 TiB"])
def test_memory_that_is_not_there_is_no_fault_of_the_program(words: str) -> None:
    assert exit_code_of(MemoryError(words)) == 74
    assert sentence_of(MemoryError(words)).startswith("There is not enough memory for this (")
    assert words in sentence_of(MemoryError(words))


def test_a_log_has_one_line_a_phase_and_a_terminal_a_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = on_terminal(monkeypatch)
    with progress_shown() as show:
        show("least squares", 0.25)
        message("recording.mcap: a gap of 3 ms")
    assert "least squares" in terminal.getvalue()
    assert "25%" in terminal.getvalue()
    assert "recording.mcap: a gap of 3 ms\n" in terminal.getvalue()
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    with progress_shown() as show:
        for text, share in (("least squares", 0.0), ("least squares", 0.2), ("validation", 0.9)):
            show(text, share)
    assert isinstance(sys.stderr, io.StringIO)
    assert sys.stderr.getvalue() == "[  0 %] least squares\n[ 90 %] validation\n"


def test_a_run_says_nothing_twice_on_one_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = on_terminal(monkeypatch)
    sentences = ("All 4 periods were driven.", "The recording has trouble: the disk is slow.")
    events = [RunEvent(kind="warning", sentence=sentences[1]), RunEvent(kind="finished", sentence=sentences[0])]
    with run_shown() as view:
        for event in events:
            view.observe(event)
    view.show_outcome(sentences)
    said = " ".join(terminal.getvalue().split())
    assert [said.count(sentence) for sentence in sentences] == [1, 1]
    monkeypatch.setattr(sys, "stdout", io.StringIO())  # a file holds all of it
    view.show_outcome(sentences)
    assert isinstance(sys.stdout, io.StringIO)
    assert sys.stdout.getvalue().splitlines() == list(sentences)


JOB = JobView(
    job_id="20261122T030440707Z", kind="run", phase="finished", name="excitation [2].json", periods=16,
    sentence="All 16 periods were driven; the arm was stopped by ramp, along its path, in 0.14 s, and then some more.",
    submitted_at="2026-11-22T03:04:40Z", updated_at="2026-11-22T03:09:40Z",
    folder="/var/lib/iiwa-ident/runs/20261122T030440707Z-of-the-left-arm-in-the-cell-by-the-window/part",
)  # fmt: skip


def test_jobs_can_be_copied_and_cut_into_columns(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = on_terminal(monkeypatch)
    show_jobs([JOB])
    assert JOB.folder in [line.strip() for line in terminal.getvalue().splitlines()]
    assert JOB.job_id in terminal.getvalue().split()
    monkeypatch.setattr(sys, "stdout", io.StringIO())
    show_jobs([JOB, JOB])
    assert isinstance(sys.stdout, io.StringIO)
    head, *rows = sys.stdout.getvalue().splitlines()
    assert len(rows) == 2
    assert rows[0].split()[:4] == [JOB.job_id, "run", "finished", "16"]
    assert rows[0].endswith(JOB.folder)
    for name, value in (("phase", "finished"), ("motion", JOB.name), ("folder", JOB.folder)):
        assert rows[0][head.index(name) :].startswith(value)


def test_quiet_is_quiet(capsys: pytest.CaptureFixture[str]) -> None:
    output.set_verbosity(0, True)
    try:
        message("progress")
        with progress_shown() as show:
            show("fit", 0.5)
    finally:
        output.set_verbosity(0, False)
    assert capsys.readouterr().err == ""


def test_no_bar_is_drawn_over_a_question(monkeypatch: pytest.MonkeyPatch) -> None:
    """It was drawn anew twice a second: "Drive it [y/N]" was gone before it could be read."""
    monkeypatch.setattr(sys, "stderr", Terminal())
    with progress_shown() as show:
        show("fit", 0.5)
        (bar,) = progress._shown
        assert bar.live.is_started
        with bar_put_away():
            assert not bar.live.is_started
        assert bar.live.is_started
    assert not progress._shown


def test_a_joint_without_a_torque_of_its_own_has_a_dash_in_the_table(capsys: pytest.CaptureFixture[str]) -> None:
    """One that follows another by a mimic rule: nobody measured it, and nan is no word."""
    numbers = np.array([0.5, np.nan])
    show_rms(RmsTable((RmsRow("fit, base", numbers, 2.0 * numbers, numbers),)), "RMS of torque")
    said = capsys.readouterr().out
    assert said.count("–") == 2
    assert "nan" not in said
