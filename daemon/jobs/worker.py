"""The detached fit: `python -m daemon.jobs.worker --job FILE`; recordings in, model.json and a diagnosis out.

Here: the order of the phases, the status file, and errors as status. Not here: any computation (`identification`), and
who started it (`worker_start`). The process belongs to nobody: it has its own session, needs no supervisor, and says
how far it is in a file that is rewritten in one step.

    queued -> loading -> averaging -> fitting -> validating -> writing (-> diagnosing) -> done
             any phase before it -> failed (with the sentence and the exit code of the error)

A model that stands is a success: a diagnosis that fails after it ends in "done", and `diagnosis_error` says why.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
import traceback
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from daemon.api import WorkerJob, WorkerPhase, WorkerStatus
from daemon.circles import look_seldom
from daemon.errors import DaemonError, MissingInputError, sentence_of
from daemon.json_files import read_json, write_bytes_atomically, write_json
from daemon.times import now_text
from daemon.words import counted

if TYPE_CHECKING:
    from identification.recordings.reader import Inputs

REPORT_NAME = "report.html"
_SHARE_OF_FIT = 0.3
"""Of the time of a fit and the diagnosis after it."""

_KEYWORDS: tuple[tuple[str, WorkerPhase], ...] = (
    ("process", "averaging"),
    ("averag", "averaging"),
    ("valid", "validating"),
)


class StatusFile:
    """The worker's state for everyone, rewritten atomically."""

    def __init__(self, job: WorkerJob) -> None:
        self._job = job
        self._started_at = now_text()

    def write(
        self,
        phase: WorkerPhase,
        sentence: str,
        fraction: float,
        *,
        exit_code: int | None = None,
        diagnosis_error: str | None = None,
    ) -> WorkerStatus:
        """Publish one state. A disk that refuses is not a reason to stop computing."""
        status = WorkerStatus(
            job_id=self._job.job_id,
            phase=phase,
            sentence=sentence,
            fraction=min(max(fraction, 0.0), 1.0),
            pid=os.getpid(),
            started_at=self._started_at,
            updated_at=now_text(),
            model_file=self._job.model_file if phase == "done" else None,
            exit_code=exit_code,
            diagnosis_error=diagnosis_error,
        )
        with contextlib.suppress(OSError):
            write_json(self._job.status_file, status)
        return status


def run_job(job: WorkerJob, status: StatusFile) -> int:
    """Fit the job's recordings and write the model. Returns the exit code; every error becomes a status."""
    whole = 1.0 if job.diagnosis_folder is None else _SHARE_OF_FIT
    try:
        status.write("loading", f"Reading {counted(len(job.recordings), 'recording')}.", 0.0)
        # The numerical libraries take a second to load: the status stands before that.
        from identification.audit.mount import require_stated_stand
        from identification.recording_fit import FitSettings, fit_recordings
        from identification.recordings.reader import read_inputs
        from identification.report import write_report

        for file in job.recordings:
            if not Path(file).is_file():
                raise MissingInputError(file, "a recording to fit")
        inputs = read_inputs(job.recordings, robot=job.robot)
        recordings, robot = inputs.recordings, inputs.robot
        require_stated_stand(recordings, robot)
        settings = FitSettings(pipeline=job.pipeline)
        phase: WorkerPhase = "averaging"
        status.write(phase, "Averaging the periods.", 0.1 * whole)

        def progress(text: str, share: float) -> None:
            nonlocal phase
            phase = next((name for key, name in _KEYWORDS if key in text.lower()), "fitting")
            status.write(phase, f"{text[:1].upper()}{text[1:]}.", (0.1 + 0.85 * share) * whole)

        result = fit_recordings(recordings, robot, settings, progress=progress)
        status.write("writing", f"Writing {job.model_file}.", 0.96 * whole)
        write_bytes_atomically(job.model_file, _json_bytes(result.to_model_json()))
        page = Path(job.model_file).with_name(REPORT_NAME)
        write_report(page, fit=result)
        sentence = f"The model is in {job.model_file}, {REPORT_NAME} beside it shows it."
        trouble = None
        if job.diagnosis_folder is not None:
            try:
                sentence += f" The diagnosis ({_diagnose(job, inputs, status)}) is in {job.diagnosis_folder}."
                there = os.path.relpath(Path(job.diagnosis_folder) / REPORT_NAME, page.parent)
                write_report(page, fit=result, links=[(there, "The diagnosis: what this model leaves out")])
            except Exception as error:  # whatever it was, the model stands
                trouble, _ = _said(error)
                sentence += f" The diagnosis failed: {trouble}"
        status.write("done", sentence, 1.0, exit_code=0, diagnosis_error=trouble)
    except Exception as error:
        text, code = _said(error)
        status.write("failed", text, 1.0, exit_code=code)
        return code
    return 0


def _diagnose(job: WorkerJob, inputs: Inputs, status: StatusFile) -> str:
    """Diagnose the fitted recordings into the job's folder; the verdict. Raises what reading or diagnosing raises."""
    from daemon.jobs.diagnosis import diagnose_recordings
    from identification.recordings.reader import read_inputs

    def progress(text: str, share: float) -> None:
        share_of_all = _SHARE_OF_FIT + (1.0 - _SHARE_OF_FIT) * share
        status.write("diagnosing", f"{text[:1].upper()}{text[1:]}.", share_of_all)

    assert job.diagnosis_folder is not None
    recordings, robot = inputs.recordings, inputs.robot
    heldout = read_inputs(job.heldout, robot=job.robot, installation=robot.installation).recordings
    found = diagnose_recordings(recordings, heldout, robot, Path(job.diagnosis_folder), progress=progress)
    return str(found.diagnosis.verdict)


def _said(error: Exception) -> tuple[str, int]:
    """What an error says to an operator, and its exit code; the place of one that nobody expected goes to the log."""
    if isinstance(error, OSError | MemoryError):
        return sentence_of(error), 74
    code = getattr(error, "exit_code", None)
    if code is None:
        traceback.print_exc()
        code = DaemonError.exit_code
    return sentence_of(error), int(code)


def _json_bytes(model: dict[str, Any]) -> bytes:
    """Indented JSON without NaN: a number that is not finite becomes null, as every JSON reader expects."""
    return msgspec.json.format(msgspec.json.encode(msgspec.to_builtins(model, enc_hook=_plain)), indent=1) + b"\n"


def _plain(value: Any) -> Any:
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} cannot stand in a model file")


def main(arguments: list[str] | None = None) -> int:
    """Entry of the process; exit code as in the contract, details in worker.log."""
    parser = argparse.ArgumentParser(
        prog="python -m daemon.jobs.worker", description="Fit recordings in the background."
    )
    parser.add_argument("--job", required=True, help="JSON file of a WorkerJob")
    options = parser.parse_args(arguments)
    try:
        job = read_json(options.job, WorkerJob)
    except DaemonError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    return run_job(job, StatusFile(job))


if __name__ == "__main__":
    look_seldom()
    sys.exit(main())
