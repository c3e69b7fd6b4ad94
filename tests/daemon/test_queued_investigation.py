"""Claims about investigations in the service's queue: what waits for the operator, what a restart and a stop leave.

Truth: the rules of the queue for any run, and the account of the investigation. The mathematics is replaced.
"""

from __future__ import annotations

import json
import signal
from pathlib import Path
from typing import Any

import msgspec
import pytest

from daemon.api import RunOutcome
from daemon.config import DaemonConfig, FriSettings
from daemon.investigate.account import read_account
from daemon.investigate.states import State
from daemon.motion.tool import Tool
from daemon.queue.control_api import JobPhase, RefusedRequestError, SubmitInvestigation
from daemon.queue.investigation_step import Order, StepAnswer, StepEnded
from daemon.queue.investigations import Investigations
from daemon.queue.job_queue import JobQueue
from daemon.queue.job_store import Job
from daemon.queue.job_work import RunEnded
from tests.daemon.service_process import fake_robot, iiwa_ident, service, until_excitation, wait_for

REAL = FriSettings(bind_host="192.170.10.1", robot_host="192.170.10.2")
MOTION = StepAnswer(sentence="Motion 1: to learn.", exit_code=0, trajectory="t.json", number=1, periods=8)


class Queue:
    """The queue of a service and its investigations, without processes."""

    def __init__(self, folder: Path, **config: Any) -> None:
        self.config = DaemonConfig(output=str(folder), **config)
        self.jobs = JobQueue(self.config, lambda _: None)
        self.investigations = Investigations(self.config, self.jobs.store)

    def begin(self, **request: Any) -> str:
        numbers: list[str] = []
        self.investigations.add(
            SubmitInvestigation(**{"budget_minutes": 4.0, **request}), lambda number, _: numbers.append(number)
        )
        assert self.jobs.store.flush()
        return numbers[0]

    def think(self, answer: StepAnswer) -> Order:
        job = self.investigations.next_step()
        assert job is not None
        order = self.investigations.step_of(job)
        self.investigations.step_ended(StepEnded(job.job_id, answer))
        return order

    def end_run(self, run_id: str, outcome: str = "completed", code: int = 0) -> None:
        told = RunOutcome(run_id=run_id, outcome=outcome, exit_code=code, sentences=(), out_dir="")  # type: ignore[arg-type]
        self.jobs.run_ended(RunEnded(run_id, told, "Why.", code))
        self.investigations.follow()

    def phases(self) -> list[tuple[str, JobPhase]]:
        return [(job.kind, job.phase) for job in self.jobs.store.jobs.values()]

    @property
    def runs(self) -> list[Job]:
        return [job for job in self.jobs.store.jobs.values() if job.kind == "run"]


def test_a_motion_waits_for_the_operator_and_its_end_is_told_to_the_next_step(tmp_path: Path) -> None:
    queue = Queue(tmp_path)
    number = queue.begin()
    queue.think(MOTION)
    assert queue.phases() == [("investigation", "held"), ("run", "held")]
    assert queue.jobs.next_run() is None
    assert "Motion 1: to learn." in queue.jobs.store.jobs[number].sentence
    assert queue.jobs.release() == 1
    run = queue.jobs.next_run()
    assert run is not None
    assert (run.periods, run.amplitude, run.fit, run.folder) == (8, 1.0, False, str(tmp_path / number / "motion-01"))
    assert queue.jobs.preparation_of(run).trajectory_file == "t.json"
    queue.jobs.run_started(run.job_id)
    queue.investigations.follow()
    assert queue.phases() == [("investigation", "running"), ("run", "running")]
    assert queue.investigations.next_step() is None
    queue.end_run(run.job_id)
    order = queue.think(StepAnswer(sentence="Settled.", exit_code=0))
    assert (order.run, order.number, order.budget_s) == (run.folder, 1, None)
    assert queue.phases() == [("investigation", "done"), ("run", "done")]


def test_on_a_real_arm_every_rung_of_the_ladder_waits_for_the_operator(tmp_path: Path) -> None:
    queue = Queue(tmp_path, fri=REAL)
    queue.begin()
    queue.think(MOTION)
    for expected in ((0.1, 1), (0.25, 1), (0.5, 1), (1.0, 8)):
        run = queue.runs[-1]
        assert run.phase == "held"
        assert (run.amplitude, run.periods) == expected
        assert queue.investigations.next_step() is None
        queue.jobs.release()
        queue.jobs.run_started(run.job_id)
        queue.end_run(run.job_id)
    assert queue.think(StepAnswer(sentence="Settled.", exit_code=0)).run == queue.runs[-1].folder


@pytest.mark.parametrize(("outcome", "code"), [("stopped", 1), ("dropped", 1), ("no_robot", 69)])
def test_a_rung_that_did_not_end_well_ends_the_climb(tmp_path: Path, outcome: str, code: int) -> None:
    queue = Queue(tmp_path, fri=REAL)
    queue.begin()
    queue.think(MOTION)
    queue.jobs.release()
    queue.jobs.run_started(queue.runs[0].job_id)
    queue.end_run(queue.runs[0].job_id, outcome, code)
    assert len(queue.runs) == 1
    order = queue.think(StepAnswer(sentence="It was stopped.", exit_code=code, moved_badly=True))
    assert (order.run, order.run_exit_code) == (queue.runs[0].folder, code)
    assert queue.phases()[0] == ("investigation", "stopped")


def test_only_a_fake_robot_may_go_unasked_and_a_stop_holds_it_too(tmp_path: Path) -> None:
    queue = Queue(tmp_path)
    queue.begin(unasked=True)
    queue.think(MOTION)
    assert queue.phases() == [("investigation", "held"), ("run", "queued")]
    queue.jobs.hold_waiting()
    queue.investigations.follow()
    assert queue.phases() == [("investigation", "held"), ("run", "held")]


def test_a_stop_while_it_thinks_holds_the_motion_that_follows(tmp_path: Path) -> None:
    queue = Queue(tmp_path)
    queue.begin(unasked=True)
    job = queue.investigations.next_step()
    assert job is not None
    queue.investigations.step_of(job)
    queue.jobs.hold_waiting()
    queue.investigations.step_ended(StepEnded(job.job_id, MOTION))
    assert queue.jobs.next_run() is None
    assert queue.phases() == [("investigation", "held"), ("run", "held")]


def test_one_that_thinks_is_not_cancelled_and_says_when_it_can_be(tmp_path: Path) -> None:
    queue = Queue(tmp_path)
    number = queue.begin()
    job = queue.investigations.next_step()
    assert job is not None
    queue.investigations.step_of(job)
    with pytest.raises(RefusedRequestError, match=r"moves nothing; once it asks for a motion, `cancel` ends it\.$"):
        queue.jobs.cancel(number)
    queue.investigations.step_ended(StepEnded(number, MOTION))
    queue.jobs.cancel(number)
    assert queue.jobs.store.jobs[number].phase == "cancelled"


def test_what_went_unasked_on_a_fake_robot_asks_on_the_real_arm_of_the_next_service(tmp_path: Path) -> None:
    queue = Queue(tmp_path)
    queue.begin(unasked=True)
    queue.jobs.close()
    real = Queue(tmp_path, fri=REAL)
    real.investigations.recover()
    real.jobs.recover()
    real.think(MOTION)
    assert real.jobs.next_run() is None
    assert [(run.amplitude, run.phase) for run in real.runs] == [(0.1, "held")]


def test_a_motion_that_is_cancelled_was_declined(tmp_path: Path) -> None:
    queue = Queue(tmp_path)
    queue.begin()
    queue.think(MOTION)
    queue.jobs.cancel(queue.runs[0].job_id)
    queue.investigations.follow()
    order = queue.think(StepAnswer(sentence="Declined.", exit_code=1, moved_badly=True))
    assert order.declined
    assert order.run is None


def test_a_cancelled_investigation_takes_its_motion_along_and_ends_for_good(tmp_path: Path) -> None:
    queue = Queue(tmp_path)
    number = queue.begin()
    queue.think(MOTION)
    queue.jobs.cancel(number)
    queue.investigations.follow()
    assert queue.phases() == [("investigation", "cancelled"), ("run", "cancelled")]
    assert queue.jobs.release() == 0
    assert queue.begin(job_id=number, budget_minutes=None) == number
    assert queue.think(MOTION).goes_on
    assert [run.phase for run in queue.runs] == ["cancelled", "held"]


def test_one_whose_motion_is_about_to_begin_is_not_called_cancelled(tmp_path: Path) -> None:
    """It was said that nothing of it would move, and then the arm moved."""
    queue = Queue(tmp_path)
    number = queue.begin()
    queue.think(MOTION)
    queue.jobs.release()
    queue.jobs.preparation_of(queue.runs[0])
    queue.investigations.follow()
    with pytest.raises(RefusedRequestError, match="about to begin, and `iiwa-ident stop` holds it") as caught:
        queue.jobs.cancel(number)
    assert caught.value.exit_code == 1
    assert queue.phases() == [("investigation", "held"), ("run", "preparing")]
    queue.jobs.hold(queue.runs[0].job_id)  # as the stop does
    queue.jobs.cancel(number)
    assert queue.phases() == [("investigation", "cancelled"), ("run", "cancelled")]


def test_after_a_restart_a_step_is_taken_again_and_a_motion_still_waits(tmp_path: Path) -> None:
    queue = Queue(tmp_path)
    queue.begin(unasked=True)
    queue.begin()
    queue.think(MOTION)
    thinking = queue.investigations.next_step()
    assert thinking is not None
    queue.investigations.step_of(thinking)
    queue.jobs.close()
    again = Queue(tmp_path)
    again.investigations.recover()
    again.jobs.recover()
    again.investigations.follow()
    assert sorted(again.phases()) == [("investigation", "held"), ("investigation", "queued"), ("run", "held")]
    assert again.jobs.next_run() is None


def test_a_run_that_a_restart_found_under_way_is_told_as_interrupted(tmp_path: Path) -> None:
    queue = Queue(tmp_path)
    queue.begin()
    queue.think(MOTION)
    queue.jobs.release()
    queue.jobs.run_started(queue.runs[0].job_id)
    queue.investigations.follow()
    queue.jobs.close()
    again = Queue(tmp_path)
    again.investigations.recover()
    again.jobs.recover()
    again.investigations.follow()
    assert again.phases() == [("investigation", "queued"), ("run", "interrupted")]
    assert "interrupted" not in again.think(MOTION).run_sentence  # its folder says how it ended
    assert again.jobs.next_run() is None


@pytest.mark.parametrize(
    ("request_", "code"),
    [
        ({"budget_minutes": None}, 2),
        ({"done": "warm_up"}, 2),
        ({"done": "warm_up", "added_mass": (2.0, 0.0, 0.0, 0.05), "job_id": "20261121T103000123Z"}, 2),
        ({"recordings": ("20261121T103000123Z",)}, 66),
        ({"job_id": "20261121T103000123Z"}, 66),
    ],
)
def test_what_cannot_be_begun_is_said(tmp_path: Path, request_: dict[str, Any], code: int) -> None:
    with pytest.raises(RefusedRequestError) as caught:
        Queue(tmp_path).begin(**request_)
    assert caught.value.exit_code == code


def test_one_that_waits_is_not_gone_on_with(tmp_path: Path) -> None:
    queue = Queue(tmp_path)
    number = queue.begin()
    with pytest.raises(RefusedRequestError, match="once it rests"):
        queue.begin(job_id=number)


def test_a_known_mass_is_carried_by_the_check_of_its_motion(tmp_path: Path) -> None:
    queue = Queue(tmp_path)
    queue.begin()
    mass = (2.0, 0.0, 0.0, 0.05)
    queue.think(msgspec.structs.replace(MOTION, added_mass=mass))
    assert queue.jobs.preparation_of(queue.runs[0]).settings["added_mass"] == mass


def test_a_tool_with_a_mass_fastened_to_it_weighs_and_turns_as_both() -> None:
    """Two point masses of 1 and 3 kg, 0.4 m apart: 4 kg, reduced mass 0.75 kg, 0.12 kg m² about their centre."""
    both = Tool(mass_kg=1.0, center_of_mass_m=(0.0, 0.0, 0.0)).with_mass(3.0, (0.0, 0.0, 0.4))
    assert both.mass_kg == 4.0
    assert both.center_of_mass_m == pytest.approx((0.0, 0.0, 0.3))
    assert both.inertia_kg_m2 == pytest.approx((0.12, 0.12, 0.0, 0.0, 0.0, 0.0))
    assert Tool().with_mass(2.0, (0.0, 0.0, 0.05)).center_of_mass_m == pytest.approx((0.0, 0.0, 0.05))


# ---- one step


def test_the_next_step_is_told_whether_a_run_was_a_rung(tmp_path: Path) -> None:
    queue = Queue(tmp_path, fri=REAL)
    queue.begin()
    queue.think(MOTION)
    queue.jobs.release()
    queue.jobs.run_started(queue.runs[0].job_id)
    queue.end_run(queue.runs[0].job_id, "stopped", 1)
    assert queue.think(StepAnswer(sentence="Stopped.", exit_code=1, moved_badly=True)).rung


def test_one_that_is_gone_on_with_is_told_which_run_was_its_last(tmp_path: Path) -> None:
    """Where nobody knew how that one ended, its folder is looked at once more."""
    queue = Queue(tmp_path)
    number = queue.begin()
    queue.think(MOTION)
    run = queue.runs[0]
    queue.jobs.release()
    queue.jobs.run_started(run.job_id)
    queue.end_run(run.job_id, "stopped", 1)
    queue.think(StepAnswer(sentence="Nobody knows how it ended.", exit_code=78))
    queue.begin(job_id=number, budget_minutes=None)
    order = queue.think(MOTION)
    assert (order.goes_on, order.run, order.number) == (True, run.folder, 0)


def test_by_the_service_a_motion_is_asked_for_driven_stopped_and_found_again_after_a_kill(tmp_path: Path) -> None:
    with service(tmp_path) as running, fake_robot(running.port, "--json", tmp_path / "robot.json"):

        def told(*words: object) -> Any:
            done = iiwa_ident(*words, "--port", running.port, "--json", "-")
            assert done.returncode == 0, done.stderr
            return json.loads(done.stdout)

        number = told("submit-investigation", "--budget", 4)["job_id"]
        view = running.wait_phase(number, "held", "failed")
        assert "the shipped excitation" in view.sentence
        run = f"{number}-motion-01"
        assert running.phase(run) == "held"
        assert not (running.output / number / "motion-01").exists()  # nothing moves before `resume`

        # What the operator is shown is on the disk soon after; a kill before that has the motion asked for anew.
        wait_for((running.output / f"jobs-{running.port}" / run / "job.json").is_file)
        running.process.send_signal(signal.SIGKILL)
        running.process.wait()
        running.start()
        assert (running.phase(number), running.phase(run)) == ("held", "held")

        assert told("resume")["released"] == 1
        running.wait_phase(number, "running")
        until_excitation(running, run)
        assert told("stop")["was_moving"]
        assert running.wait_phase(run, "stopped").exit_code == 1
        assert "stop" in running.wait_phase(number, "stopped").sentence.lower()
        account = read_account(running.output / number)
        assert account is not None
        assert (account.state, account.recordings) == (State.INTERRUPTED, ())
        assert (running.output / number / "story.html").is_file()

        told("submit-investigation", "--go-on", number)
        running.wait_phase(number, "held")
        assert running.phase(f"{number}-motion-02") == "held"
        report = json.loads((running.output / number / "motion-01" / "loop_report.json").read_text())
        assert (report["reason"], report["standstill_confirmed"]) == ("OPERATOR_STOP", True)
    assert json.loads((tmp_path / "robot.json").read_text())["rejections"] == []
