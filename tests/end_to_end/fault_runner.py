"""Runs one case of the fault table with real processes and measures what became of arm, operator and file.

Truth comes from the robot's side (its summary: commands it accepted and refused, their peaks, how fast everything was
when commanding ended, how many answers it got) and from readers of the file that share no code with its writer.
"""

from __future__ import annotations

import contextlib
import json
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import yaml
from numpy.typing import NDArray

from daemon.api import RunRequest
from daemon.json_files import write_json
from daemon.live.frame import LiveFrame, Seven
from daemon.live.subscription import LiveSubscription
from identification.excitation import FourierTrajectory, default_trajectory
from tests.end_to_end.fault_account import (
    FaultResult,
    account_of,
    examine,
    outcome_of,
    peaks_of,
    what_the_arm_did,
)
from tests.end_to_end.fault_case import FaultCase, Step
from tests.ports import free_udp_port
from tests.watchdog import WATCHDOG_S

__all__ = ["LEAD_IN_S", "robot_settings", "run_case", "short_motion"]

REPOSITORY = Path(__file__).resolve().parents[2]
PERIOD_S = 2.0
LEAD_IN_S = 0.3
MODULES = {"recorder": "daemon.run.recorder", "loop": "daemon.run.loop_process", "worker": "daemon.jobs.worker"}


def run_case(case: FaultCase, folder: Path) -> FaultResult:
    """Run it in an empty folder; raises AssertionError where a process does not end by itself."""
    folder.mkdir(parents=True, exist_ok=True)
    with contextlib.ExitStack() as stack:
        port = free_udp_port()
        if case.port_held:
            holder = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            holder.bind(("127.0.0.1", 0))
            port = holder.getsockname()[1]
        _write_inputs(case, folder, port)
        if case.wire is not None:
            port = stack.enter_context(_bad_wire(case.wire, port))
        robot = _start_robot(case, folder, port) if case.robot is not None else None
        if robot is not None:
            stack.callback(robot.kill)
        if robot is not None and ("start_timeout_s" in case.request or _is_about_silence(case)):
            _await_start(robot, folder)  # how long it takes to start is not what the case is about
        transcript, exit_code, left = _run(case, folder, robot)
        summary = _end_robot(robot, folder, _braking_s(case)) if robot is not None else {}
    outcome = outcome_of(folder)
    samples, answered, gap, recovered = examine(folder)
    lines = [line for line in transcript.splitlines() if line and not line.startswith("[")]
    return FaultResult(
        arm=what_the_arm_did(summary, outcome),
        peaks=peaks_of(summary),
        judged_inside=not summary or summary["judgement"]["passed"],
        speed_at_end=summary.get("arm_speed_at_end_rad_s", 0.0),
        rejections=tuple(sorted({each["reason"] for each in summary.get("rejections", ())})),
        robot_answered=summary.get("counts", {}).get("answered", 0),
        outcome=outcome,
        exit_code=exit_code,
        read=lines[0].replace(str(folder), "FOLDER") if lines else "",
        transcript=transcript,
        samples=samples,
        answered_samples=answered,
        gap=gap,
        recovered=recovered,
        robot=summary,
        left_running=left,
        lost=account_of(folder).get("handover_gaps", 0),
        has_account=bool(account_of(folder)),
    )


def _write_inputs(case: FaultCase, folder: Path, port: int) -> None:
    """The short motion, the request and the robot's settings."""
    short = short_motion()
    table = short.table(1000.0)
    np.save(folder / "table.npy", table)
    (folder / "trajectory.json").write_text(json.dumps(short.to_json()))
    values: dict[str, Any] = {
        "run_id": case.name,
        "robot": "iiwa14",
        "table_file": str(folder / "table.npy"),
        "trajectory_file": str(folder / "trajectory.json"),
        "out_dir": str(folder / "run"),
        "periods": 50 if case.steps or case.disk else 1,
        "lead_in_s": LEAD_IN_S,
        "realtime_priority": 0,  # several runs beside each other would starve the robots
        "bind_port": port,
        "fit": False,
        "simulation": True,
        **_patience(case),
    }
    write_json(folder / "input.json", RunRequest(**{**values, **case.request}))
    settings = robot_settings(case, table, values["lead_in_s"])
    (folder / "robot.yaml").write_text(yaml.safe_dump(settings))


def _patience(case: FaultCase) -> dict[str, float]:
    """Time-outs of the client that the case is not about never end a run because the machine was busy elsewhere."""
    held = (signal.SIGKILL, signal.SIGSTOP)
    supervised = not any("supervisor" in step.targets and step.number in held for step in case.steps)
    silence = {"receive_timeout_s": 0.5 if _is_about_silence(case) else 10.0}
    return silence | ({"supervisor_timeout_s": 60.0} if supervised else {})


def _is_about_silence(case: FaultCase) -> bool:
    said = any("no usable message" in words for words in case.says)
    return said or case.arm in ("held", "dropped") or case.wire is not None


def _waits(case: FaultCase) -> dict[str, float]:
    """The robot's waits. A lockstep robot that always gets its answers may wait; one that does not waits for nothing.

    Its waits halve, so that it goes on without the client after twice the first one: longer than a busy machine holds
    a process up.
    """
    answered = not case.faults and case.arm in ("finished", "ramp")
    return {"lockstep_timeout_s": 20.0 if answered else 1.5, "overlay_start_delay_s": 0.05}


def short_motion() -> FourierTrajectory:
    """2 s, a fifth of the shipped one."""
    shipped = default_trajectory()
    return FourierTrajectory(1.0 / PERIOD_S, 0.2 * shipped.a, 0.2 * shipped.b, shipped.offset, shipped.robot)


def robot_settings(case: FaultCase, table: NDArray[np.float64], lead_in_s: float = LEAD_IN_S) -> dict[str, Any]:
    """What stands in the robot's settings file; it begins near where the lead-in of the table (N, 7) rad does."""
    first = table[-round(lead_in_s * 1000)] + case.start_rad
    return {
        "initial_position_rad": first.tolist(), "session": {**_waits(case), **case.session},
        "faults": [dict(each) for each in case.faults],
    }  # fmt: skip


def _start_robot(case: FaultCase, folder: Path, port: int) -> subprocess.Popen[bytes]:
    options = ["--send-period-ms", "5"] if case.clock else ["--lockstep"]
    options += ["--client", f"127.0.0.1:{port}", "--seed", "7", "--duration", "900", *(case.robot or ())]
    options += ["--physics", str(folder / "robot.yaml"), "--json", str(folder / "robot.json")]
    return subprocess.Popen(
        [sys.executable, "-m", "fixtures.fake_robot", *options],
        cwd=REPOSITORY, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=(folder / "robot.log").open("wb"),
    )  # fmt: skip


def _await_start(robot: subprocess.Popen[bytes], folder: Path) -> None:
    """Until it says that it sends, or ends without a word."""
    while robot.poll() is None and b"fake robot:" not in (folder / "robot.log").read_bytes():
        time.sleep(0.01)


@contextlib.contextmanager
def _bad_wire(wire: tuple[str, float], client_port: int) -> Iterator[int]:
    """The proxy, a process of its own; the port that the robot sends to."""
    trouble, share = wire
    options = ["--client-port", str(client_port), "--trouble", trouble, "--share", str(share), "--seed", "11"]
    with subprocess.Popen(
        [sys.executable, "-m", "tests.end_to_end.wire_proxy", *options],
        cwd=REPOSITORY, stdout=subprocess.PIPE, text=True,
    ) as proxy:  # fmt: skip
        assert proxy.stdout is not None
        try:
            yield int(proxy.stdout.readline())
        finally:
            proxy.terminate()


def _braking_s(case: FaultCase) -> float:
    """How long a session that was dropped may take to close by itself, so that braking is over."""
    if case.arm not in ("held", "dropped"):
        return 0.0
    return 6.0 if "after_drop" in case.session else WATCHDOG_S  # a session that stays open has no end


def _end_robot(robot: subprocess.Popen[bytes], folder: Path, patience_s: float) -> dict[str, Any]:
    """The robot's summary, of one that closed by itself or was asked to."""
    with contextlib.suppress(subprocess.TimeoutExpired):
        robot.wait(patience_s)
    robot.terminate()
    robot.wait(WATCHDOG_S)
    file = folder / "robot.json"  # absent where the run ended before the robot was there
    return dict(json.loads(file.read_text())) if file.is_file() else {}


# The run.


def _run(case: FaultCase, folder: Path, robot: subprocess.Popen[bytes] | None) -> tuple[str, int, tuple[str, ...]]:
    """Everything the operator read, the exit code, and the processes of ours that did not end (killed then)."""
    command = [sys.executable, "-m", "tests.end_to_end.acquisition", str(folder / "input.json")]
    process = subprocess.Popen(
        _on_disk(case.disk, command, folder / "run"), cwd=REPOSITORY, stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True,
    )  # fmt: skip
    assert process.stdout is not None
    steps = [step for step in case.steps if step.when]
    moments = [step for step in case.steps if not step.when]
    lines: list[str] = []
    family: dict[str, psutil.Process] = {}
    timers: list[threading.Timer] = []
    is_over = threading.Event()
    port = int(json.loads((folder / "input.json").read_text())["bind_port"])
    watch = threading.Thread(target=_at_moments, args=(moments, port, process.pid, family, timers, is_over))
    watch.start()
    try:
        with process.stdout as stream:
            for line in stream:
                lines.append(line)
                family.update(_family(process.pid) | _told(line))
                while steps and re.search(steps[0].when, line):
                    step = steps.pop(0)
                    assert family.keys() >= set(step.targets), f"{step.targets}: only {set(family)} were seen"
                    _inject(step, family, timers)
                    if step.resume_after_robot and robot is not None:
                        robot.wait(WATCHDOG_S)
                        _resume([family[target] for target in step.targets])
        exit_code = process.wait(WATCHDOG_S)
        for timer in timers:
            timer.join()
        others = [each for role, each in family.items() if role != "supervisor"]
        _, alive = psutil.wait_procs(others, timeout=WATCHDOG_S)
    finally:  # a thread that watches on would keep whoever called this from ending
        is_over.set()
        watch.join()
        process.kill()
        for each in family.values():
            with contextlib.suppress(psutil.NoSuchProcess):
                each.kill()
    return "".join(lines), exit_code, tuple(role for role, each in family.items() if each in alive)


def _inject(step: Step, family: dict[str, psutil.Process], timers: list[threading.Timer]) -> None:
    """Send the signal. Several that are to end at once are stopped first: none sees another gone before it ends."""
    chosen = [family[target] for target in step.targets if target in family]
    at_once = len(chosen) > 1 and step.number == signal.SIGKILL
    for number in (signal.SIGSTOP, step.number) if at_once else (step.number,):
        for each in chosen:
            with contextlib.suppress(psutil.NoSuchProcess):
                each.send_signal(number)
    if step.resume_after_s is not None:
        timers.append(threading.Timer(step.resume_after_s, _resume, (chosen,)))
        timers[-1].start()


def _at_moments(
    steps: list[Step],
    port: int,
    pid: int,
    family: dict[str, psutil.Process],
    timers: list[threading.Timer],
    is_over: threading.Event,
) -> None:
    """Inject each step once the recorder has told that it is due; then end what stays stopped when all else is over."""
    stood: Seven | None = None
    with LiveSubscription(port) if steps else contextlib.nullcontext() as live:
        while live is not None and steps and not is_over.is_set():
            family.update(_family(pid))
            for frame in live.receive(0.02):
                stood = stood or frame.command
                if steps and _is_due(steps[0], frame, stood):
                    _inject(steps.pop(0), family, timers)
    while not is_over.wait(0.2):
        states = {each: _state(each) for each in list(family.values())}
        if (
            states
            and all(state in (psutil.STATUS_STOPPED, "gone") for state in states.values())
            and not any(timer.is_alive() for timer in timers)
        ):
            for each in states:
                with contextlib.suppress(psutil.NoSuchProcess):
                    each.kill()


def _is_due(step: Step, frame: LiveFrame, stood: Seven | None) -> bool:
    if step.at_message is not None:
        return frame.received >= step.at_message
    if frame.command is None or stood is None or step.at_travel_rad is None:
        return False
    return max(abs(now - then) for now, then in zip(frame.command, stood, strict=True)) >= step.at_travel_rad


def _state(process: psutil.Process) -> str:
    with contextlib.suppress(psutil.NoSuchProcess):
        state = process.status()
        return "gone" if state == psutil.STATUS_ZOMBIE else str(state)
    return "gone"


def _family(pid: int) -> dict[str, psutil.Process]:
    """Our processes by role; the newest of a role counts."""
    found: dict[str, psutil.Process] = {}
    with contextlib.suppress(psutil.NoSuchProcess):
        parent = psutil.Process(pid)
        for each in [parent, *parent.children(recursive=True)]:
            with contextlib.suppress(psutil.NoSuchProcess):
                words = each.cmdline()
                if "tests.end_to_end.acquisition" in words and Path(words[0]).name.startswith("python"):
                    found.setdefault("supervisor", each)  # a child has its words until it is a program of its own
                found.update({role: each for role, module in MODULES.items() if module in words})
    return found


def _told(line: str) -> dict[str, psutil.Process]:
    """The worker, by the number in its line: the supervisor may end before its children are listed."""
    told = re.search(r"\[worker\].*\(pid (\d+)\)", line)
    with contextlib.suppress(psutil.NoSuchProcess):
        return {} if told is None else {"worker": psutil.Process(int(told[1]))}
    return {}


def _resume(processes: list[psutil.Process]) -> None:
    for each in processes:
        with contextlib.suppress(psutil.NoSuchProcess):
            each.resume()


def _on_disk(disk: str, command: list[str], out: Path) -> list[str]:
    """The command with the run's folder on a small or a read-only file system."""
    if not disk:
        return command
    run = " ".join(command)
    out.mkdir()
    if disk == "ro":
        script = f"mount -t tmpfs -o ro none {out} && exec {run}"
    else:
        kept = out.with_name("kept")
        keep = f"code=$?; cp -r {out} {kept}; exit $code"
        script = f"mount -t tmpfs -o size={disk} none {out} && {{ {run}; {keep}; }}"
    return ["unshare", "-rm", "sh", "-c", script]
