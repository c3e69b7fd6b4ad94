"""Claims about the loop of `investigate`: its table of states, resuming after a kill in any of them, drops, bad input.

Truth: the table below, written from the operator's side. The mathematics is replaced by a study with a fixed answer.
"""

from __future__ import annotations

import contextlib
from pathlib import Path

import msgspec
import pytest

from daemon.errors import ConfigurationError
from daemon.investigate import steps as steps_module
from daemon.investigate.account import Motion, read_account
from daemon.investigate.loop import Investigation
from daemon.investigate.states import TABLE, Event, State, TransitionError, after
from daemon.investigate.story import write_story
from tests.daemon.command_line import run
from tests.daemon.scripted_investigation import ScriptedDriver, begun, investigation, scripted_study

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
    assert "or the recordings are not of one arm" in page  # no log need have a serial number
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
