"""How a run ended, in words and numbers: exit codes, sentences, digests, and the report of a loop that left none.

Pure but for reading files to digest them, and for the last samples of a loop that was killed. The supervisor calls it.
"""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Sequence
from pathlib import Path

from daemon.api import (
    EXIT_CODES,
    LAST_SAMPLES_NAME,
    REPORT_NAME,
    RUN_NAME,
    FileDigest,
    LoopReport,
    RunOutcome,
    RunRequest,
)
from daemon.children import Child
from daemon.errors import EXIT_INTERRUPTED, DaemonError, FolderGoneError, LogIOError
from daemon.json_files import read_json, write_json
from daemon.run.link_diagnostics import COUNTS
from daemon.run.spare_folder import find_run_file, write_run_file
from daemon.times import now_text
from daemon.words import counted
from fri_client.handover.last_samples import read_last_samples
from fri_client.handover.ring import HandoverRing
from fri_client.messages import FriVersion
from fri_client.wire.codec import Codec


def digests_of(folder: Path, recording: Path) -> tuple[FileDigest, ...]:
    """Size and SHA-256 of the run's files; those outside the folder by their full path. The folder may be gone."""
    files = sorted(
        file for file in folder.glob("*") if file.is_file() and not file.name.startswith(".") and file.name != RUN_NAME
    )
    if recording.is_file() and recording not in files:
        files.append(recording)
    digests = []
    for file in files:
        with file.open("rb") as stream:
            digest = hashlib.file_digest(stream, "sha256").hexdigest()
        name = file.name if file.parent == folder else str(file)
        digests.append(FileDigest(name=name, bytes=file.stat().st_size, sha256=digest))
    return tuple(digests)


def tidy(folder: Path) -> None:
    """Remove what only the processes of a run needed: the recorders' jobs, and what nobody wrote a word into."""
    for file in (*folder.glob("recorder*.json"), *folder.glob("*.log")):
        with contextlib.suppress(OSError):
            if file.suffix == ".json" or not file.stat().st_size:
                file.unlink()


def lost_between(ring: HandoverRing, gaps: int, next_index: int) -> int:
    """Records that stand in no file: those that found the ring full, the holes in the file, and those after its end.

    gaps: holes between the indexes in the file; next_index: the first index after its last one (0: nothing in it).
    """
    return max(ring.lost, gaps + max(0, ring.produced + ring.lost - next_index))


def lost_messages(records: int, report: LoopReport, samples: int) -> int:
    """How many of the records that stand in no file held a message; the others held an event alone.

    samples: messages in the file. Where the report counts fewer it was not the loop's own, and knows nothing of it.
    """
    return min(records, report.received - samples) if report.received >= samples else records


def keep_last_samples(ring: HandoverRing, request: RunRequest, return_code: int | None) -> None:
    """The last two seconds of a loop that was killed, from its ring into the run's folder; as far as that is possible.

    Call it while nobody pushes any more and before the ring is marked as finished, so that the recorder finds the file.
    """
    last = read_last_samples(ring, Codec(FriVersion.parse(request.fri_version)))
    last.reason, last.sentence, last.tick = "LOOP_LOST", f"The loop process {_how(return_code)}.", ring.status.tick
    with contextlib.suppress(LogIOError):
        write_run_file(request, LAST_SAMPLES_NAME, last)


def _how(return_code: int | None) -> str:
    if return_code is None:
        return "ended without a report"
    return f"was killed by signal {-return_code}" if return_code < 0 else "crashed"


def loop_report_without_loop(
    request: RunRequest, ring: HandoverRing, return_code: int | None, last_words: str
) -> LoopReport:
    """The report of a loop that was killed or crashed, from the last status it left in the ring.

    return_code: None where nobody knows it.
    """
    status = ring.status
    words = f" Its last words: {last_words.strip().splitlines()[-1]}" if last_words.strip() else ""
    end = (
        "; the robot gets no more answers and brakes by itself, standstill unconfirmed."
        if status.received or ring.produced
        else " before a message of a robot came; nothing was moved by this run."
    )
    if request.monitor_only:
        end = "; no motion was commanded."
    return LoopReport(
        outcome="fault",
        reason="LOOP_LOST",
        sentence=f"The loop process {_how(return_code)}{end}{words}",
        tick=status.tick,
        foreign=status.foreign,
        lost_in_handover=ring.lost,
        periods_completed=status.periods_completed,
        **{name: getattr(status, name) for name in COUNTS},
    )


def report_of_loop(request: RunRequest, ring: HandoverRing, loop: Child) -> tuple[LoopReport, int]:
    """The report that the loop's process left, or one made for it; and its return code, or the exit code instead."""
    code, folder = loop.process.returncode, Path(request.out_dir)
    with contextlib.suppress(DaemonError):
        return read_json(find_run_file(request, REPORT_NAME), LoopReport), code
    if code <= 0 or ring.status.received or folder.is_dir():
        report = loop_report_without_loop(request, ring, code, loop.last_words)
        return report, EXIT_CODES[report.outcome]
    gone = FolderGoneError(str(folder))
    report = LoopReport(outcome="refused", reason=type(gone).__name__, sentence=str(gone))
    with contextlib.suppress(LogIOError):  # for `recover`, wherever the folder is now
        write_run_file(request, REPORT_NAME, report)
    return report, gone.exit_code


def exit_code_of_run(report: LoopReport, loop_exit_code: int, signal_number: int | None) -> int:
    """That of the loop's process, of its report where a signal ended it, or 130 where the operator's signal did."""
    if signal_number is not None and report.outcome in ("stopped", "not_started", "no_robot"):
        return EXIT_INTERRUPTED
    return loop_exit_code if loop_exit_code >= 0 else EXIT_CODES[report.outcome]


def stopped_nothing(outcome: RunOutcome) -> bool:
    """Whether a signal that came after the motion changed nothing of its outcome, so that nothing says it was heard.

    What only records ends well by a signal.
    """
    watched = outcome.request is not None and outcome.request.monitor_only
    return outcome.outcome == "completed" and not outcome.exit_code and not watched


def note_no_start(request: RunRequest, error: Exception, started_at: str) -> None:
    """Write run.json of a run whose processes could not be started, so that its folder may be written to again; as far
    as the disk allows.
    """
    folder, sentence = Path(request.out_dir), str(error)
    tidy(folder)
    outcome = RunOutcome(
        run_id=request.run_id,
        outcome="refused",
        exit_code=error.exit_code if isinstance(error, DaemonError) else LogIOError.exit_code,
        sentences=(sentence,),
        out_dir=request.out_dir,
        loop=LoopReport(outcome="refused", reason=type(error).__name__, sentence=sentence),
        request=request,
        started_at=started_at,
        finished_at=now_text(),
    )
    with contextlib.suppress(OSError):
        write_json(folder / RUN_NAME, outcome)


def outcome_sentences(
    report: LoopReport,
    request: RunRequest,
    samples: int,
    sequence_gaps: int,
    handover_gaps: int,
    remarks: Sequence[str],
) -> tuple[str, ...]:
    """What the operator reads at the end: the result first, then the count, then what was remarkable. The result alone
    where the folder went before the loop began: there is nothing to count.
    """
    if report.reason == FolderGoneError.__name__:
        return (report.sentence,)
    sentences = [report.sentence]
    lost = (
        f"{sequence_gaps} missing on the way from the robot, {handover_gaps} lost between loop and file"
        if sequence_gaps or handover_gaps
        else "none missing"
    )
    spacing, stated = report.message_spacing_ms, report.send_period_ms
    # A robot whose clock is not ours explains them; to the digits shown all others keep to their period.
    apart = spacing is not None and stated is not None and f"{spacing:.4f}" != f"{stated:.4f}"
    pace = f" (a message came every {spacing:.4f} ms, and the robot states {stated:g} ms)" if apart else ""
    held_back = f"{counted(report.held_back, 'answer')} held back{pace}, " if report.held_back else ""
    sentences.append(
        f"{counted(report.received, 'monitoring message')} received, {report.answered} answered, {held_back}"
        f"{report.late} late; {counted(samples, 'sample')} recorded, {lost}."
    )
    if report.outcome in ("stopped", "dropped", "fault") and samples and not request.monitor_only:
        sentences.append(
            f"{report.periods_completed} of {counted(request.periods, 'period', verb=True)} complete; "
            "the partial recording is kept."
        )
    return (*sentences, *remarks)
