"""Claims about listening and answering: monitoring states are mirrored, commanding states never, and nothing is
invented.

Truth: the fake robot, a process of its own that grades the connection by the answers it gets and counts commands.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from daemon.doctor.doctor import examine
from daemon.doctor.link_observation import Mirror
from fri_client.messages import ConnectionInfo, FriVersion, MonitoringMessage, SessionState
from fri_client.wire.codec import Codec
from tests.ports import free_udp_port

from .producer import Producer

REPOSITORY = Path(__file__).resolve().parents[2]


def monitoring(version: FriVersion, state: SessionState, counter: int = 0) -> bytes:
    """A message of the producer's, in another session state."""
    codec = Codec(version)
    message = codec.decode_monitoring(Producer(None, version).monitoring(counter, 0.1))  # type: ignore[arg-type]
    assert message.connection_info is not None
    told = message.connection_info
    return codec.encode_monitoring(
        MonitoringMessage(
            header=message.header,
            robot_info=message.robot_info,
            monitor_data=message.monitor_data,
            connection_info=ConnectionInfo(int(state), told.quality, told.send_period, told.receive_multiplier),
            ipo_data=message.ipo_data,
        )
    )


@pytest.mark.parametrize("version", [FriVersion.V1_15, FriVersion.V2_7])
@pytest.mark.parametrize("state", [SessionState.MONITORING_WAIT, SessionState.MONITORING_READY])
def test_monitoring_is_answered_with_what_the_robot_itself_said(version: FriVersion, state: SessionState) -> None:
    mirror = Mirror(version)
    data = monitoring(version, state, 41)
    answer = mirror.reply(data, 1)
    assert answer is not None
    command, said = Codec(version).decode_command(answer), Codec(version).decode_monitoring(data)
    assert command.header.reflected_sequence_counter == 41
    positions = None if command.command_data is None else command.command_data.joint_position
    assert said.monitor_data is not None
    assert positions == (said.monitor_data.commanded_joint_position if version.major == 1 else None)


@pytest.mark.parametrize("state", [SessionState.COMMANDING_WAIT, SessionState.COMMANDING_ACTIVE, SessionState.IDLE])
def test_a_commanding_or_idle_robot_gets_no_answer(state: SessionState) -> None:
    assert Mirror(FriVersion.V1_15).reply(monitoring(FriVersion.V1_15, state), 1) is None


def test_garbage_and_unknown_versions_get_no_answer() -> None:
    assert Mirror().reply(b"garbage", 1) is None
    assert Mirror(FriVersion.V1_15).reply(b"garbage", 1) is None


def test_the_robot_grades_an_answered_link(tmp_path: Path) -> None:
    port = free_udp_port()
    summary = tmp_path / "robot.json"
    robot = subprocess.Popen(
        [
            sys.executable, "-m", "fixtures.fake_robot", "--client", f"127.0.0.1:{port}", "--port", "0",
            "--fri-version", "1.15", "--send-period-ms", "10", "--duration", "60", "--json", str(summary),
        ],
        cwd=REPOSITORY, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        mirror = Mirror()
        for _ in range(100):  # until the robot's process has started
            report = examine(bind_port=port, listen_s=2.0, mirror=mirror, folder=tmp_path)
            if mirror.delays_s:
                break
    finally:
        robot.send_signal(signal.SIGTERM)
        robot.wait(timeout=600)
    found = {check.name: check for check in report.checks}
    assert found["FRI version"].sentence == "This is FRI 1.15."
    assert "127.0.0.1" in found["robot"].sentence
    assert "messages answered" in found["answered link"].sentence
    told = json.loads(summary.read_text())["counts"]
    assert 0 < told["answered"] + told["late"] <= len(mirror.delays_s)
    assert (told["undecodable"], told["commands_accepted"], told["commands_rejected"]) == (0, 0, 0)
