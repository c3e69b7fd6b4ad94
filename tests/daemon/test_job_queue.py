"""Claims about the queue on disk: what a restart makes of each job, and what never moves by itself.

A restart is a second queue on the same folder; nothing of the first is handed over.
"""

from __future__ import annotations

import subprocess
import sys
import threading
from pathlib import Path

import msgspec
import psutil
import pytest

from daemon.api import RunOutcome
from daemon.config import DaemonConfig
from daemon.json_files import write_json
from daemon.queue.control_api import JobPhase, RefusedRequestError, SubmitRun
from daemon.queue.job_preparation import Verdict
from daemon.queue.job_queue import JobQueue
from daemon.queue.job_store import MAXIMUM_KEPT, MAXIMUM_WAITING
from daemon.queue.job_work import FitEnded, RunEnded, fit_is_alive
from tests.watchdog import WATCHDOG_S

SAFE = Verdict(safe=True, sentence="Safe.")


def queue_in(folder: Path) -> JobQueue:
    return JobQueue(DaemonConfig(output=str(folder)), lambda _: None)


def submitted(jobs: JobQueue, *, check: bool = True, fit: bool = True) -> str:
    stored = threading.Event()
    answers: list[tuple[str, OSError | None]] = []

    def done(job_id: str, error: OSError | None) -> None:
        answers.append((job_id, error))
        stored.set()

    jobs.add(SubmitRun(trajectory=b"{}", name="motion.json", periods=2, fit=fit), done)
    assert stored.wait(WATCHDOG_S)
    job_id, error = answers[0]
    assert error is None
    if check:
        jobs.checked(job_id, SAFE)
    return job_id


def phases(jobs: JobQueue) -> dict[str, JobPhase]:
    return {job.job_id: job.phase for job in jobs.store.jobs.values()}


def test_runs_take_their_turn_in_the_order_of_submission(tmp_path: Path) -> None:
    jobs = queue_in(tmp_path)
    first, second = submitted(jobs), submitted(jobs)
    for expected in (first, second):
        job = jobs.next_run()
        assert job is not None
        assert job.job_id == expected
        jobs.run_started(expected)
    assert jobs.next_run() is None


def test_after_a_restart_what_waited_is_held_and_what_moved_is_interrupted(tmp_path: Path) -> None:
    jobs = queue_in(tmp_path)
    waiting, preparing, moving, cancelled, unchecked = (submitted(jobs, check=index < 4) for index in range(5))
    job = jobs.store.jobs[preparing]
    jobs.preparation_of(job)
    jobs.run_started(moving)
    jobs.cancel(cancelled)
    jobs.close()

    again = queue_in(tmp_path)
    assert [job.job_id for job in again.recover()] == [unchecked]
    assert phases(again) == {
        waiting: "held",
        preparing: "held",
        moving: "interrupted",
        cancelled: "cancelled",
        unchecked: "checking",
    }
    ended = [again.store.jobs[job_id].view().exit_code for job_id in (moving, cancelled, waiting)]
    assert ended == [130, 130, None]  # who polls for the code of an end waited for ever
    again.checked(unchecked, SAFE)
    assert phases(again)[unchecked] == "held"
    assert again.next_run() is None
    assert (again.store.folder_of(waiting) / "trajectory.json").read_bytes() == b"{}"


def test_a_run_whose_books_were_closed_before_the_service_died_counts_as_ended(tmp_path: Path) -> None:
    jobs = queue_in(tmp_path)
    job_id = submitted(jobs)
    jobs.run_started(job_id)
    jobs.close()
    folder = tmp_path / job_id
    folder.mkdir()
    outcome = RunOutcome(run_id=job_id, outcome="completed", exit_code=0, sentences=("All done.",), out_dir=str(folder))
    write_json(folder / "run.json", outcome)
    again = queue_in(tmp_path)
    again.recover()
    assert phases(again) == {job_id: "done", f"{job_id}-fit": "queued"}


def test_a_fit_whose_process_is_gone_is_begun_again_but_not_for_ever(tmp_path: Path) -> None:
    jobs = queue_in(tmp_path)
    job_id = submitted(jobs)
    jobs.run_ended(RunEnded(job_id, None, "", 0))
    jobs.queue_fit(job_id)
    fit = f"{job_id}-fit"
    for phase in ("queued", "failed"):
        jobs.fit_started(fit, 2**22 + 1)  # beyond any process number of Linux
        jobs.close()
        jobs = queue_in(tmp_path)
        jobs.recover()
        assert phases(jobs)[fit] == phase


def test_a_stop_holds_what_waits_also_what_is_still_being_checked_and_new_runs_are_new(tmp_path: Path) -> None:
    jobs = queue_in(tmp_path)
    ready, unchecked = submitted(jobs), submitted(jobs, check=False)
    jobs.hold_waiting()
    jobs.checked(unchecked, SAFE)
    assert phases(jobs) == {ready: "held", unchecked: "held"}
    later = submitted(jobs)
    job = jobs.next_run()
    assert job is not None
    assert job.job_id == later
    assert jobs.release() == 2
    assert phases(jobs) == {ready: "queued", unchecked: "queued", later: "queued"}


def test_those_that_wait_for_the_operator_are_found_behind_any_number_of_newer_jobs(tmp_path: Path) -> None:
    """Those that are held, and those that are to be once they are checked; no run that nobody holds."""
    jobs = queue_in(tmp_path)
    held, unchecked = submitted(jobs), submitted(jobs, check=False)
    jobs.hold_waiting()
    newer = [submitted(jobs), submitted(jobs, check=False)]
    assert [view.job_id for view in jobs.views(2, held=True)] == [unchecked, held]
    assert [view.job_id for view in jobs.views(2)] == newer[::-1]
    jobs.cancel(unchecked)
    assert [view.job_id for view in jobs.views(2, held=True)] == [held]
    assert jobs.release((held,)) == 1
    assert jobs.views(2, held=True) == ()


def test_a_word_for_some_runs_leaves_the_others_held(tmp_path: Path) -> None:
    jobs = queue_in(tmp_path)
    first, second, unchecked = submitted(jobs), submitted(jobs), submitted(jobs, check=False)
    jobs.hold_waiting()
    assert jobs.release((second, unchecked)) == 2
    jobs.checked(unchecked, SAFE)
    assert phases(jobs) == {first: "held", second: "queued", unchecked: "queued"}
    assert jobs.release(()) == 0
    assert jobs.release((first, second)) == 1


@pytest.mark.parametrize(
    ("outcome", "exit_code", "phase", "planned"),
    [
        ("completed", 0, "done", True),
        ("completed", 1, "failed", False),
        ("stopped", 1, "stopped", False),
        ("dropped", 1, "stopped", False),
        ("no_robot", 69, "failed", False),
        (None, 1, "refused", False),
        (None, 69, "failed", False),
        (None, 70, "failed", False),
    ],
)
def test_how_a_run_ended_is_how_its_job_ends(
    tmp_path: Path, outcome: str | None, exit_code: int, phase: str, planned: bool
) -> None:
    jobs = queue_in(tmp_path)
    job_id = submitted(jobs)
    told = None
    if outcome is not None:
        told = RunOutcome(run_id=job_id, outcome=outcome, exit_code=exit_code, sentences=(), out_dir="")  # type: ignore[arg-type]
    assert jobs.run_ended(RunEnded(job_id, told, "Why.", exit_code)) is planned
    assert phases(jobs)[job_id] == phase
    assert jobs.store.jobs[job_id].sentence == "Why."


def test_a_verdict_on_a_job_cancelled_meanwhile_changes_nothing(tmp_path: Path) -> None:
    jobs = queue_in(tmp_path)
    job_id = submitted(jobs, check=False)
    jobs.cancel(job_id)
    jobs.checked(job_id, SAFE)
    assert phases(jobs)[job_id] == "cancelled"


def test_who_wants_to_cancel_a_fit_is_not_sent_to_stop_the_arm(tmp_path: Path) -> None:
    jobs = queue_in(tmp_path)
    job_id = submitted(jobs)
    jobs.queue_fit(job_id)
    jobs.fit_started(f"{job_id}-fit", 1)
    with pytest.raises(RefusedRequestError) as caught:
        jobs.cancel(f"{job_id}-fit")
    assert "moves nothing" in str(caught.value)
    assert "stop" not in str(caught.value)


@pytest.mark.parametrize("phase", ["preparing", "running", "done", "refused"])
def test_only_what_waits_can_be_cancelled(tmp_path: Path, phase: JobPhase) -> None:
    jobs = queue_in(tmp_path)
    job_id = submitted(jobs)
    jobs.store.change(job_id, phase, "")
    with pytest.raises(RefusedRequestError) as caught:
        jobs.cancel(job_id)
    assert caught.value.code == "not_waiting"


def test_the_queue_has_an_end(tmp_path: Path) -> None:
    jobs = queue_in(tmp_path)
    for _ in range(MAXIMUM_WAITING):
        submitted(jobs)
    with pytest.raises(RefusedRequestError) as caught:
        submitted(jobs)
    assert caught.value.code == "queue_full"


def test_old_jobs_are_forgotten_but_runs_never_deleted(tmp_path: Path) -> None:
    jobs = queue_in(tmp_path)
    oldest = submitted(jobs)
    (tmp_path / oldest).mkdir()
    job = jobs.store.change(oldest, "done", "")
    for number in range(MAXIMUM_KEPT):
        jobs.store.jobs[f"x{number}"] = msgspec.structs.replace(job, job_id=f"x{number}")
    submitted(jobs)
    jobs.close()
    assert oldest not in jobs.store.jobs
    assert not jobs.store.folder_of(oldest).exists()
    assert (tmp_path / oldest).is_dir()


def test_a_job_file_that_cannot_be_read_is_named_and_the_others_are_kept(tmp_path: Path) -> None:
    jobs = queue_in(tmp_path)
    good, bad = submitted(jobs), submitted(jobs)
    jobs.close()
    (jobs.store.folder_of(bad) / "job.json").write_text('{"job_id": ')
    told: list[str] = []
    again = JobQueue(DaemonConfig(output=str(tmp_path)), told.append)
    assert set(phases(again)) == {good}
    assert bad in told[0]


def test_the_file_of_an_investigation_without_an_order_is_left_out(tmp_path: Path) -> None:
    """A file that is JSON and lacks what the step needs ended the service at each of its starts."""
    jobs = queue_in(tmp_path)
    good = submitted(jobs)
    jobs.store.flush()
    whole = (jobs.store.folder_of(good) / "job.json").read_text()
    file = jobs.store.folder / "odd" / "job.json"
    file.parent.mkdir()
    file.write_text(whole.replace(good, "odd").replace('"kind": "run"', '"kind": "investigation"'))
    told: list[str] = []
    again = JobQueue(DaemonConfig(output=str(tmp_path)), told.append)
    assert set(phases(again)) == {good}
    assert str(file) in told[0]


def test_a_disk_that_refuses_is_said_to_the_submitter_and_nothing_is_queued(tmp_path: Path) -> None:
    jobs = queue_in(tmp_path)
    jobs.store.folder.rmdir()
    refused: list[OSError | None] = []
    stored = threading.Event()

    def done(job_id: str, error: OSError | None) -> None:
        refused.append(error)
        stored.set()

    jobs.add(SubmitRun(), done)
    assert stored.wait(WATCHDOG_S)
    assert isinstance(refused[0], FileNotFoundError)


def test_each_port_has_a_queue_of_its_own(tmp_path: Path) -> None:
    one = JobQueue(msgspec.convert({"output": str(tmp_path), "fri": {"bind_port": 30201}}, DaemonConfig), print)
    submitted(one)
    assert queue_in(tmp_path).store.jobs == {}


def test_a_fit_that_ended_says_how(tmp_path: Path) -> None:
    jobs = queue_in(tmp_path)
    job_id = submitted(jobs)
    jobs.queue_fit(job_id)
    jobs.fit_ended(FitEnded(f"{job_id}-fit", "Bad data.", 65))
    assert jobs.store.jobs[f"{job_id}-fit"].phase == "failed"
    unwanted = submitted(jobs, fit=False)
    jobs.queue_fit(unwanted)
    assert f"{unwanted}-fit" not in jobs.store.jobs


def test_a_fit_that_the_system_is_still_starting_is_alive_and_a_thread_of_the_system_is_no_fit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    monkeypatch.setattr(psutil.Process, "cmdline", lambda _: [])
    assert fit_is_alive(child.pid, tmp_path)
    assert not fit_is_alive(1, tmp_path)
    child.communicate(b"\n", WATCHDOG_S)
    assert not fit_is_alive(child.pid, tmp_path)
