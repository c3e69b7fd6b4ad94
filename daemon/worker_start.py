"""Starting a fit as a process of its own, which nobody needs to wait for and which outlives whoever started it."""

from __future__ import annotations

import subprocess
import sys
import threading
from pathlib import Path

import msgspec

from daemon.api import RunOutcome, WorkerJob, WorkerStatus
from daemon.children import child_environment
from daemon.errors import LogIOError
from daemon.json_files import write_json

__all__ = ["launch", "start_worker"]


def start_worker(outcome: RunOutcome) -> RunOutcome:
    """Start the fit of a finished run; the outcome with the worker's pid and status file. Raises LogIOError."""
    assert outcome.request is not None
    folder = Path(outcome.out_dir)
    job = WorkerJob(
        job_id=outcome.run_id,
        recordings=outcome.recordings,
        robot=outcome.request.urdf_file or outcome.request.robot,
        model_file=str(folder / "model.json"),
        status_file=str(folder / "worker_status.json"),
        pipeline=outcome.request.fit_pipeline,
        diagnosis_folder=str(folder / "diagnosis") if outcome.request.diagnose else None,
        heldout=outcome.request.heldout,
    )
    pid = launch(job, folder / "worker_job.json")
    return msgspec.structs.replace(outcome, worker_pid=pid, worker_status_file=job.status_file)


def launch(job: WorkerJob, job_file: Path) -> int:
    """Start `python -m daemon.worker` for the job, detached from this process and its terminal; its pid.

    Raises LogIOError when job file or first status cannot be written.
    """
    log = job_file.with_name("worker.log")
    try:
        write_json(job_file, job)
        waiting = WorkerStatus(job_id=job.job_id, phase="queued", sentence="The fit was started.")
        write_json(job.status_file, waiting)
        with log.open("ab") as stream:
            process = subprocess.Popen(
                [sys.executable, "-m", "daemon.worker", "--job", str(job_file)],
                stdin=subprocess.DEVNULL,
                stdout=stream,
                stderr=stream,
                start_new_session=True,
                close_fds=True,
                env=child_environment(),
            )
    except OSError as error:
        raise LogIOError(str(job_file), error) from error
    # Reaped when it ends while we live, so that a process that is gone also looks gone.
    threading.Thread(target=process.wait, name="worker reaper", daemon=True).start()
    return process.pid
