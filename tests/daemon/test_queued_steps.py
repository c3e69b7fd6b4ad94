"""Claims about one step of an investigation in the service's queue: what it takes, what it asks for, what it latches.

Truth: the account of the investigation, and what its runs left on disk. The mathematics is replaced.
"""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from daemon.api import LoopOutcome, LoopReport, RunOutcome
from daemon.errors import ConfigurationError
from daemon.investigate import queued
from daemon.investigate.account import Account, Motion, Recorded, save
from daemon.investigate.loop import Investigation
from daemon.investigate.states import Event, State
from daemon.json_files import read_json, write_json
from daemon.queue.investigation_step import Order


@pytest.fixture
def _scripted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every diagnosis leaves something open, and every choice is one motion that is safe."""

    def choose(self: Investigation) -> Event:
        number = len(self.account.recordings) + 1
        motion = Motion(number=number, kind="k", purpose="to learn", trajectory="t.json", periods=4, seconds=40.0)
        self.account = save(self._folder, msgspec.structs.replace(self.account, pending=motion))
        return Event.CHOSEN

    monkeypatch.setattr(Investigation, "_refuse_another_arm", lambda _: None)
    monkeypatch.setattr(Investigation, "_diagnose", lambda _: Event.OPEN)
    monkeypatch.setattr(Investigation, "_choose", choose)
    monkeypatch.setattr(Investigation, "_check", lambda _: Event.SAFE)


def planned(folder: Path) -> Order:
    """An investigation of two recordings whose third motion is asked for, and an order that follows."""
    given = (Recorded(file="a.npz"), Recorded(file="b.npz"))
    save(folder, Account(robot="iiwa14", seed=1, budget_s=120.0, recordings=given))
    order = Order(folder=str(folder), robot="iiwa14")
    assert queued.step(order).state is State.PLANNED
    return order


def ran(order: Order, outcome: str) -> Order:
    folder = Path(order.folder) / "motion-01"
    folder.mkdir(exist_ok=True)
    told = RunOutcome(
        run_id="r", outcome=outcome, exit_code=0 if outcome == "completed" else 1, sentences=(outcome,),
        out_dir=str(folder), recordings=(str(folder / "recording.mcap"),),
    )  # type: ignore[arg-type]  # fmt: skip
    write_json(folder / "run.json", told)
    return msgspec.structs.replace(order, number=3, run=str(folder))


def begun_unheard(folder: Path) -> Order:
    """An order after a motion that left a recording and no account, as where all its processes were killed at once."""
    order, run = planned(folder), folder / "motion-01"
    run.mkdir()
    (run / "recording.mcap").write_bytes(b"\x89MCAP0\r\n")
    return msgspec.structs.replace(order, number=3, run=str(run))


@pytest.mark.usefixtures("_scripted")
def test_a_step_takes_what_was_recorded_once_and_plans_the_next_motion(tmp_path: Path) -> None:
    order = ran(planned(tmp_path), "completed")
    for _ in range(2):  # a second time, as after a kill
        account = queued.step(order)
        assert account.state is State.PLANNED
        assert [item.file for item in account.recordings[2:]] == [str(tmp_path / "motion-01" / "recording.mcap")]
        assert account.pending is not None
        assert account.pending.number == 4


@pytest.mark.usefixtures("_scripted")
def test_a_drop_in_the_queue_is_latched_as_everywhere(tmp_path: Path) -> None:
    order = ran(planned(tmp_path), "dropped")
    assert queued.step(order).state is State.DROPPED
    on = Order(folder=str(tmp_path), robot="iiwa14", goes_on=True)
    with pytest.raises(ConfigurationError, match="--after-drop"):
        queued.step(on)
    account = queued.step(msgspec.structs.replace(on, after_drop=True))
    assert (account.state, len(account.recordings)) == (State.PLANNED, 2)


@pytest.mark.usefixtures("_scripted")
@pytest.mark.parametrize(
    ("outcome", "answered", "confirmed", "state"),
    [
        ("fault", 900, False, State.DROPPED),
        ("stopped", 900, False, State.DROPPED),
        ("stopped", 900, True, State.INTERRUPTED),
        ("fault", 0, False, State.INTERRUPTED),
    ],
)
def test_an_arm_that_nobody_saw_come_to_rest_is_latched_as_a_drop_is(
    tmp_path: Path, outcome: LoopOutcome, answered: int, confirmed: bool, state: State
) -> None:
    """After a kill of the loop in the motion the next one was asked for as if nothing had been."""
    order = ran(planned(tmp_path), outcome)
    file = Path(order.run or "") / "run.json"
    loop = LoopReport(outcome=outcome, reason="r", sentence="s", answered=answered, standstill_confirmed=confirmed)
    write_json(file, msgspec.structs.replace(read_json(file, RunOutcome), loop=loop))
    assert queued.step(order).state is state
    on = Order(folder=str(tmp_path), robot="iiwa14", goes_on=True)
    if state is State.DROPPED:
        with pytest.raises(ConfigurationError, match="--after-drop"):
            queued.step(on)
        on = msgspec.structs.replace(on, after_drop=True)
    assert queued.step(on).state is State.PLANNED


@pytest.mark.usefixtures("_scripted")
def test_a_motion_of_which_every_process_was_killed_is_latched_in_the_queue_as_by_the_command(tmp_path: Path) -> None:
    """A recording was begun, no run.json was written: it was asked for again as if nothing had moved."""
    order = begun_unheard(tmp_path)
    for _ in range(2):  # a second time, as after a kill
        with pytest.raises(ConfigurationError, match=r"motion-01: no run\.json says .* add --after-drop"):
            queued.step(order)
    on = msgspec.structs.replace(order, number=0, goes_on=True)
    with pytest.raises(ConfigurationError, match="--after-drop"):
        queued.step(on)
    account = queued.step(msgspec.structs.replace(on, after_drop=True))
    assert (account.state, len(account.recordings)) == (State.PLANNED, 2)


@pytest.mark.usefixtures("_scripted")
def test_a_rung_that_was_completed_while_its_service_was_gone_is_no_recording_of_its_motion(tmp_path: Path) -> None:
    """One period at a tenth of the amplitude counted as the whole motion."""
    order = msgspec.structs.replace(ran(planned(tmp_path), "completed"), rung=True, run_sentence="Interrupted.")
    account = queued.step(order)
    assert (account.state, len(account.recordings), account.sentence) == (State.INTERRUPTED, 2, "Interrupted.")
    on = msgspec.structs.replace(order, number=0, goes_on=True)
    assert (queued.step(on).state, len(queued.step(on).recordings)) == (State.PLANNED, 2)


@pytest.mark.usefixtures("_scripted")
def test_a_known_mass_is_taken_off_by_an_order_that_says_so(tmp_path: Path) -> None:
    order = planned(tmp_path)
    weighed = queued.step(msgspec.structs.replace(order, goes_on=True, added_mass=(2.0, 0.0, 0.0, 0.05)))
    assert weighed.added_mass == (2.0, 0.0, 0.0, 0.05)
    assert queued.step(msgspec.structs.replace(order, goes_on=True)).added_mass == weighed.added_mass
    off = queued.step(msgspec.structs.replace(order, goes_on=True, added_mass=(0.0, 0.0, 0.0, 0.0)))
    assert (off.state, off.added_mass) == (State.PLANNED, None)


@pytest.mark.usefixtures("_scripted")
def test_an_account_that_a_process_of_the_run_wrote_later_counts(tmp_path: Path) -> None:
    order = begun_unheard(tmp_path)
    with pytest.raises(ConfigurationError, match="--after-drop"):
        queued.step(order)
    on = msgspec.structs.replace(ran(order, "completed"), number=0, goes_on=True)
    assert len(queued.step(on).recordings) == 3


@pytest.mark.usefixtures("_scripted")
@pytest.mark.parametrize(("declined", "state"), [(True, State.DECLINED), (False, State.INTERRUPTED)])
def test_a_motion_that_was_declined_or_refused_is_asked_for_again(tmp_path: Path, declined: bool, state: State) -> None:
    order = planned(tmp_path)
    nowhere = None if declined else str(tmp_path / "refused")
    order = msgspec.structs.replace(order, number=3, declined=declined, run=nowhere, run_sentence="Not safe.")
    account = queued.step(order)
    assert account.state is state
    assert declined or account.sentence == "Not safe."
    assert queued.step(Order(folder=str(tmp_path), robot="iiwa14", goes_on=True)).state is State.PLANNED


# ---- the service itself
