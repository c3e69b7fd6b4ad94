"""Claims about the long-running service, made with real processes: service, loop, recorder, fit and fake robot.

Truth: the loop's own report, the robot's own account of what it was sent, and the files of the jobs.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import psutil
import pytest
import zmq
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from daemon.api import RunEvent
from daemon.queue.control_api import (
    CancelJob,
    Ping,
    Pong,
    RefusedRequestError,
    Resumed,
    ResumeQueue,
    StopMotion,
    Stopped,
    SubmitRun,
    Submitted,
    decode_reply,
)
from daemon.queue.control_socket import ServiceUnreachableError, ask
from daemon.run.service import run_acquisition
from daemon.stop_handle import StopHandle
from tests.daemon.service_process import (
    ServiceProcess,
    fake_robot,
    iiwa_ident,
    service,
    until_excitation,
    wait_for,
)
from tests.daemon.test_service import gentle_request
from tests.ports import free_tcp_port, free_udp_port
from tests.short_motion import short_trajectory
from tests.watchdog import WATCHDOG_S


@pytest.fixture(scope="module")
def idle(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServiceProcess]:
    with service(tmp_path_factory.mktemp("idle")) as running:
        yield running


def submit(running: ServiceProcess, trajectory: Path, **changes: Any) -> str:
    reply = running.ask(SubmitRun(trajectory=trajectory.read_bytes(), name=trajectory.name, **changes))
    assert isinstance(reply, Submitted)
    return reply.job_id


def loop_report(running: ServiceProcess, job_id: str) -> dict[str, Any]:
    report: dict[str, Any] = json.loads((running.output / job_id / "loop_report.json").read_text())
    return report


def test_from_submission_to_a_stop_in_the_motion_and_what_waits_stays_where_it_is(tmp_path: Path) -> None:
    trajectory = short_trajectory(tmp_path / "short.json")
    with service(tmp_path) as running, fake_robot(running.port, "--json", tmp_path / "robot.json"):
        assert iiwa_ident("ping", "--port", running.port).returncode == 0
        told = iiwa_ident("submit", trajectory, "--periods", 500, "--port", running.port, "--json", "-")
        assert told.returncode == 0, told.stderr
        first = json.loads(told.stdout)["job_id"]
        second = submit(running, trajectory, periods=1)
        running.wait_phase(second, "queued")
        until_excitation(running, first)
        status = json.loads(iiwa_ident("status", "--port", running.port, "--json", "-").stdout)
        assert (status["state"], status["run"], status["periods"], status["waiting"]) == ("running", first, 500, 1)

        stopped = json.loads(iiwa_ident("stop", "--port", running.port, "--json", "-").stdout)
        assert (stopped["was_moving"], stopped["already"], stopped["run"]) == (True, False, first)
        again = running.ask(StopMotion())
        assert isinstance(again, Stopped)
        # The arm may have come to rest between the two.
        assert again.already or not again.was_moving
        assert running.wait_phase(first, "stopped").exit_code == 1
        report = loop_report(running, first)
        assert (report["outcome"], report["reason"]) == ("stopped", "OPERATOR_STOP")
        assert report["standstill_confirmed"]

        assert running.phase(second) == "held"
        listed = json.loads(iiwa_ident("jobs", "--port", running.port, "--json", "-").stdout)
        assert [(job["job_id"], job["phase"]) for job in listed["jobs"]] == [(second, "held"), (first, "stopped")]
        assert isinstance(released := running.ask(ResumeQueue()), Resumed)
        assert released.released == 1
        assert running.phase(second) in ("queued", "preparing", "running")
    assert json.loads((tmp_path / "robot.json").read_text())["rejections"] == []


def test_a_killed_service_leaves_an_arm_at_rest_and_finds_its_jobs_again(tmp_path: Path) -> None:
    trajectory = short_trajectory(tmp_path / "short.json")
    with service(tmp_path) as running, fake_robot(running.port, "--json", tmp_path / "robot.json"):
        first = submit(running, trajectory, periods=500)
        second = submit(running, trajectory, periods=1)
        running.wait_phase(second, "queued")
        until_excitation(running, first)
        children = psutil.Process(running.process.pid).children()
        running.process.send_signal(signal.SIGKILL)
        running.process.wait()
        _, alive = psutil.wait_procs(children, timeout=WATCHDOG_S)
        assert not alive
        report = loop_report(running, first)
        assert report["reason"] == "SUPERVISOR_LOST"
        assert report["standstill_confirmed"]

        running.start()
        assert running.phase(first) == "interrupted"
        assert str(running.output / first) in running.jobs()[first].sentence
        assert running.phase(second) == "held"
        assert (running.status().state, running.status().held) == ("idle", 1)
        running.ask(CancelJob(job_id=second))
        assert running.phase(second) == "cancelled"
        running.process.terminate()
        assert running.process.wait(WATCHDOG_S) == 0
        running.start()
        assert (running.phase(first), running.phase(second)) == ("interrupted", "cancelled")


def test_sigterm_ramps_the_arm_down_and_then_the_service_ends_and_systemd_is_told(tmp_path: Path) -> None:
    trajectory = short_trajectory(tmp_path / "short.json")
    heard: list[bytes] = []
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "notify"))
        manager.settimeout(0.2)
        end = threading.Event()

        def listen() -> None:
            while not end.is_set():
                try:
                    heard.append(manager.recv(4096))
                except TimeoutError:
                    continue

        listener = threading.Thread(target=listen)
        listener.start()
        running = ServiceProcess(tmp_path)
        running.start(NOTIFY_SOCKET=str(tmp_path / "notify"), WATCHDOG_USEC="400000")
        try:
            with fake_robot(running.port, "--json", tmp_path / "robot.json"):
                job = submit(running, trajectory, periods=500)
                until_excitation(running, job)
                running.process.terminate()
                assert running.process.wait(WATCHDOG_S) == 0
        finally:
            running.kill()
            end.set()
            listener.join()
    report = loop_report(running, job)
    assert (report["outcome"], report["reason"]) == ("stopped", "SIGNAL_STOP")
    assert report["standstill_confirmed"]
    assert json.loads((running.output / job / "run.json").read_text())["outcome"] == "stopped"
    assert heard[0].startswith(b"READY=1\nSTATUS=")
    assert heard[-1] == b"STOPPING=1"
    assert heard.count(b"WATCHDOG=1") > 5
    assert any(line.startswith(b"STATUS=Run ") for line in heard)


def test_a_run_whose_operator_cannot_be_heard_any_more_ramps_down_by_itself(tmp_path: Path) -> None:
    port = free_udp_port()
    # The control thread hangs from the second period on.
    hangs = threading.Event()

    class Unheard(StopHandle):
        @property
        def alive(self) -> bool:
            return not hangs.is_set()

    def observe(event: RunEvent) -> None:
        if event.kind == "progress" and event.period >= 1:
            hangs.set()

    with fake_robot(port, "--json", tmp_path / "robot.json"):
        request = gentle_request(tmp_path, port, periods=600, supervisor_timeout_s=4.0)
        outcome = run_acquisition(request, observe=observe, stop=Unheard())
    assert outcome.loop is not None
    assert outcome.loop.reason == "SUPERVISOR_LOST"
    assert outcome.loop.standstill_confirmed


def test_a_finished_run_is_fitted_and_a_fit_survives_the_service(tmp_path: Path) -> None:
    trajectory = short_trajectory(tmp_path / "short.json", period_s=1.0, scale=0.1)
    with service(tmp_path) as running:
        with fake_robot(running.port, "--json", tmp_path / "robot.json"):
            job = submit(running, trajectory, periods=3, fit=True)
            assert running.wait_phase(job, "done", "failed", "stopped", "refused").phase == "done"
        running.wait_phase(f"{job}-fit", "running", "done")
        status_file = running.output / job / "worker_status.json"
        wait_for(lambda: status_file.exists() and json.loads(status_file.read_text())["pid"] > 0)
        running.process.send_signal(signal.SIGKILL)
        running.process.wait()
        running.start()
        assert running.wait_phase(f"{job}-fit", "done", "failed").phase == "done"
        model = json.loads((running.output / job / "model.json").read_text())
        assert len(model["base_parameters"]) == 57


def test_a_port_has_one_service_and_a_run_in_the_foreground_is_refused_too(idle: ServiceProcess) -> None:
    for command in (("daemon", "--config", idle.config), ("run", "--bind", f"127.0.0.1:{idle.port}", "--no-confirm")):
        refused = iiwa_ident(*command)
        assert refused.returncode == 69, refused.stderr
        assert f"process {idle.process.pid}" in refused.stderr
    assert isinstance(idle.ask(Ping()), Pong)


def test_an_unsafe_motion_is_refused_at_submission_and_says_why(idle: ServiceProcess, tmp_path: Path) -> None:
    wild = short_trajectory(tmp_path / "wild.json", scale=4.0, offset=None)
    told = iiwa_ident("submit", wild, "--port", idle.port, "--json", "-")
    assert told.returncode == 1
    job = json.loads(told.stdout)
    assert job["phase"] == "refused"
    assert "joint" in job["sentence"]
    assert not Path(job["folder"]).exists()


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("broken.json", b"{"),
        ("nested.json", b"[" * 100_000),
        ("object.json", b'{"a": 1}'),
        ("pickle.npz", b"\x80\x04\x95\x10\x00"),
        ("nan.csv", b"q1,q2,q3,q4,q5,q6,q7\nnan,0,0,0,0,0,0\n"),
        ("empty.csv", b""),
    ],
)
def test_a_file_that_is_no_trajectory_costs_one_job_and_nothing_else(
    idle: ServiceProcess, tmp_path: Path, name: str, content: bytes
) -> None:
    (tmp_path / name).write_bytes(content)
    reply = idle.ask(SubmitRun(trajectory=content, suffix=Path(name).suffix, name=name))  # type: ignore[arg-type]
    assert isinstance(reply, Submitted)
    job = idle.wait_phase(reply.job_id, "refused", "queued", "failed")
    assert job.phase == "refused"
    assert job.exit_code in (1, 65)
    assert "Traceback" not in job.sentence


def test_a_folder_of_jobs_that_vanished_is_named(tmp_path: Path) -> None:
    """The sentence had no file in it, and the service took nothing more until somebody guessed which one."""
    with service(tmp_path) as running:
        folder = running.output / f"jobs-{running.port}"
        shutil.rmtree(running.output)
        with pytest.raises(RefusedRequestError, match=str(folder)) as caught:
            running.ask(SubmitRun())
        assert caught.value.exit_code == 74
        folder.mkdir(parents=True)
        assert isinstance(running.ask(SubmitRun()), Submitted)


def test_where_an_arm_may_move_nothing_is_queued_or_released_without_confirmation(tmp_path: Path) -> None:
    trajectory = short_trajectory(tmp_path / "short.json")
    with service(tmp_path, bind_host="0.0.0.0", robot_host="127.0.0.1") as running:
        for request in (SubmitRun(trajectory=trajectory.read_bytes()), ResumeQueue()):
            with pytest.raises(RefusedRequestError) as caught:
                running.ask(request)
            assert caught.value.code == "not_confirmed"
        asked = iiwa_ident("submit", trajectory, "--port", running.port)
        assert asked.returncode == 2
        assert "--confirm" in asked.stderr
        assert running.jobs() == {}
        job = submit(running, trajectory, confirmed=True)
        assert running.phase(job) != "cancelled"


def test_with_keys_the_service_obeys_those_who_have_one_and_nobody_else(tmp_path: Path) -> None:
    keys = tmp_path / "keys"
    assert iiwa_ident("keys", "--out", keys, "--client", "office").returncode == 0
    endpoint = f"tcp://127.0.0.1:{free_tcp_port()}"
    control = {
        "endpoint": endpoint,
        "server_key": str(keys / "server.key_secret"),
        "authorised_clients": str(keys / "authorised"),
    }
    running = ServiceProcess(tmp_path, control=control)
    mine = ("--endpoint", endpoint, "--key", keys / "office.key_secret", "--server-key", keys / "server.key")
    try:
        running.launch()
        wait_for(lambda: iiwa_ident("ping", *mine).returncode == 0)
        assert iiwa_ident("stop", *mine).returncode == 0
        with pytest.raises(ServiceUnreachableError):
            ask(endpoint, StopMotion(), timeout_s=1.0)
    finally:
        running.kill()


def test_an_address_for_everybody_is_refused_without_keys(tmp_path: Path) -> None:
    running = ServiceProcess(tmp_path, control={"endpoint": "tcp://0.0.0.0:30201"})
    refused = iiwa_ident("daemon", "--config", running.config)
    assert refused.returncode == 78
    assert "control.endpoint" in refused.stderr


def test_stop_without_a_motion_says_so_and_may_be_repeated(idle: ServiceProcess) -> None:
    for _ in range(3):
        reply = idle.ask(StopMotion())
        assert isinstance(reply, Stopped)
        assert not reply.was_moving


def test_a_job_that_is_not_there_is_said_to_be_missing(idle: ServiceProcess) -> None:
    with pytest.raises(RefusedRequestError) as caught:
        idle.ask(CancelJob(job_id="20000101T000000000Z"))
    assert (caught.value.code, caught.value.exit_code) == ("no_such_job", 66)


def test_nobody_there_is_exit_code_69() -> None:
    answer = iiwa_ident("ping", "--endpoint", f"ipc:///nowhere/{os.getpid()}")
    assert answer.returncode == 69


VALID = [msgspec.json.encode(Ping()), msgspec.json.encode(StopMotion()), msgspec.json.encode(ResumeQueue())]


@given(
    st.lists(
        st.binary(max_size=300)
        | st.sampled_from(VALID)
        | st.tuples(st.sampled_from(VALID), st.integers(0, 40), st.binary(min_size=1, max_size=3)).map(
            lambda parts: parts[0][: parts[1]] + parts[2] + parts[0][parts[1] + 1 :]
        )
        | st.integers(1, 5).map(lambda power: b'{"type":"ping","api":1,"x":' + b"[" * 10**power),
        min_size=1,
        max_size=10,
    )
)
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_whatever_bytes_come_each_is_answered_in_type_and_the_service_lives(
    idle: ServiceProcess, messages: list[bytes]
) -> None:
    with zmq.Context() as context, context.socket(zmq.DEALER) as peer:
        peer.linger = 0
        peer.connect(idle.endpoint)
        for data in messages:
            peer.send_multipart([b"", data])
        for _ in messages:
            assert peer.poll(300_000)
            decode_reply(peer.recv_multipart()[-1])
    assert isinstance(idle.ask(Ping()), Pong)
    assert idle.process.poll() is None
