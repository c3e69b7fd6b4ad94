"""Claims about the command `resume`: who says it sees what will move, and nothing else is let go by it.

Truth: the answers of a service, written here, and the request that the command sends.
"""

from __future__ import annotations

from typing import Any

import pytest

from daemon.cli import service as commands
from daemon.queue.control_api import ControlRequest, GetJobs, GetStatus, JobsReply, JobView, Resumed, ResumeQueue
from daemon.queue.control_api import StatusReply as Status
from tests.daemon.command_line import run

OLD, NEW, DONE = "20261101T080000000Z", "20261122T170400731Z", "20261122T100000000Z"


def job(number: str, phase: Any, name: str) -> JobView:
    return JobView(
        job_id=number, kind="run", phase=phase, sentence="", name=name, folder="", submitted_at="", updated_at="",
        periods=8, amplitude=0.5,
    )  # fmt: skip


class Service:
    """A service of a real arm with two held runs, the older of them of last month."""

    def __init__(self) -> None:
        self.sent: list[ControlRequest] = []

    def ask(self, request: ControlRequest, _: type) -> Any:
        self.sent.append(request)
        if isinstance(request, GetStatus):
            return Status(
                state="idle", sentence="", pid=1, software_version="", started_at="", robot="iiwa14", bind="1.2.3.4:5",
                fri_version="1.15", needs_confirmation=True, run=None, fit=None, waiting=0, held=2, motion_phase="",
                period=-1, periods=0, samples=0, missing=0, lost_in_handover=0, malformed=0, recent=(),
            )  # fmt: skip
        if isinstance(request, GetJobs):
            listed = (job(NEW, "held", "motion 3"), job(DONE, "done", "other"), job(OLD, "held", "forgotten.json"))
            return JobsReply(jobs=tuple(each for each in listed if not request.held or each.phase == "held"), total=3)
        return Resumed(released=len(request.jobs or ()), sentence="Done.")  # type: ignore[union-attr]


@pytest.fixture
def service() -> Service:
    return Service()


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch, service: Service) -> list[str]:
    """What was asked before the arm may move; every answer is yes."""
    questions: list[str] = []
    monkeypatch.setattr(commands.Connection, "ask", lambda _, *told: service.ask(*told))
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    monkeypatch.setattr(commands.typer, "confirm", lambda text, **_: questions.append(text))
    return questions


def test_all_that_will_move_is_named_before_anybody_agrees(
    asked: list[str], service: Service, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("resume") == 0
    said = " ".join(capsys.readouterr().err.split())
    assert said.index(f"{OLD}: forgotten.json, amplitude 0.5, 8 periods.") < said.index(f"{NEW}: motion 3")
    assert "WILL MOVE as soon as the queue comes to these 2 runs, one after the other," in said
    assert DONE not in said
    assert len(asked) == 1
    assert service.sent[-1] == ResumeQueue(confirmed=True, jobs=(OLD, NEW))


def test_one_of_several_can_be_let_go_alone(
    asked: list[str], service: Service, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("resume", NEW) == 0
    said = " ".join(capsys.readouterr().err.split())
    assert OLD not in said
    assert "comes to this run without" in said
    assert service.sent[-1] == ResumeQueue(confirmed=True, jobs=(NEW,))
    assert len(asked) == 1


def test_a_run_that_is_not_held_is_not_let_go(
    asked: list[str], service: Service, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("resume", DONE) == 2
    assert f"no run {DONE} is held here" in " ".join(capsys.readouterr().err.split())
    assert not asked
    assert not any(isinstance(request, ResumeQueue) for request in service.sent)
