"""What an operator does after a run, in one sentence. The command `run` prints it last."""

from __future__ import annotations

import shlex

from daemon.api import LAST_SAMPLES_NAME, RUN_NAME, RunOutcome, WorkerStatus
from daemon.errors import EXIT_INTERRUPTED, FolderGoneError, LogIOError
from daemon.run.folder import nothing_moved
from daemon.run.ladder import highest_allowed, needs_ladder
from daemon.run.spare_folder import find_run_file

_AGAIN = "Next: nothing moved; the same command can be given again."


def moved_away(outcome: RunOutcome) -> str:
    """Of a run whose folder is not there any more: where its account is, and what makes the rest whole."""
    if _never_began(outcome):
        return _AGAIN
    account = (
        "" if outcome.request is None else f" The account of the run is {find_run_file(outcome.request, RUN_NAME)}."
    )
    return (
        f"{outcome.out_dir} was moved or removed during the run.{account} Next: `iiwa-ident recover FOLDER`, with the "
        "place where the folder is now, makes what it holds whole and says where the rest is."
    )


def next_step(outcome: RunOutcome, fit: WorkerStatus | None) -> str:
    """The sentence. fit: how the fit ended, None where there was none."""
    request, folder = outcome.request, outcome.out_dir
    loop = outcome.loop
    if outcome.outcome == "version_mismatch":
        return "Next: the same command with the --fri-version that the first sentence names, or with `auto`."
    if outcome.outcome == "not_started":
        return (
            "Next: see to what the first sentence names, then give the same command again; `iiwa-ident doctor` with "
            "the same address looks at the link."
        )
    if outcome.outcome in ("no_robot", "port_in_use"):
        return "Next: `iiwa-ident doctor` with the same address says what is missing; then give the same command again."
    if _never_began(outcome) or (outcome.outcome in ("stopped", "fault") and nothing_moved(outcome)):
        return _AGAIN
    recording = shlex.quote(outcome.recordings[0] if outcome.recordings else f"{folder}/recording.mcap")
    if request is not None and request.monitor_only and outcome.samples:
        return f"Next: `iiwa-ident fit {recording}`; the more joints moved, and the faster, the more it finds."
    commanded = request is None or not request.monitor_only
    if loop is not None and commanded and not loop.standstill_confirmed and outcome.outcome != "refused":
        return "Next: make sure that the arm stands (emergency stop) before anybody comes near it."
    if outcome.outcome in ("refused", "fault"):
        return "Next: mend what the first sentence names; nothing moves until then."
    if outcome.outcome in ("stopped", "dropped"):
        if outcome.exit_code == EXIT_INTERRUPTED:
            return "Next: a new run, in another folder, begins from where the arm stands."
        last = f"{folder}/{LAST_SAMPLES_NAME}" if request is None else find_run_file(request, LAST_SAMPLES_NAME)
        return (
            f"Next: find the cause in the first sentence ({last} has the seconds around it); a new "
            "run begins from where the arm stands."
        )
    if outcome.judgement.get("passed") is False:
        return (
            f"Next: `iiwa-ident judge {recording}` lists the commands beyond a limit; nothing should move before "
            "you know why."
        )
    if outcome.exit_code == LogIOError.exit_code and not outcome.handover_gaps:
        return f"Next: give the disk room, then `iiwa-ident fit {recording}`."
    if outcome.exit_code:
        return f"Next: `iiwa-ident recover {shlex.quote(folder)}` says what of the recording is missing."
    if request is not None and needs_ladder(request) and request.amplitude < 1.0:
        following = highest_allowed(request.amplitude)
        return f"Next: the same command with --amplitude {following:g}, in another folder."
    if fit is None:
        return f"Next: `iiwa-ident fit {recording}`."
    if fit.phase == "failed":
        return f"Next: `iiwa-ident fit {recording}`; the recording is untouched."
    if request is not None and request.diagnose:
        return f"Next: read {folder}/diagnosis/report.html."
    return (
        f"Next: record another motion, then `iiwa-ident diagnose {recording} --heldout OTHER.mcap` names what is left."
    )


def _never_began(outcome: RunOutcome) -> bool:
    """Whether the folder went before the loop began."""
    return outcome.loop is not None and outcome.loop.reason == FolderGoneError.__name__
