"""Claims about what an operator is asked to do in `investigate`, and what is judged after it.

Truth: the operator's side of each action. The mathematics is replaced by a study with a fixed answer.
"""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest

from daemon.errors import ConfigurationError
from daemon.investigate import loop as loop_module
from daemon.investigate import steps as steps_module
from daemon.investigate.account import Motion, Recorded, read_account
from daemon.investigate.loop import Investigation
from daemon.investigate.motions import SAME_MOTION, compared_with, shipped_motion
from daemon.investigate.same_arm import Stated
from daemon.investigate.states import Event, State
from daemon.investigate.story import write_story
from identification.excitation import default_trajectory
from identification.investigation.actions import Action, Outcome
from identification.investigation.choice import Choice, Design
from identification.investigation.experiments import experiment
from identification.investigation.forecast import Forecast
from identification.mismatch.effects.base import Place
from identification.robots.installation import ON_THE_FLOOR, Installation
from tests.daemon.command_line import run
from tests.daemon.scripted_investigation import ROOM, ScriptedDriver, begun, investigation, scripted_study


@pytest.fixture(autouse=True)
def _scripted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Investigation, "_studied", scripted_study(4))
    monkeypatch.setattr(steps_module, "stands_out", lambda *_: True)


@pytest.fixture
def _told(monkeypatch: pytest.MonkeyPatch) -> None:
    """Actions that tell at once, of recordings that nobody reads."""
    planned = Motion(number=3, kind=SAME_MOTION, purpose="once more", trajectory="t.json", periods=4, seconds=40.0)
    trajectory = experiment(np.random.default_rng(1), ROOM, "fourier", None).trajectory("iiwa14")
    monkeypatch.setattr(loop_module, "same_motion", lambda *_: (planned, trajectory))
    monkeypatch.setattr(loop_module, "read_recording", lambda *_: None)
    monkeypatch.setattr(loop_module, "inputs_of", lambda *_, **__: SimpleNamespace(recordings=(None, None), robot=None))
    monkeypatch.setattr(
        loop_module, "what_it_told", lambda action, *_: (Outcome(action, "an answer", True, "It was the sensor."),)
    )


@pytest.mark.usefixtures("_told")
def test_a_mass_that_is_asked_for_and_fastened_leads_on(tmp_path: Path) -> None:
    account = begun(tmp_path, state=State.NEEDS_ACTION)
    again = investigation(tmp_path, account, ScriptedDriver())
    again.resume()
    assert again.account.state is State.NEEDS_ACTION
    again.resume(acted=Action.ADD_MASS, added_mass=(2.0, 0.0, 0.0, 0.05))
    done = again.run()
    assert done.state is State.SETTLED
    assert [item.added_mass for item in done.recordings] == [None, None, *[(2.0, 0.0, 0.0, 0.05)] * 2]
    assert [item.action for item in done.recordings] == [None, None, Action.ADD_MASS, None]
    assert [item.sentence for item in done.told] == ["It was the sensor."]
    assert "It was the sensor." in done.sentence


@pytest.mark.usefixtures("_told")
def test_a_mass_that_is_fastened_after_a_kill_was_not_on_the_flange_in_the_motion_before_it(tmp_path: Path) -> None:
    """Its torque was taken out of a recording that it was not in."""
    pending = Motion(number=3, kind="k", purpose="to learn", trajectory="t.json", periods=4, seconds=40.0)
    account = begun(tmp_path, state=State.RECORDING, pending=pending, attempts=1)
    (tmp_path / "motion-01").mkdir()
    (tmp_path / "motion-01" / "recording.npz").touch()  # whole when the kill came
    again = investigation(tmp_path, account, ScriptedDriver())
    again.resume(acted=Action.ADD_MASS, added_mass=(2.0, 0.0, 0.0, 0.05))
    done = again.run()
    assert [item.added_mass for item in done.recordings] == [None, None, None, (2.0, 0.0, 0.0, 0.05)]
    assert read_account(tmp_path) == done
    killed = investigation(tmp_path, account, ScriptedDriver())
    with pytest.raises(ConfigurationError, match="nothing asks for `--done turn_tool`"):
        killed.resume(acted=Action.TURN_TOOL)


MASS = (2.0, 0.0, 0.0, 0.05)


@pytest.mark.usefixtures("_told")
def test_a_mass_that_is_off_again_is_in_no_later_motion(tmp_path: Path) -> None:
    """Its torque was taken out of every recording that followed, and its weight counted in every check."""
    first = ScriptedDriver("recorded", "stopped")
    account = begun(tmp_path, state=State.NEEDS_ACTION)
    again = investigation(tmp_path, account, first)
    again.resume(acted=Action.ADD_MASS, added_mass=MASS)
    stopped = again.run()
    assert (stopped.state, stopped.added_mass) == (State.INTERRUPTED, MASS)
    later = investigation(tmp_path, stopped, ScriptedDriver())
    later.resume(added_mass=(0.0, 0.0, 0.0, 0.0))
    done = later.run()
    assert done.state is State.SETTLED
    assert [item.added_mass for item in done.recordings] == [None, None, MASS, None]


@pytest.mark.usefixtures("_told")
def test_a_mass_that_is_off_before_its_motion_leaves_nothing_to_drive(tmp_path: Path) -> None:
    """40 s were driven that could tell nothing. What was asked for is not asked for once more where it was done."""
    driver = ScriptedDriver("stopped")
    account = begun(tmp_path, state=State.NEEDS_ACTION, actions=("Fasten a mass.",), asks=(Action.ADD_MASS,))
    again = investigation(tmp_path, account, driver)
    again.resume(acted=Action.ADD_MASS, added_mass=MASS)
    stopped = again.run()
    assert (stopped.state, stopped.actions, stopped.asks) == (State.INTERRUPTED, (), ())
    later = investigation(tmp_path, stopped, driver)
    with pytest.raises(ConfigurationError, match="would be driven without one"):
        later.resume(added_mass=(0.0, 0.0, 0.0, 0.0))
    assert read_account(tmp_path) == stopped
    later.resume()
    assert later.run().told[0].sentence == "It was the sensor."


@pytest.mark.parametrize("state", [State.NEEDS_ACTION, State.SETTLED, State.OUT_OF_BUDGET])
def test_that_the_mass_is_off_can_be_said_wherever_the_investigation_rests(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], state: State
) -> None:
    begun(tmp_path, state=state, added_mass=MASS, budget_s=0.0, recordings=())
    for words in (["--added-mass", "none", "--done", "warm_up"], ["--added-mass", "0@0,0,0"]):
        assert run("investigate", "--out", tmp_path, *words) == 2
    kept = read_account(tmp_path)
    assert kept is not None
    assert kept.added_mass == MASS
    assert run("investigate", "--out", tmp_path, "--added-mass", "none") == int(state is not State.SETTLED)
    left = read_account(tmp_path)
    assert left is not None
    assert (left.state, left.added_mass) == (state, None)


def test_what_was_done_is_judged_by_motions_with_the_same_mass() -> None:
    """A mass that was on in one of the two would be read as what was done, such as an offset of its own torque."""
    cold, weighed, again = (
        Recorded(file="cold"),
        *(Recorded(file=name, added_mass=MASS, action=Action.ADD_MASS) for name in ("weighed", "again")),
    )
    warm = Recorded(file="warm", action=Action.WARM_UP)
    warm_weighed = Recorded(file="warm weighed", added_mass=MASS, action=Action.WARM_UP)
    other = Recorded(file="other")
    assert compared_with([cold, other, weighed], warm) is cold
    assert compared_with([cold, other, weighed], warm_weighed) is weighed
    assert compared_with([cold, other, weighed], again) is cold
    assert compared_with([cold, other, weighed, warm], again) is warm
    assert compared_with([cold, other, weighed, warm_weighed], warm) is None
    assert compared_with([cold, other], warm_weighed) is None


def with_offset(self: Investigation) -> Any:
    """A study that found an offset of joint 4."""
    offset = SimpleNamespace(effect="torque_offset", place=Place(4), alternatives=())
    found = scripted_study(0)(self)
    found.diagnosis = SimpleNamespace(verdict="explained", findings=(offset,), remaining="", classes=())
    return found


@pytest.mark.usefixtures("_told")
def test_an_offset_asks_for_a_warm_arm_and_is_settled_by_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Investigation, "_studied", with_offset)
    driver = ScriptedDriver()
    account = investigation(tmp_path, begun(tmp_path), driver).run()
    assert account.state is State.NEEDS_ACTION
    assert "--done warm_up" in account.actions[0]
    assert driver.driven == 0
    assert "warm_up" in write_story(tmp_path, account).read_text(encoding="utf-8")
    again = investigation(tmp_path, account, driver)
    again.resume(acted=Action.WARM_UP)
    done = again.run()
    assert done.state is State.SETTLED
    assert driver.driven == 1
    assert done.actions == ()
    assert "It was the sensor." in write_story(tmp_path, done).read_text(encoding="utf-8")


@pytest.mark.parametrize("state", [State.DECLINED, State.OUT_OF_BUDGET, State.INTERRUPTED, State.PLANNED])
def test_an_action_that_nothing_asks_for_is_not_passed_over(tmp_path: Path, state: State) -> None:
    """The tool was turned, the word for it ignored, and the next motion counted as one of the arm as it was."""
    account = begun(tmp_path, state=state)
    again = investigation(tmp_path, account, ScriptedDriver())
    with pytest.raises(ConfigurationError, match="nothing asks for `--done turn_tool`"):
        again.resume(acted=Action.TURN_TOOL)
    assert again.account.state is state
    doing = investigation(tmp_path, msgspec.structs.replace(account, doing=Action.TURN_TOOL), ScriptedDriver())
    doing.resume(acted=Action.TURN_TOOL)
    assert doing.account.doing is Action.TURN_TOOL


def test_an_action_beside_the_one_that_is_asked_for_is_refused_with_what_is(tmp_path: Path) -> None:
    """A turned tool is asked for: a warm arm settles nothing of it; a mass is on the flange, asked for or not."""
    account = begun(tmp_path, state=State.NEEDS_ACTION, asks=(Action.TURN_TOOL, Action.ADD_MASS))
    again = investigation(tmp_path, account, ScriptedDriver())
    with pytest.raises(
        ConfigurationError, match="asks for `--done turn_tool` or `--added-mass`, not for `--done warm_up`"
    ):
        again.resume(acted=Action.WARM_UP)
    assert read_account(tmp_path) == account
    again.resume(acted=Action.TURN_TOOL)
    assert again.account.doing is Action.TURN_TOOL
    unasked = begun(tmp_path / "b", state=State.NEEDS_ACTION, asks=(Action.TURN_TOOL,))
    weighted = investigation(tmp_path / "b", unasked, ScriptedDriver())
    weighted.resume(acted=Action.ADD_MASS, added_mass=MASS)
    assert weighted.account.added_mass == MASS


def test_a_second_warm_up_is_judged_with_the_first_and_uses_the_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The cold recording stays what both are compared with; the second one is as long as the first recording of all."""
    asked: list[tuple[str, ...]] = []

    def tell(action: Action, first: str, others: list[str], *_: object) -> tuple[Outcome, ...]:
        asked.append((first, *others))
        return (Outcome(action, "sensor_offset" if len(others) == 2 else "", len(others) == 2, "As it was told."),)

    monkeypatch.setattr(Investigation, "_studied", with_offset)
    monkeypatch.setattr(loop_module, "read_recording", str)
    monkeypatch.setattr(loop_module, "inputs_of", lambda read, **_: SimpleNamespace(recordings=read, robot=None))
    monkeypatch.setattr(loop_module, "what_it_told", tell)
    shipped, _ = shipped_motion("iiwa14", 0)
    (tmp_path / shipped.trajectory).write_text(json.dumps(default_trajectory("iiwa14").to_json()), encoding="utf-8")
    account = begun(tmp_path, recordings=(Recorded(file="cold", motion=shipped), Recorded(file="b")), budget_s=240.0)
    for _ in range(2):
        again = investigation(tmp_path, account, ScriptedDriver())
        if account.state is State.NEEDS_ACTION:
            again.resume(acted=Action.WARM_UP)
        account = again.run()
    assert account.state is State.NEEDS_ACTION
    again = investigation(tmp_path, account, ScriptedDriver())
    again.resume(acted=Action.WARM_UP)
    account = again.run()
    assert account.state is State.SETTLED
    warm = [item for item in account.recordings if item.action is Action.WARM_UP]
    assert asked == [("cold", warm[0].file), ("cold", warm[0].file, warm[1].file)]
    assert [item.motion.periods for item in warm if item.motion is not None] == [4, 8]


@pytest.mark.parametrize(
    ("budget_s", "state", "used_s"), [(79.0, State.OUT_OF_BUDGET, 0.0), (80.0, State.PLANNED, 80.0)]
)
def test_a_given_motion_that_is_driven_again_counts_with_its_own_period(
    tmp_path: Path, budget_s: float, state: State, used_s: float
) -> None:
    """Four periods of 20 s are 80 s of motion, whatever the period of the program's own motions is."""
    time = np.arange(8000) * 5e-3
    q = 0.2 * np.sin(2.0 * np.pi * time[:, None] / 20.0 + np.arange(7))
    np.savez(tmp_path / "slow.npz", t=time, q=q, tau=q, period_s=20.0, robot="iiwa14")
    given = (Recorded(file=str(tmp_path / "slow.npz")),) * 2
    account = begun(tmp_path, state=State.NEEDS_ACTION, recordings=given, budget_s=budget_s)
    again = investigation(tmp_path, account, ScriptedDriver(), ask=lambda *_: None)
    again.resume(acted=Action.WARM_UP)
    account = again.run()
    assert account.state is state
    assert (0.0 if account.pending is None else account.pending.seconds) == used_s


@pytest.mark.usefixtures("_told")
@pytest.mark.parametrize(
    ("wanted", "ask", "action"),
    [("gain", "--added-mass", Action.ADD_MASS), ("load", "--done turn_tool", Action.TURN_TOOL)],
)
def test_what_no_motion_shows_is_settled_where_an_operator_wants_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, wanted: str, ask: str, action: Action
) -> None:
    monkeypatch.setattr(Investigation, "_studied", scripted_study(0))
    account = investigation(tmp_path, begun(tmp_path, wanted=(wanted,)), ScriptedDriver()).run()
    assert account.state is State.NEEDS_ACTION
    assert ask in account.actions[0]
    again = investigation(tmp_path, account, ScriptedDriver())
    again.resume(acted=action)
    done = again.run()
    assert done.state is State.SETTLED
    page = write_story(tmp_path, done).read_text(encoding="utf-8")
    assert f"--settle {wanted}" not in page
    assert "☑ It was the sensor." in page


@pytest.mark.parametrize("left", [120.0, 30.0])
def test_a_class_that_no_motion_gives_a_name_is_settled_as_a_class(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, left: float
) -> None:
    """Whether there is time for more or not: what is known is said, and the way does not end as out of time."""
    found = experiment(np.random.default_rng(1), ROOM, "fourier", None)
    useless = Choice(found, 4, Forecast(0.5, 0.5, None, np.zeros((1, 1))))
    study = scripted_study(100)

    def with_class(self: Investigation) -> Any:
        found = study(self)
        found.diagnosis = SimpleNamespace(
            verdict="unexplained", findings=(), remaining="", classes=(SimpleNamespace(sentence="own velocity"),)
        )
        found.chooser = SimpleNamespace(choose=lambda *_, **__: Design((useless,), ()))
        return found

    monkeypatch.setattr(Investigation, "_studied", with_class)
    driver = ScriptedDriver()
    account = investigation(tmp_path, begun(tmp_path, budget_s=left), driver).run()
    assert account.state is State.SETTLED
    assert account.sentence.startswith("Settled as a class, without a name.")
    assert "No form of the library describes it better" in account.sentence
    assert driver.driven == (2 if left > 40.0 else 0)


def test_a_torque_with_two_names_is_open_when_the_time_is_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever class it is of, and though the hypotheses are told apart: the diagnosis gave it no single name."""
    found = experiment(np.random.default_rng(1), ROOM, "fourier", None)
    told = Choice(found, 4, Forecast(0.99, 0.99, None, np.zeros((1, 1)), 1.0, 0.99, 0.99))
    study = scripted_study(100)

    def with_two_names(self: Investigation) -> Any:
        found = study(self)
        two = SimpleNamespace(
            effect="torque_sensor_gain", place=Place(7), alternatives=(SimpleNamespace(effect="bending_crosstalk"),)
        )
        found.diagnosis = SimpleNamespace(
            verdict="explained", findings=(two,), remaining="", classes=(SimpleNamespace(sentence="own torque"),)
        )
        found.chooser = SimpleNamespace(choose=lambda *_, **__: Design((told,), ()))
        return found

    monkeypatch.setattr(Investigation, "_studied", with_two_names)
    account = investigation(tmp_path, begun(tmp_path, budget_s=50.0), ScriptedDriver()).run()
    assert account.state is State.OUT_OF_BUDGET
    assert "as a class" not in account.sentence
    assert "So far: An answer." in account.sentence


@pytest.mark.usefixtures("_told")
def test_the_page_says_of_each_recording_after_an_action_what_that_one_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told = iter(("The first time it told nothing.", "It was the sensor."))
    monkeypatch.setattr(
        loop_module, "what_it_told",
        lambda action, *_: (Outcome(action, "", (sentence := next(told)).endswith("sensor."), sentence),),
    )  # fmt: skip
    monkeypatch.setattr(Investigation, "_studied", with_offset)
    account = begun(tmp_path, budget_s=240.0, state=State.NEEDS_ACTION)
    for _ in range(2):
        again = investigation(tmp_path, account, ScriptedDriver())
        again.resume(acted=Action.WARM_UP)
        account = again.run()
    assert account.state is State.SETTLED
    page = write_story(tmp_path, account).read_text(encoding="utf-8")
    chapters = page.split("Recording 3: ")[-1].split("Recording 4: ")
    assert "The first time it told nothing." in chapters[0]
    assert "It was the sensor." not in chapters[0]
    assert "The first time it told nothing." not in chapters[1]
    assert "Hypotheses alive" not in "".join(chapters)


@pytest.mark.parametrize("action", list(Action))
def test_another_arm_is_refused_whatever_was_done_to_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, action: Action
) -> None:
    """Recordings of arm 81. Truth: what an action changes; a serial number is none of it, a tool or a stand may be."""
    metadata = {"serial": "81", "tool": "none"}

    def of_81(file: str) -> Any:
        return SimpleNamespace(source=SimpleNamespace(path=file, metadata=metadata), installation=ON_THE_FLOOR)

    def reaches_the_motion(serial: str, tool: str, installation: Installation) -> bool:
        monkeypatch.setattr(ScriptedDriver, "stated", lambda _: Stated(serial, tool, installation))
        account = begun(tmp_path, state=State.CHOOSING, doing=action, added_mass=mass)
        try:
            investigation(tmp_path, account, ScriptedDriver()).run()
        except ConfigurationError as error:
            return "nothing was moved" not in str(error)
        return True

    monkeypatch.setattr(loop_module, "read_recording", of_81)
    monkeypatch.setattr(Investigation, "_choose", lambda _: Event.NOTHING_TELLS)
    mass = MASS if action is Action.ADD_MASS else None
    wall = Installation((9.81, 0.0, 0.0))
    assert reaches_the_motion("81", "none", ON_THE_FLOOR)
    assert not reaches_the_motion("82", "none", ON_THE_FLOOR)
    assert reaches_the_motion("81", "2 kg", ON_THE_FLOOR) == (action in (Action.ADD_MASS, Action.TURN_TOOL))
    assert reaches_the_motion("81", "none", wall) == (action is Action.LEVEL_BASE)
