"""kill -9 of `iiwa-ident investigate` while the arm moves and while it asks, and what the next command still knows of
the cell, against a fake robot in lockstep.

Truth: the loop's own report of the standstill, the account on disk, and that the same command stands at a question.
"""

from __future__ import annotations

import json
import os
import pty
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import psutil

from daemon.investigate.account import Account, read_account
from daemon.investigate.states import State
from tests.end_to_end.processes import COMMAND, fake_robot, iiwa_ident, start_iiwa_ident
from tests.ports import free_udp_port
from tests.watchdog import WATCHDOG_S


def wait_for(condition: Callable[[], bool], process: subprocess.Popen[str] | None = None) -> None:
    """Until it is true; nothing is judged by the time."""
    for _ in range(int(WATCHDOG_S / 0.05)):
        if condition():
            return
        assert process is None or process.poll() is None, process.communicate()[0]
        time.sleep(0.05)
    raise AssertionError("what was waited for did not happen")


def account_of(folder: Path) -> Account:
    account = read_account(folder)
    assert account is not None
    return account


def stands(folder: Path, state: State) -> bool:
    account = read_account(folder)
    return account is not None and account.state is state


def killed_while_asking(folder: Path, words: list[str]) -> str:
    """The command on a terminal of its own, killed at its question; what it showed, without blanks, as lines
    break anywhere.
    """
    ours, theirs = pty.openpty()
    process = subprocess.Popen([*COMMAND, *words], stdin=theirs, stdout=theirs, stderr=theirs, start_new_session=True)
    os.close(theirs)
    shown = b""
    while b"Drive it" not in shown:
        shown += os.read(ours, 4096)
    assert stands(folder, State.ASKING)
    process.kill()
    process.wait(WATCHDOG_S)
    os.close(ours)
    return "".join(shown.decode().split())


def test_a_kill_leaves_the_arm_at_rest_and_the_same_command_asks_again(tmp_path: Path) -> None:
    port, out = free_udp_port(), tmp_path / "question"
    words = ["investigate", "--out", str(out), "--bind", f"127.0.0.1:{port}"]
    with fake_robot(port, tmp_path / "robot.json", "--lockstep", "--duration", "600"):
        process = start_iiwa_ident(*words, "--budget", "4", "--yes")
        log = out / "motion-01" / "recording.mcap"
        wait_for(lambda: log.is_file() and log.stat().st_size > 4_000_000, process)
        children = psutil.Process(process.pid).children(recursive=True)
        process.kill()
        process.wait(WATCHDOG_S)
        psutil.wait_procs(children, WATCHDOG_S)
    # Twelve thousand messages: the arm is in the motion.
    report = json.loads((out / "motion-01" / "loop_report.json").read_text())
    assert report["reason"] == "SUPERVISOR_LOST"
    assert report["standstill_confirmed"]
    assert stands(out, State.RECORDING)

    shown = killed_while_asking(out, words)
    run = json.loads((out / "motion-01" / "run.json").read_text())
    seconds = 0.001 * run["samples_in_periods"]
    assert seconds > 0.0
    kept = f"{seconds:.1f} of its 80 s were recorded and stay in {out / 'motion-01'}"
    assert f"Motion 1 (excitation) was broken off: {kept}.".replace(" ", "") in shown
    left = account_of(out)
    assert left.state is State.ASKING
    assert left.attempts == 1  # nothing was begun beyond the first motion
    assert log.is_file()

    planned = iiwa_ident(*words, "--plan-only")
    assert planned.returncode == 0, planned.stderr
    assert "Planned, not driven: Motion 1" in planned.stdout
    done = account_of(out)
    assert (done.state, done.recordings, done.attempts) == (State.PLANNED, (), 1)


def test_the_motion_is_driven_in_the_cell_and_with_the_tool_that_only_the_plan_was_given(tmp_path: Path) -> None:
    port, out, cell = free_udp_port(), tmp_path / "question", tmp_path / "cell.yaml"
    cell.write_text("walls: [{name: fence, normal: [1, 0, 0], offset_m: -1.5}]\n")
    words = ["investigate", "--out", str(out), "--bind", f"127.0.0.1:{port}"]
    told = ["--budget", "4", "--workspace", str(cell), "--tool", "0.8@0,0,0.05"]
    planned = iiwa_ident(*words, *told, "--plan-only")
    assert planned.returncode == 0, planned.stderr
    with fake_robot(port, tmp_path / "robot.json", "--lockstep", "--duration", "600"):
        process = start_iiwa_ident(*words, "--yes")
        log = out / "motion-01" / "recording.mcap"
        wait_for(lambda: log.is_file() and log.stat().st_size > 200_000, process)
        os.kill(process.pid, signal.SIGINT)
        process.communicate(timeout=WATCHDOG_S)
    request = json.loads((out / "motion-01" / "request.json").read_text())
    assert request["tool"] == "0.8 kg at (0, 0, 0.05) m"
    taken = Path(request["workspace_file"]).read_text()
    assert "fence" in taken
    assert "0.8" in taken
