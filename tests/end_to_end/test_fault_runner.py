"""Claims about what runs the fault cases: it ends where it fails, and a fault that it tells of did happen."""

from __future__ import annotations

import json
import signal
import sys
import threading
from pathlib import Path

import psutil
import pytest

from tests.end_to_end import fault_runner
from tests.end_to_end.fault_case import FaultCase, Step

WORKER = """
import pathlib, subprocess, sys
sleep = [sys.executable, "-c", "import time; time.sleep(600)"]
worker = subprocess.Popen(sleep, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)
pathlib.Path(sys.argv[1]).write_text(str(worker.pid))
print(f"[worker] The fit runs in a process of its own (pid {worker.pid}).")
"""


def run(folder: Path, program: str, monkeypatch: pytest.MonkeyPatch, *steps: Step) -> None:
    """The runner's part after its set-up, with a program in place of the acquisition."""
    (folder / "input.json").write_text(json.dumps({"bind_port": 30200}))
    command = [sys.executable, "-c", program, str(folder / "pid")]
    monkeypatch.setattr(fault_runner, "_on_disk", lambda *_: command)
    fault_runner._run(FaultCase("case", "case", "none", None, 0, steps=steps), folder, None)


def test_a_runner_that_fails_midway_leaves_no_thread_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(_: int) -> dict[str, psutil.Process]:
        raise RuntimeError("midway")

    before = threading.active_count()
    monkeypatch.setattr(fault_runner, "_family", broken)
    with pytest.raises(RuntimeError, match="midway"):
        run(tmp_path, "print('a line')", monkeypatch)
    assert threading.active_count() == before


def test_a_target_that_was_never_seen_is_a_failure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(AssertionError, match="recorder"):
        run(tmp_path, "print('go')", monkeypatch, Step(when="go", targets=("recorder",), number=signal.SIGKILL))


def test_a_worker_is_hit_whose_supervisor_has_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fault_runner, "_family", lambda _: {})
    step = Step(when=r"\[worker\]", targets=("worker",), number=signal.SIGKILL)
    run(tmp_path, WORKER, monkeypatch, step)
    pid = int((tmp_path / "pid").read_text())
    assert not psutil.pid_exists(pid) or psutil.Process(pid).status() == psutil.STATUS_ZOMBIE
