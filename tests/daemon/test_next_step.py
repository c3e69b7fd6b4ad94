"""Claims about the sentence after a run: it names a command that fits how the run ended."""

from __future__ import annotations

import re
import shlex
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from daemon.api import LoopReport, PhaseSpan, RunOutcome, WorkerJob, WorkerStatus
from daemon.jobs.worker_start import command_for
from daemon.motion.preparation import prepare_motion
from daemon.motion.tip_speed import T1_SPEED_M_S
from daemon.run.judgement import judgement_remarks
from daemon.run.next_step import next_step
from daemon.run.spare_folder import spare_folder

from .producer import make_request

FIT = WorkerStatus(job_id="one", phase="done", sentence="Done.")
FAILED = WorkerStatus(job_id="one", phase="failed", sentence="Failed.")


@pytest.mark.parametrize(
    ("ended", "request_changes", "fit", "words"),
    [
        ({"outcome": "no_robot", "exit_code": 69}, {}, None, "iiwa-ident doctor"),
        ({"outcome": "not_started", "exit_code": 69}, {}, None, "what the first sentence names"),
        ({"outcome": "version_mismatch", "exit_code": 76}, {}, None, "--fri-version"),
        ({"outcome": "stopped", "exit_code": 1}, {}, None, "last_samples.json"),
        ({"outcome": "stopped", "exit_code": 130}, {}, None, "Next: a new run"),  # whoever asked knows the cause
        ({"outcome": "stopped", "exit_code": 130, "standstill": False, "phases": ()}, {}, None, "can be given again"),
        ({"outcome": "stopped", "exit_code": 130, "standstill": False}, {}, None, "emergency stop"),
        ({"outcome": "dropped", "exit_code": 1, "standstill": False}, {}, None, "emergency stop"),
        ({"outcome": "fault", "exit_code": 70, "standstill": False}, {}, None, "emergency stop"),
        ({"outcome": "fault", "exit_code": 70, "standstill": False}, {"monitor_only": True}, None, "mend"),
        ({"outcome": "refused", "exit_code": 65}, {}, None, "mend"),
        ({"exit_code": 1}, {}, None, "iiwa-ident recover"),
        ({"exit_code": 74}, {}, None, "then `iiwa-ident fit runs/one/recording.mcap`"),
        ({"exit_code": 1, "judgement": {"passed": False}}, {}, FIT, "iiwa-ident judge"),
        ({}, {"amplitude": 0.1, "simulation": False}, None, "--amplitude 0.25"),
        ({}, {"amplitude": 0.1, "simulation": True}, None, "iiwa-ident fit"),
        ({}, {"simulation": True}, FIT, "--heldout"),
        ({}, {"simulation": True, "diagnose": True}, FIT, "report.html"),
        ({}, {"simulation": True}, FAILED, "untouched"),
    ],
)
def test_the_next_step_fits_the_end(
    tmp_path: Path, ended: dict[str, Any], request_changes: dict[str, Any], fit: WorkerStatus | None, words: str
) -> None:
    values = {"outcome": "completed", "exit_code": 0, "standstill": True, "phases": ("START_RAMP",)} | ended
    phases = tuple(PhaseSpan(phase=phase) for phase in ("WAITING", *values.pop("phases")))
    report = LoopReport(
        outcome=values["outcome"], reason="", sentence="", standstill_confirmed=values.pop("standstill"),
        phases=phases, answered=9,
    )  # fmt: skip
    outcome = RunOutcome(
        run_id="one", sentences=(), out_dir="runs/one", loop=report, request=make_request(tmp_path, **request_changes),
        recordings=("runs/one/recording.mcap",), **values,
    )  # fmt: skip
    sentence = next_step(outcome, fit)
    assert words in sentence
    assert sentence.startswith("Next: ")
    assert "\n" not in sentence


def test_a_command_to_copy_finds_a_recording_in_a_folder_with_a_space(tmp_path: Path) -> None:
    """The truth is a shell's own reading of the words: a path is one of them."""
    recording = "runs/first arm/recording.mcap"
    outcome = RunOutcome(
        run_id="one", sentences=(), out_dir="runs/first arm", outcome="completed", exit_code=0,
        recordings=(recording,), request=make_request(tmp_path, simulation=True),
    )  # fmt: skip
    job = WorkerJob(job_id="one", recordings=(recording,), robot="iiwa14", model_file="first arm.json", status_file="")
    judgement = {
        "passed": False, "file": recording, "excess_count": 1, "worst": {},
        "excesses": [{"time_s": 1.0, "quantity": "velocity", "joint": 1, "percent": 120.0}],
    }  # fmt: skip
    said = next_step(outcome, None), f"`{command_for(job)}`", judgement_remarks(judgement)[-1]
    for sentence in said:
        assert recording in shlex.split(sentence.split("`")[1]), sentence


def test_the_seconds_around_a_stop_are_named_where_a_full_disk_let_them_be_written(tmp_path: Path) -> None:
    """The truth is where the file really lies: beside the run's folder, which took no more bytes."""
    request = make_request(tmp_path, run_id=f"one-{tmp_path.parent.name}")
    file = spare_folder(request) / "last_samples.json"
    file.write_text("{}")
    try:
        report = LoopReport(outcome="stopped", reason="DISK_FULL", sentence="", standstill_confirmed=True,
                            phases=(PhaseSpan(phase="EXCITATION"),), answered=9)  # fmt: skip
        outcome = RunOutcome(
            run_id="one", outcome="stopped", exit_code=1, sentences=(), out_dir=request.out_dir, loop=report,
            request=request,
        )  # fmt: skip
        assert str(file) in next_step(outcome, None)
    finally:
        shutil.rmtree(file.parent)


def test_the_first_rung_of_the_shipped_motion_is_slow_enough_for_t1_and_the_whole_motion_is_not() -> None:
    """Truth: the end-effector's path by the arm's geometry, differenced here along its length."""
    for amplitude, slow in ((0.1, True), (1.0, False)):
        motion = prepare_motion(None, amplitude=amplitude)
        path = motion.surroundings.geometry.tip_path(motion.table[::10])
        speed = np.linalg.norm(np.diff(path, axis=0), axis=1).max() / 0.01
        assert bool(speed < T1_SPEED_M_S) is slow
        assert ("slow enough for T1" in motion.speed_sentence()) is slow
        said = re.search(r"reaches (\S+) m/s", motion.speed_sentence())
        assert said is not None
        assert float(said[1]) == pytest.approx(speed, abs=0.01)
