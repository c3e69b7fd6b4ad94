"""The threads of the service: checks of motions, the run, the fit. Each waits so that the control thread need not.

Here: what is waited for, and the results that come back through `post`. Not here: what is done about them (`server`).
None of them is asked for a stop: that goes from the control thread to the ring (`stop_handle`).
"""

from __future__ import annotations

import os
import queue
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import psutil

from daemon.api import RunEvent, RunOutcome, RunRequest, WorkerJob, WorkerStatus
from daemon.errors import exit_code_of, sentence_of
from daemon.jobs.worker_start import JOB_NAME, fit_of, launch, note_end
from daemon.json_files import read_json
from daemon.queue.investigation_step import StepEnded
from daemon.queue.job_preparation import Preparation, PreparationJob, Verdict
from daemon.queue.job_store import Job, JobStore
from daemon.run.service import run_acquisition
from daemon.stop_handle import StopHandle

_FIT_POLL_S = 0.5
_FIT_NICENESS = 10


@dataclass(frozen=True, slots=True)
class Stored:
    """A submitted job is on the disk, or not; `address` waits for the answer."""

    job_id: str
    address: list[bytes]
    error: OSError | None


@dataclass(frozen=True, slots=True)
class Checked:
    """The check at submission has ended."""

    job_id: str
    verdict: Verdict


@dataclass(frozen=True, slots=True)
class Prepared:
    """The check before the run has ended."""

    job_id: str
    verdict: Verdict
    request: RunRequest | None


@dataclass(frozen=True, slots=True)
class RunEnded:
    """The acquisition has ended; outcome: none where it could not begin."""

    job_id: str
    outcome: RunOutcome | None
    sentence: str
    exit_code: int


@dataclass(frozen=True, slots=True)
class FitStarted:
    """The fit's process runs."""

    job_id: str
    pid: int


@dataclass(frozen=True, slots=True)
class FitEnded:
    """The fit has ended, well with exit code 0."""

    job_id: str
    sentence: str
    exit_code: int


Posted: TypeAlias = Stored | Checked | Prepared | RunEvent | RunEnded | FitStarted | FitEnded | StepEnded
Post: TypeAlias = Callable[[Posted], None]


class Checker:
    """Checks submitted motions one after the other, and the next run's motion beside them."""

    def __init__(self, post: Post) -> None:
        self._post = post
        self._work: queue.SimpleQueue[PreparationJob] = queue.SimpleQueue()
        self._current: Preparation | None = None
        self._before_run: Preparation | None = None
        threading.Thread(target=self._serve, name="checks", daemon=True).start()

    def check(self, job: PreparationJob) -> None:
        """Queue the check at submission; the answer is posted."""
        self._work.put(job)

    def prepare(self, job: PreparationJob) -> None:
        """Begin the check before a run; the answer is posted."""
        preparation = self._before_run = Preparation(job)

        def work() -> None:
            verdict, request = preparation.run()
            self._post(Prepared(job.job_id, verdict, request))

        threading.Thread(target=work, name="preparation", daemon=True).start()

    def break_off(self) -> None:
        """End the check before a run; its answer, posted as always, says so."""
        if self._before_run is not None:
            self._before_run.cancel()

    def close(self) -> None:
        """End everything under way."""
        self.break_off()
        if self._current is not None:
            self._current.cancel()

    def _serve(self) -> None:
        while True:
            job = self._work.get()
            self._current = Preparation(job)
            verdict, _ = self._current.run()
            self._post(Checked(job.job_id, verdict))


def start_run(job_id: str, request: RunRequest, stop: StopHandle, store: JobStore, post: Post) -> threading.Thread:
    """Begin the acquisition in a thread of its own; its events are posted, and its end, whatever it is."""

    def work() -> None:
        # A service that dies from here on finds the job as running when it comes back.
        store.flush()
        try:
            outcome = run_acquisition(request, observe=post, stop=stop, port_is_locked=True)
            post(RunEnded(job_id, outcome, " ".join(outcome.sentences), outcome.exit_code))
        except Exception as error:
            post(RunEnded(job_id, None, sentence_of(error), exit_code_of(error)))

    # No daemon thread: an arm may be moving.
    thread = threading.Thread(target=work, name="run")
    thread.start()
    return thread


def start_fit(job: Job, post: Post) -> None:
    """Begin the fit of a finished run, or watch one that goes on already; its end is posted."""

    def work() -> None:
        try:
            pid = job.worker_pid
            if pid is None:
                pid = _launch(job)
                post(FitStarted(job.job_id, pid))
            post(_wait_for_fit(job.job_id, Path(job.folder), pid))
        except Exception as error:
            post(FitEnded(job.job_id, sentence_of(error), exit_code_of(error)))

    threading.Thread(target=work, name="fit", daemon=True).start()


def _launch(job: Job) -> int:
    folder = Path(job.folder)
    outcome = read_json(folder / "run.json", RunOutcome)
    pid = launch(fit_of(outcome, job.job_id, folder), folder / JOB_NAME)
    # Another motion may be under way: the loop comes first.
    psutil.Process(pid).nice(_FIT_NICENESS)
    return pid


def _wait_for_fit(job_id: str, folder: Path, pid: int) -> FitEnded:
    work = read_json(folder / JOB_NAME, WorkerJob)
    while True:
        lives = fit_is_alive(pid, folder)
        status = read_json(work.status_file, WorkerStatus) if lives else note_end(work, None)
        if status.phase in ("done", "failed"):
            return FitEnded(job_id, status.sentence, status.exit_code or 0)
        time.sleep(_FIT_POLL_S)


def fit_is_alive(pid: int, folder: Path) -> bool:
    """Whether the process `pid` still is the fit of the run in `folder` (numbers of processes are used again)."""
    try:
        process = psutil.Process(pid)
        words = process.cmdline()
        # A child has no words for a moment after its start; nor have the system's own threads.
        is_ours = str(folder / JOB_NAME) in words if words else process.ppid() == os.getpid()
        return is_ours and process.status() != psutil.STATUS_ZOMBIE
    except psutil.Error:
        return False
