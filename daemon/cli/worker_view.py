"""Watching a detached fit: the worker goes on without us, so this only reads its status file."""

from __future__ import annotations

import time
from pathlib import Path

import psutil

from daemon.api import WorkerStatus
from daemon.cli.output import message
from daemon.cli.progress import progress_shown
from daemon.errors import ChildProcessFailedError
from daemon.json_files import read_json

_POLL_S = 0.2
_START_ALLOWANCE_S = 60.0


def wait_for_worker(status_file: Path) -> WorkerStatus:
    """Show each phase of a fit until it is done; returns its last status, which may be "failed".

    Raises ChildProcessFailedError when the worker's process is gone without having said so.
    """
    waited_s = 0.0
    with progress_shown() as show:
        while True:
            status = read_json(status_file, WorkerStatus) if status_file.exists() else None
            if status is not None:
                if status.phase in ("done", "failed"):
                    break
                show(status.sentence.rstrip("."), status.fraction)
            alive = status is None or not status.pid or psutil.pid_exists(status.pid)
            if not alive or (status is None and waited_s > _START_ALLOWANCE_S):
                raise ChildProcessFailedError("fit", None, "its status file stopped changing")
            time.sleep(_POLL_S)
            waited_s += _POLL_S
    message(f"Fit: {status.sentence}")
    return status
