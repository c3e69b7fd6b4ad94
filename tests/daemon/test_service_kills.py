"""Claims about a run whose processes are killed, stopped or interrupted: the arm comes to rest, the books are closed.
Single processes that are killed: tests/end_to_end/test_faults_of_host.py.

Truth: the fake robot's own summary, and the recording read back by rosbags.
"""

from __future__ import annotations

import json
import os
import pty
import signal
import sys
from pathlib import Path

import psutil
import pytest

from daemon.api import RunEvent, RunOutcome
from daemon.errors import (
    ConfigurationError,
    LogIOError,
)
from daemon.json_files import read_json, write_json
from daemon.log.parts import recover
from daemon.run.account import account_for_folder
from daemon.run.folder import make_room
from daemon.run.next_step import next_step
from daemon.run.service import run_acquisition
from tests.daemon.command_line import run
from tests.ports import free_udp_port

from .recorder_results import read_states
from .service_runs import (
    PERIOD_SAMPLES,
    REPOSITORY,
    RUN_CODE,
    WATCHDOG_S,
    assert_nothing_missing,
    child_of,
    gentle_request,
    has_begun_period,
    kill_together,
    read_until_period,
    start_run,
    wait_for_chunks,
    wait_gone,
)


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
    states = read_states(Path(outcome.recordings[0]))
    assert len(states) == outcome.samples == outcome.loop.received
    assert outcome.samples_in_periods == sum(state.period >= 0 for state in states) > PERIOD_SAMPLES
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


def test_a_run_under_nohup_outlives_its_terminal(robot: tuple[int, Path], tmp_path: Path) -> None:
    """As nohup does it: SIGHUP is ignored from the start. Neither the supervisor nor the loop is stopped by it."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        process = start_run(gentle_request(tmp_path, robot[0], periods=600))
    finally:
        signal.signal(signal.SIGHUP, before)
    read_until_period(process, 1)
    supervisor = psutil.Process(process.pid)
    for each in (supervisor, child_of(supervisor, "daemon.run.loop_process")):
        each.send_signal(signal.SIGHUP)
    read_until_period(process, 4)
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=WATCHDOG_S)
    outcome = read_json(tmp_path / "run" / "run.json", RunOutcome)
    assert outcome.loop is not None
    assert (outcome.outcome, outcome.loop.reason) == ("stopped", "OPERATOR_STOP"), outcome.sentences


def test_a_killed_supervisor_leaves_an_arm_at_rest_and_a_whole_file(robot: tuple[int, Path], tmp_path: Path) -> None:
    """SIGABRT is what a watchdog of systemd would send by default; kill -9 is in the table of faults."""
    process = start_run(gentle_request(tmp_path, robot[0], periods=600, supervisor_timeout_s=4.0))
    read_until_period(process, 2)
    children = psutil.Process(process.pid).children()
    assert len(children) == 2
    process.send_signal(signal.SIGABRT)
    process.communicate(timeout=WATCHDOG_S)
    wait_gone(children)
    report = json.loads((tmp_path / "run" / "loop_report.json").read_text())
    assert report["reason"] == "SUPERVISOR_LOST"
    assert report["standstill_confirmed"]
    states = read_states(tmp_path / "run" / "recording.mcap")
    assert_nothing_missing(tmp_path / "run" / "recording.mcap")
    assert len(states) == report["received"]


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
        run_acquisition(gentle_request(tmp_path, free_udp_port()), observe=lambda _: None)
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
    states = read_states(report.recovered)
    assert len(states) == report.samples > 2 * PERIOD_SAMPLES
    assert outcome.samples_in_periods == sum(state.period >= 0 for state in states) > PERIOD_SAMPLES


@pytest.mark.parametrize("with_supervisor", [False, True], ids=["the loop alone", "all processes"])
def test_of_a_run_that_no_robot_spoke_to_nobody_says_that_an_arm_may_still_move(
    tmp_path: Path, with_supervisor: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    process = start_run(gentle_request(tmp_path, free_udp_port()))
    assert process.stdout is not None
    assert any(line.startswith("waiting") for line in process.stdout)
    supervisor = psutil.Process(process.pid)
    children = supervisor.children()
    if with_supervisor:
        kill_together([supervisor, *children])
    else:
        child_of(supervisor, "daemon.run.loop_process").kill()
    process.communicate(timeout=WATCHDOG_S)
    wait_gone(children)
    if with_supervisor:
        assert run("recover", tmp_path / "run") == 0
        assert "nothing was moved by this run" in capsys.readouterr().out
    outcome = read_json(tmp_path / "run" / "run.json", RunOutcome)
    assert (outcome.outcome, outcome.exit_code, outcome.samples) == ("fault", 70, 0)
    told = " ".join(outcome.sentences)
    assert "nothing was moved by this run" in told
    assert "standstill" not in told
    assert "takes the recording" not in told
    assert next_step(outcome, None) == "Next: nothing moved; the same command can be given again."
    make_room(tmp_path / "run")
