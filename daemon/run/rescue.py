"""The last resort of the loop's process: supervisor and recorder are both gone, and the ring holds what nobody wrote.

Here: finding out that nobody else is left, writing the rest into the run's folder, and the account of such a run. Not
here: the loop itself, which has ended before (the arm stands, or the session is lost, and no datagram is answered any
more), and the recorder's work, which is done by the recorder's own code in this process.
"""

from __future__ import annotations

import contextlib
import errno
import os
import signal
import sys
import time
from pathlib import Path

import psutil

from daemon.api import LoopReport, RecorderJob, RunRequest
from daemon.children import processes_of
from daemon.errors import DaemonError, LogIOError
from daemon.log.parts import join_parts, part_path, parts_of
from daemon.log.recover import RecoverReport
from daemon.log.stream import is_being_written
from daemon.run.account import leave_outcome
from daemon.run.recorder import Recorder
from daemon.run.spare_folder import spare_folder
from daemon.signals import handled
from fri_client.handover.ring import HandoverRing

RECORDER_PATIENCE_S = 10.0
"""A recorder that takes nothing out of a ring that holds something for so long does not come back."""
CLOSING_PATIENCE_S = 60.0
"""So long it may take to close its file once the ring is empty."""
POLL_S = 0.1
_STOPS = (signal.SIGINT, signal.SIGTERM)


def close_books_alone(request: RunRequest, ring: HandoverRing, report: LoopReport | None, exit_code: int) -> None:
    """Everything that is left to do for a run whose supervisor is gone: the rest of its samples, and run.json.

    report: the loop's own, None where it could make none.
    """
    rescue_if_abandoned(request, ring)
    if report is not None:
        with handled(_STOPS, signal.SIG_IGN):  # what is written meanwhile stands nowhere else
            leave_outcome(request, report, exit_code, writer="the loop's process", ring=ring)


def rescue_if_abandoned(request: RunRequest, ring: HandoverRing) -> RecoverReport | None:
    """Write what the finished ring still holds and join it with what the killed recorder left; None where all is well.

    To be called when the supervisor is gone. While a recorder is at work it is waited for: it may be killed too, and
    the memory of the ring would go with this process. One that does not go on (SIGSTOP) is killed for that reason.
    What goes wrong is said on stderr.
    """
    folder = Path(request.out_dir)
    _wait_for_recorder(folder, ring)
    if not ring.backlog:
        return None
    try:
        with handled(_STOPS, signal.SIG_IGN):
            parts = _write_rest(request, ring, folder)
            report = join_parts(parts) if len(parts) > 1 else None
    except (DaemonError, OSError) as error:
        print(error, file=sys.stderr)
        return None
    if report is not None:
        print(f"Supervisor and recorder were gone: {' '.join(report.sentences)}", file=sys.stderr)
    return report


def _wait_for_recorder(folder: Path, ring: HandoverRing) -> None:
    """Return when no recorder writes into the folder, if need be by killing one that does not go on."""
    backlog, since, ended = ring.backlog, time.monotonic(), False
    while any(is_being_written(part) for part in parts_of(folder)):
        time.sleep(POLL_S)
        if ring.backlog != backlog:
            backlog, since = ring.backlog, time.monotonic()
        elif time.monotonic() - since > (RECORDER_PATIENCE_S if backlog or ended else CLOSING_PATIENCE_S):
            if ended:
                return
            _end_recorders(folder)
            ended, since = True, time.monotonic()


def _end_recorders(folder: Path) -> None:
    for process in processes_of("daemon.run.recorder", folder):
        with contextlib.suppress(psutil.Error):
            process.kill()
            print(f"The recorder (process {process.pid}) did not go on and was ended.", file=sys.stderr)


def _write_rest(request: RunRequest, ring: HandoverRing, folder: Path) -> list[Path]:
    """The rest of the ring in a part of its own; in the system's temporary folder when the run's disk refuses.

    Returns all parts of the recording. Raises LogIOError, OSError when that folder refuses too; nothing else is left.
    """
    parts = parts_of(folder)
    consumer = HandoverRing.attach(ring.fd)
    try:
        while True:
            path = part_path(folder, len(parts))
            job = RecorderJob(request=request, path=str(path), part=len(parts))
            refusal = None
            try:
                code = Recorder(job, consumer, lambda _: None).run()
            except LogIOError as error:
                code, refusal = error.exit_code, error
            if path.is_file():
                parts.append(path)
            if code == 0:
                return parts
            if folder != Path(request.out_dir):
                raise refusal or LogIOError(str(path), OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)))
            folder = spare_folder(request)
            print(f"{request.out_dir} cannot be written; the rest of the recording goes to {folder}.", file=sys.stderr)
    finally:
        consumer.close()
