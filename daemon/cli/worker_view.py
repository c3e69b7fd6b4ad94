"""Watching a detached fit: the worker goes on without us, so this only reads its status file."""

from __future__ import annotations

import time
from pathlib import Path

import psutil

from daemon.api import WorkerJob, WorkerStatus
from daemon.cli.output import message
from daemon.cli.progress import progress_shown
from daemon.jobs.worker_start import JOB_NAME, command_for, note_end
from daemon.json_files import read_json

_POLL_S = 0.2


def wait_for_worker(folder: Path, pid: int) -> WorkerStatus:
    """Show each phase of a fit until it is done; returns its last status, which may be "failed".

    folder: of the run. A process that is gone without a word has failed, and its status then says so.
    """
    job = read_json(folder / JOB_NAME, WorkerJob)
    with progress_shown() as show:
        while True:
            alive = psutil.pid_exists(pid)
            # Read after the question, so that what it said with its last breath counts.
            status = read_json(job.status_file, WorkerStatus) if alive else note_end(job, None)
            if status.phase in ("done", "failed"):
                break
            show(status.sentence.rstrip("."), status.fraction)
            time.sleep(_POLL_S)
    message(f"Fit: {status.sentence}")
    return status


def settle_fit(folder: Path) -> str:
    """The sentence for a fit of this run whose process is gone without a word, which its status then says as well, or
    that never began because the disk took its job and not its status; empty where there is none.
    """
    if not (folder / JOB_NAME).is_file():
        return ""
    job = read_json(folder / JOB_NAME, WorkerJob)
    if not Path(job.status_file).exists():
        return f"The fit of this run never began; `{command_for(job)}` fits it."
    status = read_json(job.status_file, WorkerStatus)
    if status.phase in ("done", "failed") or (status.pid and psutil.pid_exists(status.pid)):
        return ""
    return note_end(job, None).sentence
