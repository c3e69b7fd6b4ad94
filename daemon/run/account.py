"""run.json of a run whose supervisor is gone, written by whoever is left: the loop's process, the recorder, `recover`.

Here: what can be said of such a run from its folder. Not here: the run.json of a run whose supervisor lives
(`service`), and the samples (`rescue`, `log.parts`).
"""

from __future__ import annotations

import sys
from pathlib import Path

import msgspec

from daemon.api import EXIT_CODES, REPORT_NAME, RUN_NAME, LoopReport, RunOutcome, RunRequest
from daemon.errors import DaemonError, LogIOError
from daemon.host import software_versions
from daemon.json_files import read_json
from daemon.log.parts import RECORDING_NAME, recover
from daemon.log.recover import RecoverReport
from daemon.run.judgement import judged
from daemon.run.ladder import tags
from daemon.run.outcome import digests_of, lost_between, lost_messages, outcome_sentences, tidy
from daemon.run.spare_folder import files_elsewhere, write_run_file
from daemon.times import now_text
from fri_client.handover.ring import HandoverRing

_SUPERVISOR_GONE = "The supervising process was gone at the end"


def leave_outcome(
    request: RunRequest, report: LoopReport, exit_code: int, *, writer: str, ring: HandoverRing | None = None
) -> None:
    """Write run.json where there is none yet; what the disk refuses is said on stderr.

    writer: who says so. ring: the run's own, while it exists: what no file holds of it is counted as lost.
    """
    folder = Path(request.out_dir)
    if (folder / RUN_NAME).exists():
        return
    held, trouble = None, ""
    try:
        held = recover(folder)
    except DaemonError as error:
        trouble = f" {error}"
    try:
        gone = f"{_SUPERVISOR_GONE}: this account was written by {writer}"
        _write(request, report, exit_code, held, gone, trouble, ring)
    except LogIOError as error:
        print(error, file=sys.stderr)


def account_for_folder(folder: Path, held: RecoverReport) -> RunOutcome | None:
    """Write run.json into a folder whose processes were killed together, from what `recover` found in it.

    None where there is one already, or where no run was asked for here. Raises ConfigurationError for a request that
    cannot be read, LogIOError when the disk refuses.
    """
    if (folder / RUN_NAME).exists() or not (folder / "request.json").is_file():
        return None
    # The folder may have been moved since, or while its processes wrote on elsewhere.
    began = read_json(folder / "request.json", RunRequest)
    request = msgspec.structs.replace(began, out_dir=str(folder.absolute()))
    left = folder / REPORT_NAME
    if not left.is_file():
        left = files_elsewhere(began).get(REPORT_NAME, left)
    report = read_json(left, LoopReport) if left.is_file() else _report_from(request, held)
    elsewhere = kept_elsewhere(folder)
    gone = "The run lost this folder before its end" if elsewhere else _SUPERVISOR_GONE
    gone += ": this account was written by `iiwa-ident recover`"
    return _write(request, report, EXIT_CODES[report.outcome], held, gone, elsewhere and f" {elsewhere}", None)


def kept_elsewhere(folder: Path) -> str:
    """Where the rest of a run is that could not write into its folder any more, as a sentence; else empty."""
    if not (folder / "request.json").is_file():
        return ""
    files = files_elsewhere(read_json(folder / "request.json", RunRequest))
    places = {str(file.parent) for file in files.values()}
    return f"What its processes wrote from then on is in {places.pop()}: {', '.join(files)}." if places else ""


def _report_from(request: RunRequest, held: RecoverReport) -> LoopReport:
    """The report of a loop that left none, from the recording alone."""
    end = (
        "; the robot got no more answers and braked by itself, standstill unconfirmed."
        if held.samples
        else ". The recording holds no message of a robot: as far as it tells, nothing was moved by this run."
    )
    if request.monitor_only:
        end = "; no motion was commanded."
    return LoopReport(
        outcome="fault",
        reason="LOOP_LOST",
        sentence=f"Loop and supervisor ended without a word{end}",
        received=held.samples + held.missing_in_handover,
        answered=held.messages.get("/fri/command", 0),
        missing=held.missing,
        periods_completed=max(held.last_period, 0),
    )


def _write(
    request: RunRequest,
    report: LoopReport,
    exit_code: int,
    held: RecoverReport | None,
    gone: str,
    trouble: str,
    ring: HandoverRing | None,
) -> RunOutcome:
    folder = Path(request.out_dir)
    recording = folder / RECORDING_NAME if held is None else held.recovered
    samples, missing = (0, 0) if held is None else (held.samples, held.missing)
    lost = 0 if held is None else held.missing_in_handover
    if ring is not None:
        lost = lost_between(ring, lost, 0 if held is None else held.next_index)
    lost = lost_messages(max(lost, report.received - samples), report, samples)
    exit_code = exit_code or int(lost > 0)
    gone += ", and no fit was started"
    gone += f"; `iiwa-ident fit` takes the recording.{trouble}" if samples else f".{trouble}"
    tidy(folder)
    outcome = RunOutcome(
        run_id=request.run_id,
        outcome=report.outcome,
        exit_code=exit_code,
        sentences=outcome_sentences(report, request, samples, missing, lost, (gone,)),
        out_dir=str(folder),
        recordings=(str(recording),) if recording.is_file() else (),
        samples=samples,
        samples_in_periods=0 if held is None else held.samples_in_periods,
        sequence_gaps=missing,
        handover_gaps=lost,
        loop=report,
        files=digests_of(folder, recording),
        software=software_versions(),
        request=request,
        finished_at=now_text(),
        commissioning=tags(request),
    )
    write_run_file(request, RUN_NAME, outcome)
    outcome = judged(outcome)
    write_run_file(request, RUN_NAME, outcome)
    return outcome
