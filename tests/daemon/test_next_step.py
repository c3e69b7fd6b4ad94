"""Claims about the sentence after a run: it names a command that fits how the run ended."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from daemon.api import LoopReport, PhaseSpan, RunOutcome, WorkerStatus
from daemon.motion.preparation import prepare_motion
from daemon.motion.tip_speed import T1_SPEED_M_S
from daemon.run.next_step import next_step

from .producer import make_request

FIT = WorkerStatus(job_id="one", phase="done", sentence="Done.")
FAILED = WorkerStatus(job_id="one", phase="failed", sentence="Failed.")


@pytest.mark.parametrize(
    ("ended", "request_changes", "fit", "words"),
    [
        ({"outcome": "no_robot", "exit_code": 69}, {}, None, "iiwa-ident doctor"),
        ({"outcome": "version_mismatch", "exit_code": 76}, {}, None, "--fri-version"),
        ({"outcome": "stopped", "exit_code": 1}, {}, None, "last_samples.json"),
        ({"outcome": "stopped", "exit_code": 130, "standstill": False, "phases": ()}, {}, None, "can be given again"),
        ({"outcome": "stopped", "exit_code": 130, "standstill": False}, {}, None, "emergency stop"),
        ({"outcome": "dropped", "exit_code": 1, "standstill": False}, {}, None, "emergency stop"),
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
