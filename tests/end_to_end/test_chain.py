"""The whole chain with real processes over loopback: robot, loop, recorder, supervisor, detached worker.

What the log holds is read back with readers that share no code with the writer.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mcap_ros2.decoder
import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from tests.daemon.service_runs import assert_nothing_missing
from tests.end_to_end.processes import fake_robot, iiwa_ident, start_iiwa_ident
from tests.ports import free_udp_port
from tests.short_motion import short_trajectory
from tests.watchdog import WATCHDOG_S

SAMPLES = 1000


@pytest.fixture(scope="module")
def motion(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of one second, and lively enough for a fit."""
    return short_trajectory(tmp_path_factory.mktemp("trajectory") / "short.json", period_s=1e-3 * SAMPLES, scale=0.1)


def messages(log: Path, topic: str) -> Iterator[Any]:
    """Decoded messages of one topic, by the ROS 2 decoder of the MCAP project."""
    with log.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[mcap_ros2.decoder.DecoderFactory()])
        for _, _, _, message in reader.iter_decoded_messages(topics=[topic]):
            yield message


def wait_until(condition: Any) -> None:
    """Poll until the condition holds; fails the test when it never does."""
    for _ in range(int(WATCHDOG_S / 0.05)):
        if condition():
            return
        time.sleep(0.05)
    pytest.fail("what was waited for did not happen")


@pytest.mark.parametrize("version", ["1.15", "2.5", "2.7"])
def test_every_message_of_a_run_is_answered_and_in_the_log(version: str, tmp_path: Path, motion: Path) -> None:
    port = free_udp_port()
    with fake_robot(port, tmp_path / "robot.json", "--fri-version", version, "--lockstep", "--seed", 3):
        result = iiwa_ident(
            "run", motion, "--periods", 2, "--bind", f"127.0.0.1:{port}", "--fri-version", version,
            "--out", tmp_path / "run", "--no-fit", "--json", "-",
        )  # fmt: skip
    assert result.returncode == 0, result.stderr
    outcome = json.loads(result.stdout)
    loop = outcome["loop"]
    assert (loop["outcome"], loop["periods_completed"]) == ("completed", 2)
    assert (loop["missing"], loop["refused"], loop["undecodable"], loop["lost_in_handover"]) == (0, 0, 0, 0)
    assert loop["received"] == loop["answered"] == sum(loop["turn_around"]["counts"])
    assert loop["standstill_confirmed"]

    log = tmp_path / "run" / "recording.mcap"
    states = list(messages(log, "/fri/state"))
    assert len(states) == outcome["samples"] == loop["received"]
    counters = np.array([state.sequence_counter for state in states])
    assert np.all(np.diff(counters) == 1)
    labels = np.array([(state.period, state.sample_in_period) for state in states])
    for period in (0, 1):
        assert np.array_equal(labels[labels[:, 0] == period, 1], np.arange(SAMPLES))

    with AnyReader([log]) as reader:
        connections = [c for c in reader.connections if c.topic == "/joint_states"]
        decoded = [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages(connections=connections)]
    assert len(decoded) == len(states)
    for joint_state, state in zip(decoded[:50], states[:50], strict=True):
        assert {len(joint_state.name), len(joint_state.position), len(joint_state.velocity)} == {7}
        assert list(joint_state.position) == list(state.measured_joint_position)
        assert list(joint_state.effort) == [-torque for torque in state.measured_torque]

    robot = json.loads((tmp_path / "robot.json").read_text())
    assert robot["rejections"] == []
    assert (robot["counts"]["commands_rejected"], robot["counts"]["answered"]) == (0, loop["answered"])
    # The jerk of so short a motion is its own.
    percent = robot["judgement"]["percent"]
    assert max(percent["position"], percent["velocity"], percent["acceleration"]) <= 100.0
    assert robot["counts"]["commands_accepted"] > 2 * SAMPLES


def test_the_detached_fit_outlives_its_supervisor(tmp_path: Path, motion: Path) -> None:
    port = free_udp_port()
    folder = tmp_path / "run"
    with fake_robot(port, tmp_path / "robot.json", "--lockstep", "--seed", 4):
        process = start_iiwa_ident("run", motion, "--periods", 3, "--bind", f"127.0.0.1:{port}", "--out", folder)
        status_file = folder / "worker_status.json"
        # The first status is the supervisor's, before the worker is a process of its own: that one has a pid.
        wait_until(lambda: status_file.exists() and json.loads(status_file.read_text())["pid"] > 0)
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    wait_until(lambda: json.loads(status_file.read_text())["phase"] in ("done", "failed"))
    assert json.loads(status_file.read_text())["phase"] == "done", status_file.read_text()
    model = json.loads((folder / "model.json").read_text())
    assert len(model["base_parameters"]) == 57


INTERRUPTED_WITH_THE_FIT = """
import os, sys
from daemon.cli import main
from daemon.cli.run_view import RunView
from daemon.cli import worker_view
number, moment, observe, wait = int(sys.argv[1]), sys.argv[2], RunView.observe, worker_view.wait_for_worker
def interrupt(view, event):
    observe(view, event)
    if event.kind == moment:
        os.kill(os.getpid(), number)
def interrupted_wait(folder, pid):
    if moment == "wait":
        os.kill(os.getpid(), number)
    return wait(folder, pid)
RunView.observe, worker_view.wait_for_worker = interrupt, interrupted_wait
main(sys.argv[3:])
"""


@pytest.mark.parametrize(
    ("number", "moment"),
    [(signal.SIGINT, "worker"), (signal.SIGTERM, "worker"), (signal.SIGHUP, "worker"), (signal.SIGTERM, "wait")],
)
def test_an_interrupt_as_the_fit_begins_or_goes_on_ends_the_command_and_neither_run_nor_fit(
    number: signal.Signals, moment: str, tmp_path: Path, motion: Path
) -> None:
    port, folder = free_udp_port(), tmp_path / "run"
    words = ["run", motion, "--periods", 2, "--bind", f"127.0.0.1:{port}", "--out", folder]
    with fake_robot(port, tmp_path / "robot.json", "--lockstep", "--seed", 4):
        done = subprocess.run(
            [sys.executable, "-c", INTERRUPTED_WITH_THE_FIT, str(int(number)), moment, *map(str, words)],
            capture_output=True, text=True, timeout=WATCHDOG_S, check=False,
        )  # fmt: skip
    assert done.returncode == 130, done.stderr
    assert "Interrupted after the motion." in done.stderr
    assert "The fit goes on by itself" in done.stderr
    outcome = json.loads((folder / "run.json").read_text())
    assert (outcome["outcome"], outcome["exit_code"]) == ("completed", 0)
    status_file = folder / "worker_status.json"
    wait_until(lambda: json.loads(status_file.read_text())["phase"] in ("done", "failed"))
    assert json.loads(status_file.read_text())["phase"] == "done"


def test_an_interrupt_brings_the_arm_to_rest_and_keeps_the_recording(tmp_path: Path, motion: Path) -> None:
    port = free_udp_port()
    folder = tmp_path / "run"
    with fake_robot(port, tmp_path / "robot.json", "--lockstep", "--seed", 5):
        process = start_iiwa_ident("run", motion, "--periods", 50, "--bind", f"127.0.0.1:{port}", "--out", folder)
        lines: list[str] = []
        assert process.stdout is not None
        for line in process.stdout:
            lines.append(line)
            if "excitation" in line:
                process.send_signal(signal.SIGINT)
                break
        lines += process.stdout.read().splitlines()
        assert process.wait(WATCHDOG_S) == 130, lines
    outcome = json.loads((folder / "run.json").read_text())
    assert (outcome["outcome"], outcome["loop"]["reason"]) == ("stopped", "OPERATOR_STOP")
    assert outcome["loop"]["standstill_confirmed"]
    assert_nothing_missing(folder / "recording.mcap")
    states = list(messages(folder / "recording.mcap", "/fri/state"))
    assert len(states) == outcome["samples"] == outcome["loop"]["received"]
    still = np.array([state.measured_joint_position for state in states[-100:]])
    assert np.ptp(still, axis=0).max() < 5e-4
    assert json.loads((tmp_path / "robot.json").read_text())["rejections"] == []
