"""Claims about the command line before a command runs: what is listed, what is loaded, what a shell may complete."""

from __future__ import annotations

import importlib
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from typer.main import get_group

from daemon.cli.app import CatalogueGroup, app, main
from daemon.cli.catalogue import COMMANDS, GROUPS

REPOSITORY = Path(__file__).resolve().parents[2]
HEAVY = {
    "clarabel", "coal", "google", "jinja2", "matplotlib", "mcap", "mujoco", "pinocchio", "rosbags", "scipy", "zmq",
}  # fmt: skip
MEASURE = """
import json, runpy, sys
sys.argv = sys.argv[1:]
try:
    {call}
except SystemExit as end:
    assert not end.code
finally:
    print(json.dumps(sorted({{name.split(".")[0] for name in sys.modules}})), file=sys.stderr)
"""
CALL = "from daemon.cli import main; main()"
SIMULATOR = "runpy.run_module('fixtures.fake_robot', run_name='__main__')"


def run(call: str, *words: str, columns: int = 80) -> tuple[str, set[str]]:
    """Standard output of a call, and the top-level modules its process loaded."""
    done = subprocess.run(
        [sys.executable, "-c", MEASURE.format(call=call), "iiwa-ident", *words],
        cwd=REPOSITORY, capture_output=True, text=True, timeout=600, check=True,
        env={**os.environ, "COLUMNS": str(columns)},
    )  # fmt: skip
    return done.stdout, set(json.loads(done.stderr.splitlines()[-1]))


@pytest.fixture(scope="module")
def listed() -> tuple[str, set[str]]:
    return run(CALL, "--help")


def test_the_list_of_commands_loads_none_of_them(listed: tuple[str, set[str]]) -> None:
    _, modules = listed
    assert not modules & (HEAVY | {"numpy", "msgspec", "rich", "identification", "fri_client", "safety"})


@pytest.mark.parametrize("command", sorted(set(COMMANDS) - {"fake-robot"}))
def test_the_help_of_a_command_shows_an_example_and_loads_nothing_it_computes_with(command: str) -> None:
    text, modules = run(CALL, command, "--help")
    assert "Usage: iiwa-ident" in text
    assert f"Example: iiwa-ident {command}" in " ".join(text.split())
    assert not re.search("fore(tell|told|see)", text), "plain words: a model predicts"
    assert not modules & HEAVY


def test_the_fake_robot_is_one_of_the_family_and_its_help_loads_no_simulator() -> None:
    text, modules = run(SIMULATOR, "--help")
    assert text.startswith("Usage: iiwa-ident fake-robot [OPTIONS]")
    assert "Example: iiwa-ident fake-robot" in text
    assert not modules & HEAVY


@pytest.mark.parametrize(
    ("modules", "unneeded"),
    [
        (
            "daemon.motion.preparation, daemon.run.service",
            "scipy.optimize scipy.stats scipy.signal matplotlib mujoco jinja2",
        ),
        ("daemon.run.service", "scipy"),
        ("daemon.run.recorder", "scipy coal pinocchio"),
        ("daemon.run.loop_process", "scipy coal pinocchio zmq mcap"),
        ("fixtures.fake_robot.plant", "glfw"),
        ("identification.recording_fit", "scipy.optimize scipy.stats scipy.signal scipy.interpolate matplotlib"),
        ("identification.interface", "scipy.stats scipy.signal scipy.interpolate mujoco"),
    ],
)
def test_processes_load_nothing_they_do_without(modules: str, unneeded: str) -> None:
    code = f"import {modules}, sys; print(*(set({unneeded.split()}) & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], cwd=REPOSITORY, capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


def test_ruckig_in_a_circle_says_nothing_when_a_command_ends() -> None:
    """A proof of the closed loop ended with a page of "nanobind: leaked" on the terminal."""
    code = (
        "from daemon.circles import look_seldom; import ruckig; look_seldom(); "
        "circle = [ruckig.Ruckig(1, 0.001)]; circle.append(circle)"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=REPOSITORY, capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("", "")


@pytest.mark.parametrize("columns", [60, 80, 200])
def test_every_line_of_the_list_is_whole_at_any_width(columns: int) -> None:
    text, _ = run(CALL, "--help", columns=columns)
    assert "..." not in text.replace("[ARGS]...", "")
    words = " ".join(text.split())
    for title, entries in GROUPS.items():
        assert f"{title}:" in text
        for entry in entries:
            assert f"{entry.name} {entry.line}" in words


def test_a_line_of_the_list_fits_beside_its_name_in_80_columns() -> None:
    longest = max(map(len, COMMANDS))
    assert [entry.name for entry in COMMANDS.values() if longest + len(entry.line) > 74] == []


def test_the_catalogue_names_every_command_that_a_module_registers() -> None:
    for entry in COMMANDS.values():
        importlib.import_module(f"daemon.cli.{entry.module}")
    group = get_group(app)
    assert isinstance(group, CatalogueGroup)
    assert set(group.registered) == set(COMMANDS)


def test_a_mistyped_command_is_answered_with_the_nearest() -> None:
    done = subprocess.run(
        [sys.executable, "-c", CALL, "diagnos"],
        cwd=REPOSITORY, capture_output=True, text=True, timeout=600, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert "'diagnose'" in done.stderr


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        (["fe"], ["feasibility"]),
        (["fit", "--est"], ["--estimator"]),
        (["fit", "--pipeline", "p"], ["periodic", "paper"]),
        (["-q", "fake-robot", "--loc"], ["--lockstep"]),
        (["fake-robot", "--fri-version", "2"], ["2.5", "2.7"]),
    ],
)
def test_a_shell_completes_commands_options_and_values(typed: list[str], offered: list[str]) -> None:
    words = ["iiwa-ident", *typed]
    environment = {
        "_IIWA_IDENT_COMPLETE": "complete_bash", "COMP_WORDS": " ".join(words), "COMP_CWORD": str(len(typed)),
    }  # fmt: skip
    done = subprocess.run(
        [sys.executable, "-c", CALL], cwd=REPOSITORY, capture_output=True, text=True, timeout=600, check=True,
        env={**os.environ, **environment},
    )  # fmt: skip
    assert done.stdout.split() == offered


@pytest.mark.parametrize(
    "words",
    [
        ("check", "--amplitude"),
        ("run", "--amplitude"),
        ("run", "--start-timeout"),
        ("submit", "--amplitude"),
        ("investigate", "--budget"),
        ("submit-investigation", "--budget"),
    ],
)
def test_what_is_no_number_is_a_mistake_of_the_command_line(
    words: tuple[str, ...], capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is no number is neither below nor above any bound: before, it passed all of them."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as end:
        main([*words, "nan"])
    assert end.value.code == 2
    assert "nan is no number." in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
