"""The queue on disk: one JSON file per job, written in one step, so that a restart loses none.

Here: the record of a job, its file, and the thread that writes. Not here: what is done with jobs (`server`). The thread
that hears the operator never waits for the disk: it hands records over and is told when they are safe.

    <folder>/<job id>/job.json           the record
    <folder>/<job id>/trajectory.json    what was submitted (.npz, .csv likewise)
    <folder>/<job id>/checked/           table and trajectory of the check at submission
"""

from __future__ import annotations

import contextlib
import queue
import shutil
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import msgspec

from daemon.errors import DaemonError, LogIOError
from daemon.json_files import read_json, write_bytes_atomically, write_json
from daemon.queue.control_api import JobKind, JobPhase, JobView
from daemon.queue.investigation_step import Order
from daemon.times import now_text

MAXIMUM_WAITING = 100
"""Jobs that wait at the same time; more are refused."""
MAXIMUM_KEPT = 500
"""Ended jobs remembered; the folders of the runs themselves are never removed."""
ENDED: frozenset[JobPhase] = frozenset({"done", "refused", "stopped", "failed", "interrupted", "cancelled"})


class Job(JobView, frozen=True, kw_only=True):
    """A run, a fit or an investigation, as it stands in its file: what clients see of it, and what they do not.

    folder: of the run, absolute. confirmed: see SubmitRun. suffix: of the submitted file, none for the shipped motion.
    fit: whether one follows the run. worker_pid, attempts: of a fit.

    order: of the step that an investigation takes or waits for, of the last one else. thinking: that step is under way.
    motions: runs it had so far. unasked: they wait for nobody. asked_by: the investigation that a run belongs to.
    trajectory: its file; None: what was submitted. added_mass: on the flange in it.
    number: of the motion. asks: what it is for.
    """

    periods: int = 0
    amplitude: float = 1.0
    confirmed: bool = False
    suffix: str | None = None
    fit: bool = False
    worker_pid: int | None = None
    attempts: int = 0
    order: Order | None = None
    thinking: bool = False
    motions: int = 0
    unasked: bool = False
    asked_by: str | None = None
    trajectory: str | None = None
    added_mass: tuple[float, float, float, float] | None = None
    number: int = 0
    asks: str = ""

    def __post_init__(self) -> None:
        """Raise ValueError, which a reader of its file says, for an investigation that knows no next step."""
        if self.kind == "investigation" and self.order is None:
            raise ValueError("An investigation needs an order")

    def view(self) -> JobView:
        """What clients see of it."""
        seen = {name: getattr(self, name) for name in JobView.__struct_fields__}
        return JobView(**(seen if self.kind == "run" else seen | {"periods": None, "amplitude": None}))


class JobStore:
    """All jobs by number, oldest first; a thread of its own writes them. Only one thread may change jobs."""

    def __init__(self, folder: Path) -> None:
        """Make the folder (0700) and read what stands there. Raises LogIOError."""
        self.folder = folder
        self.unreadable: list[str] = []
        try:
            folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            files = sorted(folder.glob("*/job.json"))
        except OSError as error:
            raise LogIOError(str(folder), error) from error
        self.jobs: dict[str, Job] = {}
        for file in files:
            try:
                job = read_json(file, Job)
            except DaemonError as error:
                self.unreadable.append(str(error))
            else:
                self.jobs[job.job_id] = job
        self._work: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._write, name="job files", daemon=True)
        self._thread.start()

    def folder_of(self, job_id: str) -> Path:
        """Where the files of a job are."""
        return self.folder / job_id

    def add(self, job: Job, trajectory: bytes | None, done: Callable[[OSError | None], None] | None = None) -> None:
        """Take a new job in; the writing thread calls `done` once it is on the disk, or with what prevents it."""
        now = now_text()
        job = msgspec.structs.replace(job, submitted_at=now, updated_at=now)
        self.jobs[job.job_id] = job
        self._prune()

        def write() -> None:
            folder = self.folder_of(job.job_id)
            refused: OSError | None
            try:
                folder.mkdir(exist_ok=True, mode=0o700)
                if trajectory is not None:
                    write_bytes_atomically(folder / f"trajectory{job.suffix}", trajectory)
                write_json(folder / "job.json", job)
            except OSError as error:
                shutil.rmtree(folder, ignore_errors=True)
                refused = error
            else:
                refused = None
            if done is not None:
                done(refused)

        self._work.put(write)

    def change(self, job_id: str, phase: JobPhase, sentence: str, **changes: Any) -> Job:
        """A job's new phase, at once in memory and soon on disk. A disk that refuses is no reason to stop working."""
        job = msgspec.structs.replace(
            self.jobs[job_id], phase=phase, sentence=sentence, updated_at=now_text(), **changes
        )
        self.jobs[job_id] = job

        def write() -> None:
            with contextlib.suppress(OSError):
                write_json(self.folder_of(job_id) / "job.json", job)

        self._work.put(write)
        return job

    def forget(self, job_id: str) -> None:
        """Drop a job that never got to the disk."""
        self.jobs.pop(job_id, None)

    def first(self, kind: JobKind, phase: JobPhase) -> Job | None:
        """The oldest job of this kind and phase."""
        return next(iter(self.all(kind, phase)), None)

    def all(self, kind: JobKind, *phases: JobPhase) -> list[Job]:
        """All jobs of this kind in one of the phases, oldest first."""
        return [job for job in self.jobs.values() if job.kind == kind and job.phase in phases]

    def flush(self, timeout_s: float = 10.0) -> bool:
        """Wait until everything said so far is on the disk; for threads that may wait."""
        written = threading.Event()
        self._work.put(written.set)
        return written.wait(timeout_s)

    def close(self) -> None:
        """Write what is left and end the thread."""
        self._work.put(None)
        self._thread.join(10.0)

    def _write(self) -> None:
        while (work := self._work.get()) is not None:
            work()

    def _prune(self) -> None:
        ended = [job.job_id for job in self.jobs.values() if job.phase in ENDED]
        for job_id in ended[: max(0, len(ended) - MAXIMUM_KEPT)]:
            del self.jobs[job_id]
            folder = self.folder_of(job_id)
            self._work.put(partial(shutil.rmtree, folder, ignore_errors=True))
