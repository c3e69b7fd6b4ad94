"""Claims about who checks a motion of `investigate` before it is driven: the command that drives it, every time.

Truth: a post in the way of the shipped excitation, at the place of the tool's tip that is farthest from its beginning.
"""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from daemon.api import RunOutcome, RunRequest
from daemon.errors import ConfigurationError
from daemon.investigate import driver as driver_module
from daemon.investigate.account import Motion, read_account
from daemon.investigate.driver import FriDriver
from daemon.investigate.states import State
from daemon.json_files import write_json
from daemon.motion import preparation
from daemon.motion.preparation import PreparedMotion, prepare_motion
from daemon.queue.investigation_step import ORDER_NAME, Order
from daemon.stop_handle import StopHandle
from safety.preflight import preflight
from safety.preflight_report import PreflightReport
from tests.daemon.command_line import run
from tests.daemon.scripted_investigation import begun, investigation


@pytest.fixture(scope="module", autouse=True)
def _a_motion_in_a_room_is_looked_at_once() -> Iterator[None]:
    """Most commands here ask for the preflight of the shipped motion, which has one answer in one room."""
    known: dict[bytes, PreflightReport] = {}

    def once(*asked: Any, **more: Any) -> PreflightReport:
        key = pickle.dumps((asked, more))
        if key not in known:
            known[key] = preflight(*asked, **more)
        return known[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(preparation, "preflight", once)
        yield


@pytest.fixture(scope="module")
def motion() -> PreparedMotion:
    return prepare_motion(None)


@pytest.fixture
def post(motion: PreparedMotion, tmp_path: Path) -> Path:
    """A workspace with a post that the whole motion meets and its start ramp does not."""
    tip = motion.surroundings.geometry.tip_path(motion.table)
    there = tip[np.argmax(np.linalg.norm(tip - tip[0], axis=1))]
    file = tmp_path / "post.yaml"
    file.write_bytes(
        msgspec.yaml.encode({"boxes": [{"name": "post", "center_m": there.tolist(), "size_m": [0.06] * 3}]})
    )
    return file


@pytest.fixture(autouse=True)
def _nothing_is_driven(monkeypatch: pytest.MonkeyPatch) -> None:
    def drive(*_: object, **__: object) -> None:
        raise AssertionError("a motion was driven")

    monkeypatch.setattr(driver_module, "run_acquisition", drive)


def investigate(folder: Path, *words: str) -> int:
    return run("investigate", "--out", folder, *words)


def test_a_post_that_is_named_after_the_planning_is_not_driven_into(
    post: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "question"
    assert investigate(folder, "--budget", "4", "--plan-only") == 0
    planned = read_account(folder)
    assert planned is not None
    assert planned.state is State.PLANNED
    assert investigate(folder, "--workspace", str(post), "--yes") == 1
    blocked = read_account(folder)
    assert blocked is not None
    assert blocked.state is State.BLOCKED
    assert "post" in blocked.sentence
    assert "Nothing was moved." in capsys.readouterr().out


def test_a_post_that_was_named_once_stands_there_for_every_later_command(
    post: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "question"
    assert investigate(folder, "--budget", "4", "--workspace", str(post), "--yes") == 1
    capsys.readouterr()
    assert investigate(folder, "--yes") == 1
    blocked = read_account(folder)
    assert blocked is not None
    assert (blocked.state, "post" in blocked.sentence) == (State.BLOCKED, True)
    assert f"Motions are held against workspace {post}." in capsys.readouterr().err


def test_a_tool_that_was_named_once_is_carried_until_it_is_taken_off(tmp_path: Path) -> None:
    folder = tmp_path / "question"
    (tmp_path / "tool.yaml").write_text("{mass_kg: 2.0, center_of_mass_m: [0, 0, 0.1]}\n")

    def tool_of_the_plan(*words: str) -> str | None:
        assert investigate(folder, *words, "--plan-only") == 0
        planned = read_account(folder)
        assert planned is not None
        return planned.cell.tool

    assert tool_of_the_plan("--budget", "4", "--tool", str(tmp_path / "tool.yaml")) == str(tmp_path / "tool.yaml")
    assert tool_of_the_plan() == str(tmp_path / "tool.yaml")
    assert tool_of_the_plan("--tool", "1@0,0,0.1") == "1@0,0,0.1"
    assert tool_of_the_plan("--mount", "ceiling") == "1@0,0,0.1"
    assert tool_of_the_plan("--tool", "none") == "none"


@pytest.mark.parametrize(("left", "code", "sentence"), [("", 78, "has changed since"), (None, 66, "does not exist")])
def test_a_workspace_that_changed_or_went_away_has_to_be_named_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], left: str | None, code: int, sentence: str
) -> None:
    folder, cell = tmp_path / "question", tmp_path / "cell.yaml"
    cell.write_text("floor_height_m: -0.5\n")
    assert investigate(folder, "--budget", "4", "--workspace", str(cell), "--plan-only") == 0
    before = read_account(folder)
    cell.unlink()
    if left is not None:
        cell.write_text(left)
    capsys.readouterr()
    assert investigate(folder, "--yes") == code
    said = " ".join(capsys.readouterr().err.split())
    assert sentence in said
    assert "--workspace" in said
    assert read_account(folder) == before
    cell.write_text(left or "")
    assert investigate(folder, "--workspace", str(cell), "--plan-only") == 0
    assert investigate(folder, "--plan-only") == 0


def test_an_investigation_of_the_service_is_left_to_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Only the service knows its workspace, tool and stand, and what of it waits in its queue."""
    folder = tmp_path / "20261122T170400731Z"
    assert investigate(folder, "--budget", "4", "--plan-only") == 0
    before = read_account(folder)
    write_json(folder / ORDER_NAME, Order(folder=str(folder), robot="iiwa14", workspace_file="cell.yaml"))
    capsys.readouterr()
    for words in (["--yes"], ["--plan-only"], ["--workspace", "other.yaml", "--yes"]):
        assert investigate(folder, *words) == 78
        assert f"--go-on {folder.name}" in " ".join(capsys.readouterr().err.split())
    assert read_account(folder) == before


def test_a_workspace_that_cannot_be_read_begins_nothing(tmp_path: Path) -> None:
    cell = tmp_path / "cell.yaml"
    cell.write_text("{boxes: 3}")
    assert investigate(tmp_path / "question", "--budget", "4", "--workspace", str(cell), "--plan-only") == 78
    assert read_account(tmp_path / "question") is None


@pytest.mark.parametrize("folder", ["motion-01", "motion-01-amplitude-0.25"])
def test_a_motion_of_which_every_process_was_killed_is_latched_as_one_in_which_nobody_saw_the_arm_stop(
    tmp_path: Path, folder: str
) -> None:
    """A recording was begun, no run.json was written. What was killed before a recording began is asked for again."""
    pending = Motion(number=1, kind="k", purpose="to learn", trajectory="t.json", periods=4, seconds=40.0)
    account = begun(tmp_path, state=State.RECORDING, pending=pending, attempts=1, recordings=())
    driver = FriDriver(
        robot="iiwa14", workspace=None, tool=None, added_mass=None, installation=None, settings={}, simulation=True,
        observe=lambda _: None, agree=lambda *_: True,
    )  # fmt: skip
    told: list[str] = []
    never_began = investigation(tmp_path, account, driver, tell=told.append)
    never_began.resume()
    assert never_began.account.state is State.ASKING
    assert told.pop().startswith("Motion 1 (k) was broken off: nothing of its 40 s was recorded.")
    (tmp_path / folder).mkdir()
    (tmp_path / folder / "recording.mcap").write_bytes(b"\x89MCAP0\r\n")
    again = investigation(tmp_path, account, driver, tell=told.append)
    with pytest.raises(ConfigurationError, match="--after-drop"):
        again.resume()
    assert again.account.state is State.RECORDING
    again.resume(after_drop=True)
    assert again.account.state is State.ASKING
    rung = "amplitude" in folder
    assert ("nothing of its 40 s" if rung else f"`iiwa-ident recover {tmp_path / folder}` says") in told[0]


def test_on_a_real_arm_nobody_is_asked_about_a_motion_of_which_a_rung_is_unsafe(
    motion: PreparedMotion, post: Path, tmp_path: Path
) -> None:
    trajectory = tmp_path / "motion.json"
    trajectory.write_bytes(msgspec.json.encode(motion.trajectory.to_json()))

    def agree(prepared: PreparedMotion, periods: int) -> bool:
        raise AssertionError("the operator was asked")

    driver = FriDriver(
        robot="iiwa14",
        workspace=post,
        tool=None,
        added_mass=None,
        installation=None,
        settings={},
        simulation=False,
        observe=lambda _: None,
        agree=agree,
    )
    asked = Motion(number=1, kind="k", purpose="to learn", trajectory=trajectory.name, periods=4, seconds=40.0)
    drive = driver.drive(asked, trajectory, tmp_path / "motion-01")
    assert drive.outcome == "unsafe"
    assert drive.sentence.startswith("At amplitude 1 the motion is not safe here: ")


def test_a_signal_in_the_planned_stop_ramp_lets_no_further_motion_begin(
    motion: PreparedMotion, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The run is completed all the same; with --yes the next motion would have begun by itself."""
    trajectory = tmp_path / "motion.json"
    trajectory.write_bytes(msgspec.json.encode(motion.trajectory.to_json()))

    def signalled(request: RunRequest, *, observe: object, stop: StopHandle) -> RunOutcome:
        del observe
        stop.signals += 1
        return RunOutcome(
            run_id=request.run_id, outcome="completed", exit_code=0, sentences=("Done.",), out_dir=request.out_dir
        )

    monkeypatch.setattr(driver_module, "run_acquisition", signalled)
    driver = FriDriver(
        robot="iiwa14",
        workspace=None,
        tool=None,
        added_mass=None,
        installation=None,
        settings={"fri_version": "1.15", "bind_host": "127.0.0.1", "bind_port": 30200},
        simulation=True,
        observe=lambda _: None,
        agree=lambda *_: True,
    )
    asked = Motion(number=1, kind="k", purpose="to learn", trajectory=trajectory.name, periods=4, seconds=40.0)
    with pytest.raises(KeyboardInterrupt):
        driver.drive(asked, trajectory, tmp_path / "motion-01")
