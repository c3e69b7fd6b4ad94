"""What tests of a whole run share: a gentle motion for the fake robot, the recording read back, the processes."""

from __future__ import annotations

import contextlib
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from rosbags.highlevel import AnyReader

from daemon.api import RunRequest
from daemon.json_files import write_json
from tests.short_motion import NEAR_THE_ROBOT
from tests.watchdog import WATCHDOG_S

from .recorder_results import read_events, read_states
from .service_process import wait_for

REPOSITORY = Path(__file__).resolve().parents[2]
PERIOD_SAMPLES = 1000
RUN_CODE = (
    "import sys; from daemon.api import RunRequest; from daemon.json_files import read_json;"
    "from daemon.run.service import run_acquisition;"
    "outcome = run_acquisition(read_json(sys.argv[1], RunRequest),"
    " observe=lambda event: print(event.kind, event.sentence, flush=True));"
    "sys.exit(outcome.exit_code)"
)


PATIENT = {"start_timeout_s": 120.0, "receive_timeout_s": 60.0, "supervisor_timeout_s": 60.0}
"""What a machine that does something else may hold up is no fault of the run's."""


def gentle_request(folder: Path, port: int, **changes: Any) -> RunRequest:
    """One second of a small motion beside the pose in which the fake robot begins, so that the start ramp is short."""
    folder.mkdir(parents=True, exist_ok=True)
    angle = 2 * np.pi * np.arange(PERIOD_SAMPLES) / PERIOD_SAMPLES
    np.save(folder / "table.npy", np.array(NEAR_THE_ROBOT) + 0.02 * (1 - np.cos(angle))[:, None])
    (folder / "trajectory.json").write_text("{}")
    values: dict[str, Any] = {
        "run_id": "test",
        "robot": "iiwa14",
        "table_file": str(folder / "table.npy"),
        "trajectory_file": str(folder / "trajectory.json"),
        "out_dir": str(folder / "run"),
        "periods": 3,
        "lead_in_s": 0.2,
        "bind_port": port,
        "realtime_priority": 0,
        **PATIENT,
        "fit": False,
        "simulation": True,
    }
    return RunRequest(**{**values, **changes})


def commands_of(path: Path) -> list[Any]:
    """Positions sent, from the first that was not the robot's own."""
    with AnyReader([path]) as bag:
        wanted = [each for each in bag.connections if each.topic == "/fri/command"]
        commands: list[Any] = [bag.deserialize(raw, connection.msgtype) for connection, _, raw in bag.messages(wanted)]
    return [each.joint_position for each in commands if each.joint_position_valid]


def assert_nothing_missing(path: Path) -> None:
    """The robot's counter has no hole, and every record of the loop stands in the file, as a sample or as an event."""
    states = read_states(path)
    assert set(np.diff([state.sequence_counter for state in states])) == {1}
    samples = [state.sample_index for state in states]
    assert len(samples) == len(set(samples))
    indexes = {*samples, *(event.sample_index for event in read_events(path))}
    assert sorted(indexes) == list(range(max(indexes) + 1))


def words_of(process: psutil.Process) -> str:
    """Its command line; none of one that has ended, as the robot may have by then."""
    with contextlib.suppress(psutil.NoSuchProcess):
        return " ".join(process.cmdline())
    return ""


def child_of(process: psutil.Process, module: str) -> psutil.Process:
    """The child that runs this module; waited for, as one that was just started has no command line for a moment."""
    until_s = time.monotonic() + WATCHDOG_S
    while time.monotonic() < until_s:
        for child in process.children():
            if module in words_of(child):
                return child
        time.sleep(0.001)
    raise AssertionError(f"no child of {process.pid} runs {module}")


def start_run(request: RunRequest) -> subprocess.Popen[str]:
    file = Path(request.table_file).with_name("input.json")
    write_json(file, request)
    return subprocess.Popen(
        [sys.executable, "-c", RUN_CODE, str(file)], cwd=REPOSITORY, stdout=subprocess.PIPE, text=True
    )


def has_begun_period(number: int, said: str) -> bool:
    """Whether this period or a later one was told; a supervisor that is held up may miss one."""
    return any(int(told) >= number for told in re.findall(r"Period (\d+) of", said))


def read_until_period(process: subprocess.Popen[str], number: int) -> None:
    assert process.stdout is not None
    for line in process.stdout:
        if has_begun_period(number, line):
            return
    raise AssertionError(f"the run ended without period {number}")


def wait_gone(processes: list[psutil.Process]) -> None:
    _, alive = psutil.wait_procs(processes, timeout=WATCHDOG_S)
    assert not alive


def kill_together(processes: list[psutil.Process]) -> None:
    """SIGSTOP first, so that none sees another one's death."""
    for number in (signal.SIGSTOP, signal.SIGKILL):
        for process in processes:
            process.send_signal(number)


def wait_for_chunks(file: Path, count: int) -> None:
    """Until the recorder has handed over so many more pieces."""
    sizes = {file.stat().st_size}

    def has_grown() -> bool:
        sizes.add(file.stat().st_size)
        return len(sizes) > count

    wait_for(has_grown)
