"""Claims about a whole run over UDP in lockstep: its folder, its exit codes, and what is said before anything moves.

Truth: the fake robot's own summary, and the recording read back by rosbags.
"""

from __future__ import annotations

import os
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import psutil
import pytest
from mcap.reader import make_reader

from daemon.api import RunEvent, RunOutcome
from daemon.errors import (
    ConfigurationError,
    MissingInputError,
    PortInUseError,
    RobotUnreachableError,
)
from daemon.json_files import read_json
from daemon.run.service import run_acquisition
from tests.ports import free_udp_port

from .recorder_results import read_states
from .service_process import fake_robot
from .service_runs import (
    PERIOD_SAMPLES,
    assert_nothing_missing,
    commands_of,
    gentle_request,
    words_of,
)


def test_a_run_records_every_message_with_its_period_and_leaves_a_complete_folder_and_no_process(
    robot: tuple[int, Path], tmp_path: Path
) -> None:
    events: list[RunEvent] = []
    outcome = run_acquisition(gentle_request(tmp_path, robot[0]), observe=events.append)
    assert (outcome.exit_code, outcome.outcome) == (0, "completed"), outcome.sentences
    states = read_states(Path(outcome.recordings[0]))
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


def test_a_fit_that_the_disk_refuses_does_not_cost_the_account_of_the_run(
    robot: tuple[int, Path], tmp_path: Path
) -> None:
    """A folder stands where the fit's job would be written; the arm has moved, and run.json has to say how."""
    request = gentle_request(tmp_path, robot[0], periods=1, fit=True)
    (Path(request.out_dir) / "worker_job.json" / "in the way").mkdir(parents=True)
    outcome = run_acquisition(request, observe=lambda _: None)
    assert (outcome.outcome, outcome.exit_code, outcome.worker_pid) == ("completed", 74, None)
    assert any("The fit was not started: " in sentence for sentence in outcome.sentences)
    assert read_json(Path(request.out_dir) / "run.json", RunOutcome).sentences == outcome.sentences


def test_an_observer_that_fails_ends_no_run(robot: tuple[int, Path], tmp_path: Path) -> None:
    def observe(event: RunEvent) -> None:
        raise OSError("the terminal is gone")

    outcome = run_acquisition(gentle_request(tmp_path, robot[0], periods=1), observe=observe)
    assert (outcome.exit_code, outcome.outcome) == (0, "completed"), outcome.sentences


def test_no_robot_is_said_within_the_time_allowed_with_exit_code_69(tmp_path: Path) -> None:
    port = free_udp_port()
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
        outcome = run_acquisition(
            gentle_request(tmp_path, free_udp_port(), start_timeout_s=0.2), observe=lambda _: None
        )
        assert outcome.exit_code == 69
        assert len(list((tmp_path / "run").glob("failed-start-*"))) == number


@pytest.fixture(params=["2.5", "2.7"])
def newer_robot(request: pytest.FixtureRequest) -> Iterator[tuple[int, str]]:
    port = free_udp_port()
    with fake_robot(port, "--fri-version", request.param):
        yield port, request.param


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
            gentle_request(tmp_path, free_udp_port(), fri_version="auto", start_timeout_s=0.2), observe=lambda _: None
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
    request = gentle_request(tmp_path, free_udp_port())
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "recording.mcap").write_bytes(b"precious")
    with pytest.raises(ConfigurationError):
        run_acquisition(request, observe=lambda _: None)
    assert (tmp_path / "run" / "recording.mcap").read_bytes() == b"precious"


def test_an_absent_table_is_missing_input(tmp_path: Path) -> None:
    request = gentle_request(tmp_path, free_udp_port())
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
