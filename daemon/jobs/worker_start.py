"""Starting a fit as a process of its own, which nobody needs to wait for and which outlives whoever started it."""

from __future__ import annotations

import contextlib
import shlex
import threading
from pathlib import Path

import msgspec

from daemon.api import RunOutcome, WorkerJob, WorkerStatus
from daemon.children import start_python
from daemon.errors import DaemonError, LogIOError
from daemon.json_files import read_json, write_json
from daemon.times import now_text

JOB_NAME = "worker_job.json"
"""The WorkerJob in the folder of its run."""


def start_worker(outcome: RunOutcome) -> RunOutcome:
    """Start the fit of a finished run; the outcome with the worker's pid and status file.

    Where the disk refuses its files, the outcome with a sentence and exit code 74: the run itself is over and recorded.
    """
    folder = Path(outcome.out_dir)
    job = fit_of(outcome, outcome.run_id, folder)
    try:
        pid = launch(job, folder / JOB_NAME)
    except LogIOError as error:
        sentence = f"The fit was not started: {error} The recording is whole; `{command_for(job)}` fits it."
        return msgspec.structs.replace(
            outcome, sentences=(*outcome.sentences, sentence), exit_code=outcome.exit_code or error.exit_code
        )
    return msgspec.structs.replace(outcome, worker_pid=pid, worker_status_file=job.status_file)


def fit_of(outcome: RunOutcome, job_id: str, folder: Path) -> WorkerJob:
    """The fit of a finished run, and the diagnosis after it where the run asked for one; folder: of the run."""
    request = outcome.request
    assert request is not None
    return WorkerJob(
        job_id=job_id,
        recordings=outcome.recordings,
        robot=request.urdf_file or request.robot,
        model_file=str(folder / "model.json"),
        status_file=str(folder / "worker_status.json"),
        pipeline=request.fit_pipeline,
        diagnosis_folder=str(folder / "diagnosis") if request.diagnose else None,
        heldout=request.heldout,
    )


def command_for(job: WorkerJob) -> str:
    """What an operator says for the same fit."""
    return f"iiwa-ident fit {shlex.join(job.recordings)} --out {shlex.quote(job.model_file)}"


def launch(job: WorkerJob, job_file: Path) -> int:
    """Start `python -m daemon.jobs.worker` for the job, detached from this process and its terminal; its pid.

    Raises LogIOError when job file or first status cannot be written.
    """
    log = job_file.with_name("worker.log")
    try:
        write_json(job_file, job)
        waiting = WorkerStatus(job_id=job.job_id, phase="queued", sentence="The fit was started.")
        write_json(job.status_file, waiting)
        with log.open("ab") as stream:
            process = start_python("daemon.jobs.worker", ["--job", str(job_file)], stream)
    except OSError as error:
        raise LogIOError(str(job_file), error) from error
    # Reaped when it ends while we live, so that a process that is gone also looks gone.
    threading.Thread(target=lambda: note_end(job, process.wait()), name="worker reaper", daemon=True).start()
    return process.pid


def note_end(job: WorkerJob, return_code: int | None) -> WorkerStatus:
    """Status of a fit whose process is gone; one that could not say so itself, because it was killed, is "failed" now.

    return_code: None where nobody knows it. Raises MissingInputError or ConfigurationError where there is no status.
    """
    status = read_json(job.status_file, WorkerStatus)
    if status.phase in ("done", "failed"):
        return status
    killed = return_code is None or return_code < 0
    how = f"was killed by signal {-return_code}" if return_code and return_code < 0 else "ended without a result"
    status = msgspec.structs.replace(
        status,
        phase="failed",
        sentence=(
            f"The fit's process {how} while {status.phase}; the recording is untouched. Repeat the fit with "
            f"`{command_for(job)}`; worker.log has its last words."
        ),
        updated_at=now_text(),
        exit_code=1 if killed else DaemonError.exit_code,
    )
    with contextlib.suppress(OSError):
        write_json(job.status_file, status)
    return status
