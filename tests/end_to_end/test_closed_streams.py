"""Standard streams that are full or closed, and a shell that limits files: exit code 74, and the arm moves as always.

Truth: the contract's exit codes; /dev/full and closed descriptors of the operating system; the fake robot's own count.
"""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest

from tests.end_to_end.processes import COMMAND, fake_robot
from tests.ports import free_udp_port
from tests.short_motion import short_trajectory
from tests.watchdog import WATCHDOG_S


def in_shell(redirections: str, *words: object, before: str = "") -> subprocess.CompletedProcess[str]:
    """`iiwa-ident` with these words, started by a shell with its redirections."""
    script = f'{before} exec "$@" {redirections}'
    command = ["sh", "-c", script, "sh", *COMMAND, *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, timeout=WATCHDOG_S, check=False)


@pytest.mark.parametrize("redirections", [">/dev/full 2>&1", ">&-", "<&- >&- 2>&-"])
def test_a_result_that_nobody_can_get_is_an_input_output_error(redirections: str, tmp_path: Path) -> None:
    done = in_shell(redirections, "check", short_trajectory(tmp_path / "short.json"))
    assert done.returncode == 74
    assert done.stdout == ""
    if "2>" not in redirections:
        assert done.stderr.startswith("iiwa-ident: stdout: ")
        assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize("words", [("--help",), ("--version",), ("list-nothing",)])
@pytest.mark.parametrize("redirections", [">/dev/full", ">&-"])
def test_no_word_of_python_is_shown(redirections: str, words: tuple[str, ...]) -> None:
    done = in_shell(redirections, *words)
    assert done.returncode == (2 if words == ("list-nothing",) else 74)
    assert "Exception" not in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("redirections", ["2>/dev/full", "2>&-"])
def test_an_error_that_nobody_can_read_keeps_its_exit_code(redirections: str, tmp_path: Path) -> None:
    assert in_shell(redirections, "recover", tmp_path / "missing.mcap").returncode == 66


def test_the_arm_moves_as_always_where_nobody_can_be_told(tmp_path: Path) -> None:
    port, out, summary = free_udp_port(), tmp_path / "run", tmp_path / "robot.json"
    motion = short_trajectory(tmp_path / "short.json", period_s=1.0)
    words = ("run", motion, "--bind", f"127.0.0.1:{port}", "--periods", 1, "--no-fit", "--out", out)
    with fake_robot(port, summary, "--lockstep", "--duration", "600"):
        done = in_shell(">/dev/full 2>&1", *words)
    assert done.returncode == 74
    account = json.loads((out / "run.json").read_text())
    assert (account["outcome"], account["exit_code"], account["sequence_gaps"]) == ("completed", 0, 0)
    for redirections in (">/dev/full", ">&-"):
        assert in_shell(redirections, "judge", out).returncode == 74


@pytest.mark.parametrize(("blocks", "sentence"), [(100, "File too large."), (8000, "(ulimit -f)")])
def test_a_shell_that_limits_files_too_much_is_said_before_anything_moves(
    tmp_path: Path, blocks: int, sentence: str
) -> None:
    """In blocks of 512 bytes: too few for the table, and for the samples in memory."""
    motion, bind = short_trajectory(tmp_path / "short.json"), f"127.0.0.1:{free_udp_port()}"
    words = ("run", motion, "--bind", bind, "--periods", 1, "--no-fit", "--out", tmp_path / "run")
    done = in_shell("", *words, before=f"ulimit -f {blocks};")
    assert done.returncode == 74
    assert sentence in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert not list(tmp_path.glob("run/recording*"))
