"""The last resort of the loop's process: supervisor and recorder are both gone, and the ring holds what nobody wrote.

Here: finding out that nobody else is left, writing the rest into the run's folder, and the account of such a run. Not
here: the loop itself, which has ended before (the arm stands, or the session is lost, and no datagram is answered any
more), and the recorder's work, which is done by the recorder's own code in this process. The loop's process calls it at
its very end.
"""

from __future__ import annotations

import errno
import os
import signal
import sys
import time
from pathlib import Path

from daemon.api import LoopReport, RecorderJob, RunOutcome, RunRequest
from daemon.commissioning import tags
from daemon.errors import DaemonError, LogIOError
from daemon.host import software_versions
from daemon.log.parts import RECORDING_NAME, join_parts, part_path, parts_of, recover
from daemon.log.recover import RecoverReport
from daemon.log.stream import is_being_written
from daemon.outcome import digests_of, outcome_sentences
from daemon.recorder import Recorder
from daemon.spare_folder import spare_folder, write_run_file
from daemon.times import now_text
from fri_client.handover import HandoverRing

__all__ = ["leave_outcome", "rescue_if_abandoned"]

RECORDER_PATIENCE_S = 60.0
POLL_S = 0.1


def rescue_if_abandoned(request: RunRequest, ring: HandoverRing) -> RecoverReport | None:
    """Write what the finished ring still holds and join it with what the killed recorder left; None where all is well.

    To be called when the supervisor is gone. While a recorder lives it is waited for: it may be killed too, and the
    memory of the ring would go with this process. What goes wrong is said on stderr.
    """
    folder = Path(request.out_dir)
    deadline = time.monotonic() + RECORDER_PATIENCE_S
    while any(is_being_written(part) for part in parts_of(folder)):
        if time.monotonic() > deadline:
            return None
        time.sleep(POLL_S)
    if not ring.backlog:
        return None
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    try:
        parts = _write_rest(request, ring, folder)
        report = join_parts(parts) if len(parts) > 1 else None
    except (DaemonError, OSError) as error:
        print(error, file=sys.stderr)
        return None
    if report is not None:
        print(f"Supervisor and recorder were gone: {' '.join(report.sentences)}", file=sys.stderr)
    return report


def leave_outcome(request: RunRequest, report: LoopReport, exit_code: int) -> None:
    """run.json of a run whose supervisor is gone, where it left none; a sentence says who wrote it.

    The samples in the periods are not counted, and no fit was started. What the disk refuses is said on stderr.
    """
    folder = Path(request.out_dir)
    if (folder / "run.json").exists():
        return
    gone = (
        "The supervising process was gone at the end: this account was written by the loop's process, and no fit was "
        "started; `iiwa-ident fit` takes the recording."
    )
    samples = missing = lost = 0
    try:
        held = recover(folder)
        samples, missing, lost = held.samples, held.missing, held.missing_in_handover
    except DaemonError as error:
        gone += f" {error}"
    recording = folder / RECORDING_NAME
    outcome = RunOutcome(
        run_id=request.run_id,
        outcome=report.outcome,
        exit_code=exit_code,
        sentences=outcome_sentences(report, request, samples, missing, lost, (gone,)),
        out_dir=str(folder),
        recordings=(str(recording),) if recording.is_file() else (),
        samples=samples,
        sequence_gaps=missing,
        handover_gaps=lost,
        loop=report,
        files=digests_of(folder, recording),
        software=software_versions(),
        request=request,
        finished_at=now_text(),
        commissioning=tags(request),
    )
    try:
        write_run_file(request, "run.json", outcome)
    except LogIOError as error:
        print(error, file=sys.stderr)


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
