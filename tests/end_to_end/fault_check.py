"""What has to hold in every row of the fault table.

The arm is judged at the robot's side; the file by readers that share no code with its writer. Nothing here asks how
long anything took.
"""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from tests.end_to_end.fault_account import matches
from tests.end_to_end.fault_case import FaultCase
from tests.end_to_end.fault_runner import run_case

__all__ = ["check"]

REST_RAD_S = 5e-3
"""What sensor noise and a settling controller leave of an arm at rest."""


def check(case: FaultCase, folder: Path) -> None:
    """Run the case in an empty folder and hold it to its row."""
    if case.disk and not can_mount():
        pytest.skip("no mount namespace of our own on this machine, so no disk to fill")
    result = run_case(case, folder)
    became = (result.arm, result.outcome, result.exit_code)
    assert became == (case.arm, case.outcome, case.exit_code), f"{became}\n{result.transcript}"
    assert result.rejections == case.rejections
    assert result.judged_inside, result.robot["judgement"]["excesses"][:3]
    assert result.speed_at_end < REST_RAD_S
    for words in case.says:
        assert matches(result.transcript, words), (words, result.transcript)
    assert "Traceback" not in result.transcript
    assert (result.samples is not None) == case.file, result.transcript
    assert result.gap == case.gap
    assert result.answered_samples >= result.robot_answered - case.unsaved
    assert result.left_running == ()


def can_mount() -> bool:
    if shutil.which("unshare") is None:
        return False
    probe = ["unshare", "-rm", "sh", "-c", "mount -t tmpfs none /mnt"]
    return subprocess.run(probe, capture_output=True, check=False).returncode == 0
