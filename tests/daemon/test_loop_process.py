"""The loop's process, started as the supervisor starts it: its ends, its codes, and one run against the fake robot."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from daemon.api import LoopReport, RunRequest
from daemon.json_files import read_json, write_json
from fri_client.handover.motion_phase import MotionPhase
from fri_client.handover.ring import EventCode, HandoverRecord, HandoverRing
from fri_client.messages import FriVersion
from fri_client.wire.codec import Codec
from tests.ports import free_udp_port
from tests.watchdog import WATCHDOG_S

ROWS = 500


def short_table() -> np.ndarray:
    """Half a second of a gentle sine around the fake robot's home position."""
    home = np.array([0.0, 0.3, 0.0, -0.5, 0.0, 0.3, 0.0])
    return home + 0.005 * np.sin(2 * np.pi * np.arange(ROWS) / ROWS)[:, None]


def request_in(folder: Path, table: np.ndarray | None = None, **changes: Any) -> RunRequest:
    np.save(folder / "table.npy", short_table() if table is None else table)
    options: dict[str, Any] = {
        "periods": 1,
        "lead_in_s": 0.1,
        "bind_port": free_udp_port(),
        "receive_timeout_s": 60.0,
        "realtime_priority": 0,
        "table_file": str(folder / "table.npy"),
        **changes,
    }
    request = RunRequest(
        run_id="test", robot="iiwa14", trajectory_file=str(folder / "none.json"), out_dir=str(folder), **options
    )
    write_json(folder / "request.json", request)
    return request


@contextmanager
def loop_process(folder: Path) -> Iterator[tuple[subprocess.Popen[str], HandoverRing]]:
    ring = HandoverRing.create(16384)
    command = [sys.executable, "-m", "daemon.run.loop_process", "--request", str(folder / "request.json")]
    process = subprocess.Popen(
        [*command, "--ring-fd", str(ring.fd)], pass_fds=[ring.fd], stderr=subprocess.PIPE, text=True
    )
    try:
        yield process, ring
    finally:
        process.kill()
        process.communicate()
        ring.close()


@contextmanager
def fake_robot(folder: Path, request: RunRequest, *options: str) -> Iterator[Path]:
    summary = folder / "robot.json"
    command = [sys.executable, "-m", "fixtures.fake_robot", "--client", f"127.0.0.1:{request.bind_port}", "-q"]
    command += ["--fri-version", request.fri_version, "--lockstep", "--duration", "60", "--json", str(summary)]
    process = subprocess.Popen([*command, *options])
    try:
        yield summary
    finally:
        process.terminate()
        process.wait(WATCHDOG_S)


def wait_until_listening(process: subprocess.Popen[str], ring: HandoverRing) -> None:
    while ring.status.time_ns == 0:
        assert process.poll() is None, process.communicate()
        time.sleep(0.01)


def drain(process: subprocess.Popen[str], ring: HandoverRing) -> list[HandoverRecord]:
    records: list[HandoverRecord] = []
    while not (ring.finished and ring.backlog == 0):
        assert process.poll() is None or ring.finished, "the ring must be marked as finished whatever happens"
        records += ring.read_batch()
        ring.release()
        time.sleep(0.002)
    return records


@pytest.mark.parametrize("version", ["1.15", "2.5", "2.7"])
def test_one_period_against_the_fake_robot_is_answered_to_the_last_message(tmp_path: Path, version: str) -> None:
    request = request_in(tmp_path, fri_version=version)
    with loop_process(tmp_path) as (process, ring):
        wait_until_listening(process, ring)
        with fake_robot(tmp_path, request) as summary_file:
            records = drain(process, ring)
            assert process.wait(WATCHDOG_S) == 0
    report = read_json(tmp_path / "loop_report.json", LoopReport)
    summary = json.loads(summary_file.read_text())
    assert (report.outcome, report.standstill_confirmed, report.periods_completed) == ("completed", True, 1)
    assert (report.missing, report.refused, report.undecodable, report.lost_in_handover) == (0, 0, 0, 0)
    assert report.received == report.answered == len([record for record in records if record.monitoring])
    # The robot's own counting, by code that shares nothing with the client's.
    assert summary["counts"]["commands_rejected"] == 0
    assert summary["counts"]["answered"] == report.answered
    assert summary["judgement"]["passed"]
    # Every sample once, with consecutive counters of the robot.
    driven = [record for record in records if record.phase == MotionPhase.EXCITATION]
    assert [record.sample_in_period for record in driven] == list(range(ROWS))
    codec = Codec(FriVersion.parse(version))
    counters = [codec.decode_monitoring(record.monitoring).header.sequence_counter for record in driven]
    assert np.all(np.diff(counters) == 1)
    assert [span.phase for span in report.phases if span.period == 0] == ["EXCITATION"]
    assert sum(report.turn_around.counts) == report.answered


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_a_signal_stops_the_arm_by_ramp_and_the_report_is_written(tmp_path: Path, number: signal.Signals) -> None:
    request = request_in(tmp_path, periods=100)
    with loop_process(tmp_path) as (process, ring):
        wait_until_listening(process, ring)
        with fake_robot(tmp_path, request) as summary_file:
            records: list[HandoverRecord] = []
            while ring.status.phase != MotionPhase.EXCITATION:
                assert process.poll() is None
                records += ring.read_batch()
                ring.release()
                time.sleep(0.002)
            process.send_signal(number)
            records += drain(process, ring)
            assert process.wait(WATCHDOG_S) == 1
            assert process.stderr is not None
            said = process.stderr.read()
    report = read_json(tmp_path / "loop_report.json", LoopReport)
    assert (report.outcome, report.reason, report.standstill_confirmed) == ("stopped", "SIGNAL_STOP", True)
    assert f"{number.name} asked for a stop. The arm was stopped by ramp, along its path, in " in said
    assert (report.stop_kind, report.overruled) == ("path", 0)
    kept = json.loads((tmp_path / "last_samples.json").read_text())
    assert (kept["reason"], kept["tick"]) == ("SIGNAL_STOP", report.tick)
    columns = kept["columns"]
    # Two seconds of the host's time before the stop and after it; the robot in lockstep has a time of its own.
    end = next(record.receive_ns for record in records if record.event_code == EventCode.SIGNAL_STOP)
    around = [record.index for record in records if -2e9 <= record.receive_ns - end <= 2e9]
    assert columns["index"] == around
    assert len(around) == report.last_samples
    assert columns["event"][around.index(next(r.index for r in records if r.receive_ns == end))] == "SIGNAL_STOP"
    ramp = [record for record in records if record.command is not None and record.phase == MotionPhase.STOP_RAMP]
    assert len(ramp) == pytest.approx(report.stop_duration_s * 1000, abs=2)
    assert json.loads(summary_file.read_text())["counts"]["commands_rejected"] == 0


def test_a_supervisor_that_falls_silent_and_a_recorder_that_is_gone_leave_a_stopped_arm(tmp_path: Path) -> None:
    request = request_in(tmp_path, periods=1000, supervisor_timeout_s=0.5)
    with loop_process(tmp_path) as (process, ring):
        wait_until_listening(process, ring)
        with fake_robot(tmp_path, request):
            while ring.status.phase != MotionPhase.EXCITATION:
                assert process.poll() is None
                time.sleep(0.005)
            ring.beat()  # the first: from here on it is watched
            assert process.wait(WATCHDOG_S) == 1  # nobody beats any more, nobody reads
    report = read_json(tmp_path / "loop_report.json", LoopReport)
    assert report.reason in ("SUPERVISOR_LOST", "RECORDER_LOST")
    assert (report.outcome, report.standstill_confirmed, report.lost_in_handover) == ("stopped", True, 0)


def run_to_its_end(folder: Path) -> tuple[int, str, LoopReport | None]:
    with loop_process(folder) as (process, ring):
        code = process.wait(WATCHDOG_S)
        assert process.stderr is not None
        said = process.stderr.read()
        assert ring.finished
    report = folder / "loop_report.json"
    return code, said, read_json(report, LoopReport) if report.exists() else None


def test_a_port_in_use_is_one_sentence_and_69(tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        request_in(tmp_path, bind_port=other.getsockname()[1])
        code, said, report = run_to_its_end(tmp_path)
    assert (code, report.outcome if report else None) == (69, "port_in_use")
    assert "in use by another program" in said
    assert said.count("\n") == 1


def hole() -> np.ndarray:
    table = short_table()
    table[123, 3] = np.nan
    return table


@pytest.mark.parametrize(
    ("table", "changes", "code", "words"),
    [
        (hole(), {}, 65, "row 123, joint 4"),
        (short_table()[:, :5], {}, 65, "7 joint positions"),
        (None, {"table_file": "/nowhere/table.npy"}, 66, "/nowhere/table.npy does not exist"),
        (None, {"fri_version": "3.0"}, 78, "3.0"),
        (None, {"bind_host": "203.0.113.7"}, 78, "choose an address of this machine"),
        (None, {"start_timeout_s": 0.2}, 69, "No FRI message arrived within 0.2 s"),
    ],
)
def test_what_cannot_be_run_ends_with_one_sentence_and_its_code(
    tmp_path: Path, table: np.ndarray | None, changes: dict[str, Any], code: int, words: str
) -> None:
    request_in(tmp_path, table, **changes)
    found, said, report = run_to_its_end(tmp_path)
    assert found == code, said
    assert words in said
    assert said.count("\n") == 1, "one sentence, no traceback"
    assert report is not None
    assert report.answered == 0


def test_a_request_that_is_missing_or_garbled_has_its_code(tmp_path: Path) -> None:
    code, said, _ = run_to_its_end(tmp_path)
    assert (code, "request.json" in said) == (66, True)
    (tmp_path / "request.json").write_text("{")
    code, said, _ = run_to_its_end(tmp_path)
    assert (code, "request.json" in said) == (78, True)


def test_a_descriptor_that_is_no_ring_is_refused(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "daemon.run.loop_process", "--request", "x", "--ring-fd", "987"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == 70
    assert "descriptor 987" in done.stderr
