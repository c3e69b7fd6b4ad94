"""Claims about the loop of `investigate`: its table of states, resuming after a kill in any of them, drops, bad input.

Truth: the table below, written from the operator's side. The mathematics is replaced by a study with a fixed answer.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest

from daemon.errors import ConfigurationError
from daemon.investigate import loop as loop_module
from daemon.investigate import steps as steps_module
from daemon.investigate.account import Motion, read_account
from daemon.investigate.driver import FriDriver
from daemon.investigate.loop import Investigation
from daemon.investigate.same_arm import refuse_other_arms
from daemon.investigate.states import TABLE, Event, State, TransitionError, after
from daemon.investigate.story import write_story
from identification.recordings import Recording
from identification.recordings.reader import read_recording
from identification.robots import RobotModel
from tests.daemon.command_line import run
from tests.daemon.scripted_investigation import ScriptedDriver, begun, investigation, scripted_study
from tests.reference import recording_file

WAYS = """
diagnosing  nothing_open     settled
diagnosing  open             choosing
diagnosing  no_motion_tells  needs_action
diagnosing  resumed          diagnosing
choosing    chosen           checking
choosing    no_time          out_of_budget
choosing    nothing_tells    undecided
choosing    no_motion_tells  needs_action
choosing    known            settled
choosing    resumed          choosing
checking    safe             asking
checking    unsafe           blocked
checking    resumed          choosing
asking      agreed           recording
asking      refused          declined
asking      only_planned     planned
asking      no_time          choosing
asking      resumed          asking
recording   recorded         diagnosing
recording   stopped          interrupted
recording   dropped          dropped
recording   unsafe           blocked
recording   resumed          asking
interrupted resumed          asking
declined    resumed          asking
planned     resumed          asking
dropped     released         asking
blocked     resumed          choosing
out_of_budget resumed        choosing
undecided   resumed          choosing
needs_action acted           choosing
settled     acted            choosing
settled     resumed          diagnosing
"""


def test_the_table_of_states_is_the_one_written_here() -> None:
    ways = {(State(a), Event(e)): State(b) for a, e, b in (line.split() for line in WAYS.strip().splitlines())}
    assert ways == TABLE


def test_nothing_moves_but_by_an_operator_who_agreed() -> None:
    assert {pair for pair, state in TABLE.items() if state is State.RECORDING} == {(State.ASKING, Event.AGREED)}


def test_after_a_drop_only_a_release_leads_on() -> None:
    assert {event for state, event in TABLE if state is State.DROPPED} == {Event.RELEASED}
    with pytest.raises(TransitionError):
        after(State.DROPPED, Event.RESUMED)


@pytest.fixture(autouse=True)
def _scripted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Investigation, "_studied", scripted_study(4))
    monkeypatch.setattr(steps_module, "stands_out", lambda *_: True)


def test_it_records_until_nothing_is_open(tmp_path: Path) -> None:
    driver = ScriptedDriver()
    account = investigation(tmp_path, begun(tmp_path), driver).run()
    assert account.state is State.SETTLED
    assert driver.driven == 2
    assert account.used_s == 80.0
    assert read_account(tmp_path) == account
    page = write_story(tmp_path, account).read_text(encoding="utf-8")
    assert "Settled" in page
    assert "90 %" in page
    assert "The size of a spring agrees between the recordings" in page
    assert "The size of a delay DIFFERS" in page
    assert "Joint 2: friction fell." in page
    assert "☐ Is there a gain common to all torque sensors, or is it heavier links?" in page
    assert "--settle load" in page


def test_from_nothing_the_two_shipped_motions_come_first(tmp_path: Path) -> None:
    account = begun(tmp_path, recordings=(), budget_s=600.0)
    account = investigation(tmp_path, account, ScriptedDriver()).run()
    kinds = [item.motion.kind for item in account.recordings if item.motion is not None]
    assert kinds[:2] == ["excitation", "another excitation"]
    assert account.state is State.SETTLED


def test_a_budget_that_is_used_ends_it_and_a_larger_one_goes_on(tmp_path: Path) -> None:
    account = investigation(tmp_path, begun(tmp_path, budget_s=50.0), ScriptedDriver()).run()
    assert account.state is State.OUT_OF_BUDGET
    again = investigation(tmp_path, msgspec.structs.replace(account, budget_s=120.0), ScriptedDriver())
    again.resume()
    assert again.run().state is State.SETTLED


@pytest.mark.parametrize("outcome", [None, "stopped", "dropped"])
def test_a_motion_that_does_not_fit_a_smaller_budget_is_withdrawn(tmp_path: Path, outcome: str | None) -> None:
    """The scripted motion is of 40 s: planned, or broken off, with 120 s of budget, and not driven with 30 s."""
    planned = investigation(
        tmp_path, begun(tmp_path), ScriptedDriver(*([outcome] if outcome else [])), ask=lambda _: outcome and True
    ).run()
    driver = ScriptedDriver()
    again = investigation(tmp_path, msgspec.structs.replace(planned, budget_s=30.0), driver)
    again.resume(after_drop=True)
    account = again.run()
    assert (account.state, account.pending, driver.driven) == (State.OUT_OF_BUDGET, None, 0)
    larger = investigation(tmp_path, msgspec.structs.replace(account, budget_s=80.0), driver)
    larger.resume()
    assert (larger.run().state, driver.driven, larger.account.used_s) == (State.SETTLED, 2, 80.0)


@pytest.mark.parametrize("outcome", ["stopped", "dropped"])
def test_a_motion_that_did_not_end_well_keeps_all_and_moves_nothing_more(tmp_path: Path, outcome: str) -> None:
    driver = ScriptedDriver("recorded", outcome)
    account = investigation(tmp_path, begun(tmp_path), driver).run()
    assert account.state is (State.DROPPED if outcome == "dropped" else State.INTERRUPTED)
    assert driver.driven == 2
    assert len(account.recordings) == 3
    assert (tmp_path / "motion-02" / "recording.npz").is_file()


def test_a_drop_stays_latched_until_somebody_says_otherwise(tmp_path: Path) -> None:
    account = investigation(tmp_path, begun(tmp_path), ScriptedDriver("dropped")).run()
    driver = ScriptedDriver()
    again = investigation(tmp_path, account, driver)
    with pytest.raises(ConfigurationError, match="--after-drop"):
        again.resume()
    assert driver.driven == 0
    again.resume(after_drop=True)
    assert again.account.state is State.ASKING
    assert again.run().state is State.SETTLED


@pytest.mark.parametrize("state", [State.DIAGNOSING, State.CHOOSING, State.CHECKING, State.ASKING, State.RECORDING])
def test_it_goes_on_after_a_kill_in_any_state(tmp_path: Path, state: State, monkeypatch: pytest.MonkeyPatch) -> None:
    """The kill: the state is on disk, what was to be done in it is not."""

    class Killed(BaseException):
        pass

    method = {"diagnosing": "_diagnose", "choosing": "_choose", "checking": "_check", "asking": "_question",
              "recording": "_record"}[state.value]  # fmt: skip

    def die(self: Investigation) -> Event:
        raise Killed

    with monkeypatch.context() as patch:
        patch.setattr(Investigation, method, die)
        with pytest.raises(Killed):
            investigation(tmp_path, begun(tmp_path), ScriptedDriver()).run()
    left = read_account(tmp_path)
    assert left is not None
    assert left.state is state
    asked: list[Motion] = []
    driver = ScriptedDriver()
    again = investigation(tmp_path, left, driver, ask=lambda motion: asked.append(motion) or True)
    again.resume()
    assert again.account.state is not State.RECORDING
    assert again.run().state is State.SETTLED
    assert len(asked) == driver.driven == 2


def killed_while_recording(folder: Path, left_behind: str) -> Investigation:
    """What goes on after a kill that came when the run had already written a file of this name."""
    with pytest.raises(KeyboardInterrupt):
        investigation(folder, begun(folder), ScriptedDriver("kill")).run()
    account = read_account(folder)
    assert account is not None
    run = folder / f"motion-{account.attempts:02d}"
    run.mkdir()
    (run / left_behind).write_bytes(b"")
    return investigation(folder, account, ScriptedDriver())


METHODS = {"diagnosing": "_diagnose", "choosing": "_choose", "checking": "_check", "asking": "_question"}


@pytest.mark.parametrize("state", METHODS)
def test_ctrl_c_in_any_state_keeps_what_is_known_and_the_same_command_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], state: str
) -> None:
    """While the arm moves, Ctrl-C is the run's own: it ends as stopped, below."""
    driver = ScriptedDriver()
    monkeypatch.setattr("daemon.cli.investigate._driver", lambda *_, **__: driver)
    words = ("investigate", "--out", str(tmp_path / "question"))

    def interrupt(self: Investigation) -> Event:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Investigation, METHODS[state], interrupt)
        assert run(*words, "--budget", "10", "--yes") == 130
    assert "Traceback" not in capsys.readouterr().err
    left = read_account(tmp_path / "question")
    assert left is not None
    assert (left.state.value, left.recordings, driver.driven) == (state, (), 0)
    assert run(*words, "--yes") == 0
    done = read_account(tmp_path / "question")
    assert done is not None
    assert (done.state, len(done.recordings), driver.driven) == (State.SETTLED, 4, 4)


@pytest.mark.parametrize("motion", range(4))
@pytest.mark.parametrize("trouble", ["stopped", "dropped", "kill"])
def test_a_motion_that_was_broken_off_is_asked_for_again_whichever_it_was(
    tmp_path: Path, trouble: str, motion: int
) -> None:
    """Ctrl-C, a drop or a kill in the first, the second and the chosen motions; what was recorded before is kept."""
    account = begun(tmp_path, recordings=(), budget_s=600.0)
    driver = ScriptedDriver(*["recorded"] * motion, trouble)
    with contextlib.suppress(KeyboardInterrupt):
        investigation(tmp_path, account, driver).run()
    left = read_account(tmp_path)
    assert left is not None
    states = {"stopped": State.INTERRUPTED, "dropped": State.DROPPED, "kill": State.RECORDING}
    assert (left.state, len(left.recordings), driver.driven) == (states[trouble], motion, motion + 1)
    asked: list[Motion] = []
    later = ScriptedDriver()
    again = investigation(tmp_path, left, later, ask=lambda motion: asked.append(motion) or True)
    if trouble == "dropped":
        with pytest.raises(ConfigurationError, match="--after-drop"):
            again.resume()
    again.resume(after_drop=trouble == "dropped")
    assert (again.account.state, later.driven) == (State.ASKING, 0)
    done = again.run()
    assert done.state is State.SETTLED
    assert (len(done.recordings), len(asked), later.driven) == (4, 4 - motion, 4 - motion)
    assert asked[0] == left.pending


def test_a_recording_that_was_whole_when_the_kill_came_is_not_driven_again(tmp_path: Path) -> None:
    again = killed_while_recording(tmp_path, "recording.npz")
    again.resume()
    assert again.account.state is State.DIAGNOSING
    assert len(again.account.recordings) == 3


def test_a_drop_that_came_with_the_kill_is_latched_too(tmp_path: Path) -> None:
    again = killed_while_recording(tmp_path, "dropped")
    with pytest.raises(ConfigurationError, match="--after-drop"):
        again.resume()
    kept = read_account(tmp_path)
    assert kept is not None
    assert kept.state is State.DROPPED
    assert len(kept.recordings) == 2


def test_what_is_declined_is_not_driven(tmp_path: Path) -> None:
    driver = ScriptedDriver()
    account = investigation(tmp_path, begun(tmp_path), driver, ask=lambda *_: False).run()
    assert account.state is State.DECLINED
    assert driver.driven == 0


def test_a_plan_moves_nothing_and_can_be_driven_later(tmp_path: Path) -> None:
    driver = ScriptedDriver()
    account = investigation(tmp_path, begun(tmp_path), driver, ask=lambda *_: None).run()
    assert account.state is State.PLANNED
    assert driver.driven == 0
    later = investigation(tmp_path, account, driver)
    later.resume()
    assert later.run().state is State.SETTLED


def test_a_workspace_without_an_admissible_motion_is_said(tmp_path: Path) -> None:
    driver = ScriptedDriver(objection="Link 6 meets the wall.")
    account = investigation(tmp_path, begun(tmp_path), driver).run()
    assert account.state is State.BLOCKED
    assert "Link 6 meets the wall." in account.sentence
    assert driver.driven == 0


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
