"""The check of a submitted motion, in a process of its own: `python -m daemon.queue.job_preparation --job FILE`.

A submitted file comes from outside. It is read, tabulated and checked where a crash, a hang or a memory hog costs
only that process, and at low priority, since another motion may be under way. Here: both sides, the process and
`Preparation`, which the service waits for in a thread. What is checked is `preparation`'s.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

from daemon.api import Message, RunRequest
from daemon.children import ended_within, how_ended, start_python
from daemon.circles import look_seldom
from daemon.errors import EXIT_INTERRUPTED, DaemonError, sentence_of
from daemon.json_files import read_json, write_json

REQUEST_NAME = "request.json"
VERDICT_NAME = "verdict.json"
LONGEST_S = 300.0
_MEMORY_BYTES = 6 << 30
_NICENESS = 10


class PreparationJob(Message, frozen=True, kw_only=True):
    """What to check, and for which run: `settings` are fields of RunRequest.

    trajectory_file: none for the shipped excitation. out_dir: where table and trajectory are written. answer_dir: where
    verdict and run request are written.
    """

    job_id: str
    trajectory_file: str | None
    robot: str
    amplitude: float
    out_dir: str
    answer_dir: str
    settings: dict[str, Any]


class Verdict(Message, frozen=True, kw_only=True):
    """Whether the motion may be run, and why not."""

    safe: bool
    sentence: str
    exit_code: int = 0


_CANCELLED = Verdict(safe=False, sentence="The check was broken off; nothing was moved.", exit_code=EXIT_INTERRUPTED)


class Preparation:
    """One check; `run` from a thread that may wait, `cancel` from any thread at any time."""

    def __init__(self, job: PreparationJob) -> None:
        self._job = job
        self._folder = Path(job.answer_dir)
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._cancelled = False

    def run(self) -> tuple[Verdict, RunRequest | None]:
        """The verdict, and the request of a motion that is safe; never raises for what the disk or the motion does."""
        try:
            process = self._start()
        except FileExistsError as error:
            sentence = (
                f"{error.filename} is there already and belongs to another service or run: submit this one again."
            )
            return Verdict(safe=False, sentence=sentence, exit_code=74), None
        except OSError as error:
            return Verdict(safe=False, sentence=f"{self._folder}: {error.strerror}.", exit_code=74), None
        if process is None:
            return _CANCELLED, None
        if not ended_within(process, LONGEST_S):
            sentence = f"The check of the motion did not end within {LONGEST_S:g} s."
            return Verdict(safe=False, sentence=sentence, exit_code=65), None
        if self._cancelled:
            return _CANCELLED, None
        try:
            verdict = read_json(self._folder / VERDICT_NAME, Verdict)
            return verdict, read_json(self._folder / REQUEST_NAME, RunRequest) if verdict.safe else None
        except DaemonError:
            sentence = f"The check of the motion {how_ended(process.returncode)}."
            return Verdict(safe=False, sentence=sentence, exit_code=70), None

    def cancel(self) -> None:
        """End it; `run` then says so."""
        with self._lock:
            self._cancelled = True
            if self._process is not None:
                self._process.kill()

    def _start(self) -> subprocess.Popen[bytes] | None:
        self._folder.mkdir(parents=True, exist_ok=True)
        for name in (REQUEST_NAME, VERDICT_NAME):
            (self._folder / name).unlink(missing_ok=True)
        job_file, out = self._folder / "preparation.json", Path(self._job.out_dir)
        is_first = not job_file.exists()
        write_json(job_file, self._job)
        if is_first and out != self._folder:
            # Two services with one folder for output may give two runs one number in the same millisecond: the table
            # and the cell of one arm must not take the place of another's.
            out.parent.mkdir(parents=True, exist_ok=True)
            out.mkdir()
        with self._lock:
            if not self._cancelled:
                self._process = start_python(
                    "daemon.queue.job_preparation", ["--job", str(job_file)], subprocess.DEVNULL
                )
            return self._process


def prepare(job: PreparationJob) -> tuple[Verdict, RunRequest | None]:
    """Load, tabulate and check a motion, in this process; never raises for a bad one."""
    try:
        from daemon.motion.preparation import LEAD_IN_S, prepare_motion, write_run_request
        from daemon.motion.tool import NO_TOOL, read_tool
        from identification.robots import Installation

        source = None if job.trajectory_file is None else Path(job.trajectory_file)
        settings = dict(job.settings)
        workspace = settings.pop("workspace_file", None)
        motion = prepare_motion(
            source,
            robot=job.robot,
            amplitude=job.amplitude,
            workspace=None if workspace is None else Path(workspace),
            tool=read_tool(settings.pop("tool", NO_TOOL), is_name=True),
            added_mass=settings.pop("added_mass", None),
            lead_in_s=settings.pop("lead_in_s", LEAD_IN_S),
            installation=None if (gravity := settings.pop("gravity_m_s2", None)) is None else Installation(gravity),
        )
        meant_for = motion.trajectory.robot
        if meant_for and meant_for != job.robot:
            sentence = f"The motion was made for {meant_for}, and this service drives {job.robot}."
            return Verdict(safe=False, sentence=sentence, exit_code=65), None
        if not motion.preflight.safe:
            reasons = [check.sentence for check in motion.preflight.checks if not check.passed]
            return Verdict(safe=False, sentence=" ".join(["Not safe:", *reasons[:3]]), exit_code=1), None
        request = write_run_request(motion, Path(job.out_dir), run_id=job.job_id, **settings)
        return Verdict(safe=True, sentence="The preflight found the motion safe."), request
    except MemoryError:
        return Verdict(safe=False, sentence="The motion needs more memory than is allowed.", exit_code=65), None
    except Exception as error:
        code = getattr(error, "exit_code", 74 if isinstance(error, OSError) else 65)
        return Verdict(safe=False, sentence=sentence_of(error)[:1000], exit_code=int(code)), None


def main(arguments: list[str] | None = None) -> int:
    """Entry of the process."""
    parser = argparse.ArgumentParser(
        prog="python -m daemon.queue.job_preparation", description="Check a submitted motion."
    )
    parser.add_argument("--job", required=True, help="JSON file of a PreparationJob")
    job = read_json(parser.parse_args(arguments).job, PreparationJob)
    os.nice(_NICENESS)
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY_BYTES, _MEMORY_BYTES))
    verdict, request = prepare(job)
    folder = Path(job.answer_dir)
    if request is not None:
        write_json(folder / REQUEST_NAME, request)
    write_json(folder / VERDICT_NAME, verdict)
    return verdict.exit_code


if __name__ == "__main__":
    look_seldom()
    sys.exit(main())
