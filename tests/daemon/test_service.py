"""Claims about one acquisition with real processes: supervisor, loop, recorder and the fake robot over loopback.

Truth: the robot's own counters in the recorded messages (consecutive means nothing is missing), what the
loop counted, and files read back by rosbags. Children are killed for real.
"""

from __future__ import annotations

import contextlib
import json
import os
import pty
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from daemon.api import RunEvent, RunOutcome, RunRequest
from daemon.errors import (
    ConfigurationError,
    LogIOError,
    MissingInputError,
    PortInUseError,
    RobotUnreachableError,
)
from daemon.json_files import read_json, write_json
from daemon.log.parts import recover
from daemon.run.account import account_for_folder
from daemon.run.service import run_acquisition

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
WATCHDOG_S = 600.0
"""For a process that does not end; nothing is judged by it."""


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def gentle_request(folder: Path, port: int, **changes: Any) -> RunRequest:
    """One second of a small motion beside the pose in which the fake robot begins, so that the start ramp is short."""
    folder.mkdir(parents=True, exist_ok=True)
    angle = 2 * np.pi * np.arange(PERIOD_SAMPLES) / PERIOD_SAMPLES
    np.save(folder / "table.npy", np.array([0.1, 0.4, -0.1, -1.2, 0.1, 0.9, 0.1]) + 0.02 * (1 - np.cos(angle))[:, None])
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


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[tuple[int, Path]]:
    """Port that the fake robot sends to, and the file of its summary."""
    port, summary = free_port(), tmp_path / "robot.json"
    process = subprocess.Popen(
        [
            *(sys.executable, "-m", "fixtures.fake_robot", "--client", f"127.0.0.1:{port}", "--lockstep"),
            *("--duration", "600", "--seed", "3", "--json", str(summary)),
        ],
        cwd=REPOSITORY,
        stderr=subprocess.DEVNULL,
    )
    yield port, summary
    process.terminate()
    process.wait(WATCHDOG_S)


def states_of(path: Path) -> list[Any]:
    with AnyReader([path]) as bag:
        wanted = [each for each in bag.connections if each.topic == "/fri/state"]
        return [bag.deserialize(raw, connection.msgtype) for connection, _, raw in bag.messages(wanted)]


def commands_of(path: Path) -> list[Any]:
    """Positions sent, from the first that was not the robot's own."""
    with AnyReader([path]) as bag:
        wanted = [each for each in bag.connections if each.topic == "/fri/command"]
        commands = [bag.deserialize(raw, connection.msgtype) for connection, _, raw in bag.messages(wanted)]
    return [each.joint_position for each in commands if each.joint_position_valid]


def events_of(path: Path) -> list[Any]:
    with AnyReader([path]) as bag:
        wanted = [each for each in bag.connections if each.topic == "/run/events"]
        return [bag.deserialize(raw, connection.msgtype) for connection, _, raw in bag.messages(wanted)]


def assert_nothing_missing(path: Path) -> None:
    """The robot's counter has no hole, and every record of the loop stands in the file, as a sample or as an event."""
    states = states_of(path)
    assert set(np.diff([state.sequence_counter for state in states])) == {1}
    samples = [state.sample_index for state in states]
    assert len(samples) == len(set(samples))
    indexes = {*samples, *(event.sample_index for event in events_of(path))}
    assert sorted(indexes) == list(range(max(indexes) + 1))


def words_of(process: psutil.Process) -> str:
    """Its command line; none of one that has ended, as the robot may have by then."""
    with contextlib.suppress(psutil.ZombieProcess):
        return " ".join(process.cmdline())
    return ""


def child_of(process: psutil.Process, module: str) -> psutil.Process:
    return next(child for child in process.children() if module in " ".join(child.cmdline()))


def test_a_run_records_every_message_with_its_period_and_leaves_a_complete_folder_and_no_process(
    robot: tuple[int, Path], tmp_path: Path
) -> None:
    events: list[RunEvent] = []
    outcome = run_acquisition(gentle_request(tmp_path, robot[0]), observe=events.append)
    assert (outcome.exit_code, outcome.outcome) == (0, "completed"), outcome.sentences
    states = states_of(Path(outcome.recordings[0]))
    assert_nothing_missing(Path(outcome.recordings[0]))
    assert outcome.loop is not None
    assert len(states) == outcome.samples == outcome.loop.received
    assert (outcome.sequence_gaps, outcome.handover_gaps, outcome.loop.missing) == (0, 0, 0)
    for period in range(3):
        labels = [state.sample_in_period for state in states if state.period == period]
        assert labels == list(range(PERIOD_SAMPLES))
    assert outcome.samples_in_periods == 3 * PERIOD_SAMPLES
    assert events[0].kind == "starting"
    assert events[-1].kind == "finished"
    # A supervisor that is held up may miss one; that it tells each one it sees is a claim of test_narrator.
    told = [event.period for event in events if event.kind == "progress" and event.period >= 0]
    assert told == sorted(told)
    assert set(told) <= {0, 1, 2}
    # Peaks are those of what went out, differenced here; the judge says so too.
    sent = np.array(commands_of(Path(outcome.recordings[0])))
    for order, peak in ((1, outcome.loop.peak_command_velocity), (2, outcome.loop.peak_command_acceleration)):
        assert peak == pytest.approx(np.abs(np.diff(sent, order, axis=0)).max(axis=0) * 1000.0**order, rel=1e-6)
    assert outcome.judgement["passed"]
    assert outcome.judgement["set_points"] == outcome.judgement["commands"] > 3 * PERIOD_SAMPLES
    folder = Path(outcome.out_dir)
    names = {file.name for file in folder.iterdir()}
    inputs = {"request.json", "table.npy", "trajectory.json", "robot.urdf"}
    assert names == {"recording.mcap", "run.json", "loop_report.json"} | inputs
    assert read_json(folder / "run.json", RunOutcome) == outcome
    for digest in outcome.files:
        told = subprocess.run(["sha256sum", str(folder / digest.name)], capture_output=True, text=True, check=True)
        assert told.stdout.split()[0] == digest.sha256
        assert (folder / digest.name).stat().st_size == digest.bytes
    assert {digest.name for digest in outcome.files} == names - {"run.json"}
    assert not [child for child in psutil.Process().children() if "daemon." in words_of(child)]


def test_a_recorder_killed_in_the_motion_costs_no_sample_and_stops_the_arm(
    robot: tuple[int, Path], tmp_path: Path
) -> None:
    killed: list[int] = []

    def observe(event: RunEvent) -> None:
        if event.kind == "progress" and event.period >= 1 and not killed:
            recorder = child_of(psutil.Process(), "daemon.run.recorder")
            killed.append(recorder.pid)
            recorder.send_signal(signal.SIGKILL)

    outcome = run_acquisition(gentle_request(tmp_path, robot[0], periods=60), observe=observe)
    assert killed
    assert (outcome.exit_code, outcome.outcome) == (1, "stopped"), outcome.sentences
    assert outcome.loop is not None
    assert outcome.loop.reason == "RECORDER_LOST"
    assert outcome.loop.standstill_confirmed
    states = states_of(Path(outcome.recordings[0]))
    assert Path(outcome.recordings[0]).name == "recording.mcap"
    assert_nothing_missing(Path(outcome.recordings[0]))
    assert len(states) == outcome.loop.received
    assert any("another recorder took over" in sentence for sentence in outcome.sentences)
    assert "RECORDER_LOST" in {event.name for event in events_of(Path(outcome.recordings[0]))}


def test_a_recorder_stopped_for_ever_costs_no_sample(
    robot: tuple[int, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("daemon.run.service.STOPPED_S", 0.3)
    stopped: list[psutil.Process] = []

    def observe(event: RunEvent) -> None:
        if event.kind == "progress" and event.period >= 1 and not stopped:
            stopped.append(child_of(psutil.Process(), "daemon.run.recorder"))
            stopped[0].suspend()

    outcome = run_acquisition(gentle_request(tmp_path, robot[0], periods=600, ring_slots=2048), observe=observe)
    assert (outcome.exit_code, outcome.outcome) == (1, "stopped"), outcome.sentences
    assert outcome.loop is not None
    assert outcome.loop.reason == "RECORDER_LOST"
    # No number for what a machine may make of the moment: what is not in the file is counted, to the last one.
    states = states_of(Path(outcome.recordings[0]))
    assert len(states) == outcome.samples == outcome.loop.received
    assert outcome.handover_gaps == 0
    assert_nothing_missing(Path(outcome.recordings[0]))
    assert not stopped[0].is_running()


def test_a_loop_stopped_for_ever_is_ended_and_the_books_are_closed(
    robot: tuple[int, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("daemon.run.service.STOPPED_S", 0.3)
    held: list[psutil.Process] = []

    def observe(event: RunEvent) -> None:
        if event.kind == "progress" and event.period >= 1 and not held:
            held.append(child_of(psutil.Process(), "daemon.run.loop_process"))
            held[0].suspend()

    outcome = run_acquisition(gentle_request(tmp_path, robot[0], periods=600), observe=observe)
    assert (outcome.exit_code, outcome.outcome) == (70, "fault"), outcome.sentences
    assert outcome.loop is not None
    # It may have been held between a record and the count of it.
    assert outcome.samples - outcome.loop.received in (0, 1)
    assert read_json(tmp_path / "run" / "run.json", RunOutcome) == outcome


def test_an_observer_that_fails_ends_no_run(robot: tuple[int, Path], tmp_path: Path) -> None:
    def observe(event: RunEvent) -> None:
        raise OSError("the terminal is gone")

    outcome = run_acquisition(gentle_request(tmp_path, robot[0], periods=1), observe=observe)
    assert (outcome.exit_code, outcome.outcome) == (0, "completed"), outcome.sentences


def test_a_closed_terminal_stops_the_arm_by_ramp_and_the_books_are_closed(
    robot: tuple[int, Path], tmp_path: Path
) -> None:
    """The run has a terminal of its own, which goes in the excitation: SIGHUP, and EIO for every further word."""
    file = tmp_path / "input.json"
    write_json(file, gentle_request(tmp_path, robot[0], periods=600))
    process, terminal = pty.fork()
    if not process:
        os.chdir(REPOSITORY)
        os.execv(sys.executable, [sys.executable, "-c", RUN_CODE, str(file)])
    heard = b""
    while not has_begun_period(2, heard.decode(errors="replace")):
        heard += os.read(terminal, 4096)
    os.close(terminal)
    os.waitpid(process, 0)
    outcome = read_json(tmp_path / "run" / "run.json", RunOutcome)
    assert (outcome.outcome, outcome.exit_code) == ("stopped", 130)
    assert outcome.loop is not None
    assert outcome.loop.standstill_confirmed
    assert outcome.loop.reason == "TERMINAL_CLOSED"
    assert outcome.sentences[0].startswith("The terminal of the run was closed")
    assert outcome.samples == outcome.loop.received
    names = {each.name for each in (tmp_path / "run").iterdir()}
    assert not {name for name in names if name.startswith("recorder")}
    assert "last_samples.json" in names


def test_a_killed_loop_leaves_a_whole_recording_and_the_truth_about_it(robot: tuple[int, Path], tmp_path: Path) -> None:
    killed: list[psutil.Process] = []

    def observe(event: RunEvent) -> None:
        if event.kind == "progress" and event.period >= 1 and not killed:
            killed.append(child_of(psutil.Process(), "daemon.run.loop_process"))
            killed[0].send_signal(signal.SIGKILL)

    outcome = run_acquisition(gentle_request(tmp_path, robot[0], periods=60), observe=observe)
    assert (outcome.exit_code, outcome.outcome) == (70, "fault")
    assert "killed by signal 9" in outcome.sentences[0]
    states = states_of(Path(outcome.recordings[0]))
    assert_nothing_missing(Path(outcome.recordings[0]))
    assert outcome.samples == len(states) > PERIOD_SAMPLES
    # What the loop saw last comes from its ring, and stands in the log as well.
    kept = json.loads((Path(outcome.out_dir) / "last_samples.json").read_text())
    assert kept["reason"] == "LOOP_LOST"
    assert kept["columns"]["measured_position"][-1] == pytest.approx(list(states[-1].measured_joint_position))
    with open(outcome.recordings[0], "rb") as stream:
        assert "last_samples.json" in {each.name for each in make_reader(stream).iter_attachments()}


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


def test_interrupted_by_the_operator_the_arm_ramps_down_and_the_exit_code_is_130(
    robot: tuple[int, Path], tmp_path: Path
) -> None:
    process = start_run(gentle_request(tmp_path, robot[0], periods=60))
    read_until_period(process, 2)
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=WATCHDOG_S)
    assert process.returncode == 130
    outcome = read_json(tmp_path / "run" / "run.json", RunOutcome)
    assert outcome.outcome == "stopped"
    assert outcome.loop is not None
    assert outcome.loop.reason == "OPERATOR_STOP"
    assert outcome.loop.standstill_confirmed
    states = states_of(tmp_path / "run" / "recording.mcap")
    assert_nothing_missing(tmp_path / "run" / "recording.mcap")
    assert len(states) == outcome.loop.received


# SIGABRT is what a watchdog of systemd would send by default.
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGABRT])
def test_a_killed_supervisor_leaves_an_arm_at_rest_and_a_whole_file(
    robot: tuple[int, Path], tmp_path: Path, how: signal.Signals
) -> None:
    process = start_run(gentle_request(tmp_path, robot[0], periods=600, supervisor_timeout_s=4.0))
    read_until_period(process, 2)
    children = psutil.Process(process.pid).children()
    assert len(children) == 2
    process.send_signal(how)
    process.communicate(timeout=WATCHDOG_S)
    wait_gone(children)
    report = json.loads((tmp_path / "run" / "loop_report.json").read_text())
    assert report["reason"] == "SUPERVISOR_LOST"
    assert report["standstill_confirmed"]
    states = states_of(tmp_path / "run" / "recording.mcap")
    assert_nothing_missing(tmp_path / "run" / "recording.mcap")
    assert len(states) == report["received"]


def kill_together(processes: list[psutil.Process]) -> None:
    """SIGSTOP first, so that none sees another one's death."""
    for number in (signal.SIGSTOP, signal.SIGKILL):
        for process in processes:
            process.send_signal(number)


def test_supervisor_and_recorder_killed_at_once_cost_no_sample_and_the_arm_comes_to_rest(
    robot: tuple[int, Path], tmp_path: Path
) -> None:
    process = start_run(gentle_request(tmp_path, robot[0], periods=600, supervisor_timeout_s=4.0))
    read_until_period(process, 2)
    supervisor = psutil.Process(process.pid)
    loop = child_of(supervisor, "daemon.run.loop_process")
    kill_together([supervisor, child_of(supervisor, "daemon.run.recorder")])
    process.communicate(timeout=WATCHDOG_S)
    wait_gone([loop])
    report = json.loads((tmp_path / "run" / "loop_report.json").read_text())
    assert report["reason"] in ("SUPERVISOR_LOST", "RECORDER_LOST")
    assert report["standstill_confirmed"]
    states = states_of(tmp_path / "run" / "recording.mcap")
    assert_nothing_missing(tmp_path / "run" / "recording.mcap")
    assert len(states) == report["received"]
    assert "Supervisor and recorder were gone" in (tmp_path / "run" / "loop.log").read_text()


def wait_for_chunks(file: Path, count: int) -> None:
    """Until the recorder has handed over so many more pieces."""
    for _ in range(count):
        before = file.stat().st_size
        while file.stat().st_size == before:
            time.sleep(0.01)


def test_all_processes_killed_at_once_leave_all_but_the_last_chunk_and_recover_says_so(
    robot: tuple[int, Path], tmp_path: Path
) -> None:
    """That no chunk holds more than a quarter of a second is a claim of test_log, by a simulated clock."""
    process = start_run(gentle_request(tmp_path, robot[0], periods=600))
    read_until_period(process, 3)
    wait_for_chunks(tmp_path / "run" / "recording.mcap", 2)
    supervisor = psutil.Process(process.pid)
    with pytest.raises(LogIOError, match="being recorded"):
        recover(tmp_path / "run")
    children = supervisor.children()
    kill_together([supervisor, *children])
    process.communicate(timeout=WATCHDOG_S)
    wait_gone(children)
    with pytest.raises(ConfigurationError, match="recover"):
        run_acquisition(gentle_request(tmp_path, free_port()), observe=lambda _: None)
    report = recover(tmp_path / "run")
    outcome = account_for_folder(tmp_path / "run", report)
    assert outcome is not None
    assert (outcome.outcome, outcome.exit_code, outcome.samples) == ("fault", 70, report.samples)
    assert outcome.loop is not None
    assert outcome.loop.periods_completed >= 1
    assert read_json(tmp_path / "run" / "run.json", RunOutcome) == outcome
    assert account_for_folder(tmp_path / "run", report) is None
    assert not report.whole
    assert (report.missing, report.missing_in_handover) == (0, 0)
    states = states_of(report.recovered)
    assert len(states) == report.samples > 2 * PERIOD_SAMPLES


def test_no_robot_is_said_within_the_time_allowed_with_exit_code_69(tmp_path: Path) -> None:
    port = free_port()
    outcome = run_acquisition(gentle_request(tmp_path, port, start_timeout_s=0.3), observe=lambda _: None)
    assert (outcome.exit_code, outcome.outcome) == (69, "no_robot")
    assert str(port) in " ".join(outcome.sentences) or "0.3" in " ".join(outcome.sentences)


def test_another_fri_version_is_a_mismatch_with_exit_code_76(robot: tuple[int, Path], tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ear:
        ear.bind(("127.0.0.1", robot[0]))
        ear.recv(2048)  # the robot sends from here on
    request = gentle_request(tmp_path, robot[0], fri_version="2.7", start_timeout_s=3.0)
    outcome = run_acquisition(request, observe=lambda _: None)
    assert (outcome.exit_code, outcome.outcome) == (76, "version_mismatch")
    assert "2.7" in outcome.sentences[0]


def test_a_start_that_failed_can_be_repeated_into_the_same_folder(tmp_path: Path) -> None:
    for number in (0, 1):
        outcome = run_acquisition(gentle_request(tmp_path, free_port(), start_timeout_s=0.2), observe=lambda _: None)
        assert outcome.exit_code == 69
        assert len(list((tmp_path / "run").glob("failed-start-*"))) == number


@pytest.fixture(params=["2.5", "2.7"])
def newer_robot(request: pytest.FixtureRequest) -> Iterator[tuple[int, str]]:
    port = free_port()
    process = subprocess.Popen(
        [
            *(sys.executable, "-m", "fixtures.fake_robot", "--client", f"127.0.0.1:{port}", "--lockstep"),
            *("--duration", "600", "--seed", "3", "--fri-version", request.param),
        ],
        cwd=REPOSITORY,
        stderr=subprocess.DEVNULL,
    )
    yield port, request.param
    process.terminate()
    process.wait(WATCHDOG_S)


def test_the_version_is_heard_before_anything_is_started(newer_robot: tuple[int, str], tmp_path: Path) -> None:
    port, spoken = newer_robot
    outcome = run_acquisition(gentle_request(tmp_path, port, periods=1, fri_version="auto"), observe=lambda _: None)
    assert (outcome.exit_code, outcome.outcome) == (0, "completed"), outcome.sentences
    assert outcome.request is not None
    assert outcome.request.fri_version == spoken
    with open(outcome.recordings[0], "rb") as stream:
        told = {record.name: record.metadata for record in make_reader(stream).iter_metadata()}
    assert told["iiwa_ident"]["fri_version"] == spoken


def test_nobody_to_hear_leaves_no_folder(tmp_path: Path) -> None:
    with pytest.raises(RobotUnreachableError):
        run_acquisition(
            gentle_request(tmp_path, free_port(), fri_version="auto", start_timeout_s=0.2), observe=lambda _: None
        )
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("newer_robot", ["2.5"], indirect=True)
def test_a_version_that_only_looks_alike_is_said_before_the_motion(
    newer_robot: tuple[int, str], tmp_path: Path
) -> None:
    events: list[RunEvent] = []
    request = gentle_request(tmp_path, newer_robot[0], periods=1, fri_version="1.15")
    outcome = run_acquisition(request, observe=events.append)
    assert outcome.outcome == "completed", outcome.sentences
    said = next(number for number, event in enumerate(events) if "--fri-version 2.5" in event.sentence)
    moving = next(number for number, event in enumerate(events) if event.sentence == "Motion: start ramp.")
    assert events[said].kind == "warning"
    assert said < moving


def test_a_port_in_use_is_said_before_any_process_is_started(tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        with pytest.raises(PortInUseError) as caught:
            run_acquisition(gentle_request(tmp_path, port), observe=lambda _: None)
    assert caught.value.exit_code == 69
    assert str(port) in str(caught.value)


def test_a_folder_with_a_recording_is_never_written_over(tmp_path: Path) -> None:
    request = gentle_request(tmp_path, free_port())
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "recording.mcap").write_bytes(b"precious")
    with pytest.raises(ConfigurationError):
        run_acquisition(request, observe=lambda _: None)
    assert (tmp_path / "run" / "recording.mcap").read_bytes() == b"precious"


def test_an_absent_table_is_missing_input(tmp_path: Path) -> None:
    request = gentle_request(tmp_path, free_port())
    os.remove(request.table_file)
    with pytest.raises(MissingInputError) as caught:
        run_acquisition(request, observe=lambda _: None)
    assert caught.value.exit_code == 66


def test_a_table_with_nan_is_refused_before_anything_moves(robot: tuple[int, Path], tmp_path: Path) -> None:
    request = gentle_request(tmp_path, robot[0])
    table = np.load(request.table_file)
    table[5, 2] = np.nan
    np.save(request.table_file, table)
    outcome = run_acquisition(request, observe=lambda _: None)
    assert (outcome.exit_code, outcome.outcome) == (65, "refused")
    assert "joint 3" in outcome.sentences[0].lower()
