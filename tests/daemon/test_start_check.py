"""Claims about the gate before the first command: who opens it, what stays shut, and what the arm is told.

Truth: the robot process's own account of the commands it got, and distances at poses chosen so that they are known.
"""

from __future__ import annotations

import json
import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from daemon.api import RunRequest
from daemon.errors import ConfigurationError, LadderError
from daemon.run.commissioning import admit
from daemon.run.service import run_acquisition
from daemon.run.start_check import StartCheck
from fri_client.handover.ring import HandoverRing
from fri_client.handover.start_gate import SAME_POSITION_RAD, StartRefused
from fri_client.messages import FriVersion, MonitoringMessage, RobotInfo
from fri_client.wire.codec import Codec
from safety.collision import Plane, Workspace, workspace_clearances
from safety.geometry import load_geometry
from safety.limits import limits_for
from safety.ramps import plan_stop_ramp
from tests.ports import free_udp_port

from .producer import Producer, make_request
from .service_process import fake_robot

REST = (0.0, 0.3, 0.0, -1.2, 0.0, 0.8, 0.0)


def gentle_table(folder: Path) -> None:
    angle = 2 * np.pi * np.arange(2000) / 2000
    np.save(folder / "table.npy", np.array(REST) + 0.05 * (1 - np.cos(angle))[:, None])


@pytest.fixture
def ring() -> HandoverRing:
    return HandoverRing.create(8)


def test_without_a_supervisor_every_start_passes(ring: HandoverRing) -> None:
    assert ring.gate.passes(REST, 0.001, 1)
    assert ring.gate.question is None


def test_a_closed_gate_opens_by_an_answer_to_this_very_position(ring: HandoverRing) -> None:
    loop, supervisor = HandoverRing.attach(ring.fd).gate, ring.gate
    supervisor.close()
    assert not loop.passes(REST, 0.002, 2)
    question = supervisor.question
    assert question is not None
    assert question.position == REST
    assert (question.command_period_s, question.samples_per_command) == (0.002, 2)
    assert not loop.passes(REST, 0.002, 2)
    supervisor.answer(question.number)
    assert supervisor.question is None
    assert loop.passes(REST, 0.002, 2)
    assert loop.passes(tuple(q + 0.9 * SAME_POSITION_RAD for q in REST), 0.002, 2)


def test_a_moved_arm_is_asked_about_anew_and_an_answer_to_the_old_question_opens_nothing(ring: HandoverRing) -> None:
    gate = ring.gate
    gate.close()
    gate.passes(REST, 0.001, 1)
    first = gate.question
    assert first is not None
    moved = (0.1, *REST[1:])
    assert not gate.passes(moved, 0.001, 1)
    gate.answer(first.number)
    assert not gate.passes(moved, 0.001, 1)
    second = gate.question
    assert second is not None
    assert second.position == moved
    gate.answer(second.number)
    assert gate.passes(moved, 0.001, 1)
    assert not gate.passes(moved, 0.002, 1)  # another send period is another ramp


def test_no_is_raised_with_its_reason(ring: HandoverRing) -> None:
    gate = ring.gate
    gate.close()
    gate.passes(REST, 0.001, 1)
    assert gate.question is not None
    gate.answer(gate.question.number, "Link 7 would touch the müll bin.")
    with pytest.raises(StartRefused, match="müll bin") as caught:
        gate.passes(REST, 0.001, 1)
    assert caught.value.exit_code == 1


def test_the_supervisor_clears_a_start_beside_the_motion(ring: HandoverRing, tmp_path: Path) -> None:
    request = make_request(tmp_path, lead_in_s=0.2)
    gentle_table(tmp_path)
    check = StartCheck(request, ring.gate)
    assert check.poll() == ""
    assert not ring.gate.passes(REST, 0.001, 1)
    assert "20 mm are required" in check.poll()
    assert ring.gate.passes(REST, 0.001, 1)


@pytest.mark.parametrize(("is_first", "mode", "refused"), [(True, 2, True), (False, 0, True), (False, 2, False)])
def test_a_way_to_the_motion_that_is_too_fast_for_t1_is_not_begun_in_t1(
    ring: HandoverRing, tmp_path: Path, is_first: bool, mode: int, refused: bool
) -> None:
    """From behind the base all large joints turn at once. A first run is one in T1; else the robot says its mode."""
    behind = (2.0, -1.5, 0.1, -0.1, -2.1, 0.5, 1.7)
    request = make_request(tmp_path, lead_in_s=0.2, test_mode_only=is_first)
    gentle_table(tmp_path)
    producer = Producer(ring)
    message = producer.codec.decode_monitoring(producer.monitoring(1, 0.1))
    told = MonitoringMessage(
        message.header, RobotInfo(7, 0, (2,) * 7, mode, 0), message.monitor_data, message.connection_info
    )
    ring.push(1, 0, 0, -1, -1, producer.codec.encode_monitoring(told), None)
    check = StartCheck(request, ring.gate)
    assert not ring.gate.passes(behind, 0.001, 1)
    assert ("T1, in which this run is driven, allows 0.25 m/s" in check.poll(ring)) == refused
    if refused:
        with pytest.raises(StartRefused, match="jog the arm nearer"):
            ring.gate.passes(behind, 0.001, 1)
    else:
        assert ring.gate.passes(behind, 0.001, 1)


def test_a_box_between_the_arm_and_the_motion_keeps_the_gate_shut(ring: HandoverRing, tmp_path: Path) -> None:
    """Turned by 100° about A1 the arm stands left of a post that the motion itself, in front, never comes near to."""
    request = make_request(tmp_path, lead_in_s=0.2, workspace_file=str(tmp_path / "cell.yaml"))
    gentle_table(tmp_path)
    (tmp_path / "cell.yaml").write_text(
        "boxes:\n- {name: post, center_m: [0.45, 0.55, 0.5], size_m: [0.1, 0.1, 2.0]}\n"
    )
    check = StartCheck(request, ring.gate)
    here = (1.75, *REST[1:])
    assert not ring.gate.passes(here, 0.001, 1)
    sentence = check.poll()
    assert "post" in sentence
    assert "Nothing was moved" in sentence
    with pytest.raises(StartRefused, match="post"):
        ring.gate.passes(here, 0.001, 1)


def test_a_stop_that_leaves_the_start_ramp_towards_a_wall_keeps_the_gate_shut(
    ring: HandoverRing, tmp_path: Path
) -> None:
    """The motion turns back where the ramp hands over at speed; each joint stopped there on its own swings on.

    How far the tool's end goes in y, along the ramp and in its stops, is worked out here; the wall stands between.
    """
    angle = 2 * np.pi * np.arange(2000) / 2000
    table = np.array(REST) + np.array([0.25, 0, 0, 0, 0, 0, 0]) * np.sin(angle)[:, None]
    request = make_request(tmp_path, lead_in_s=1.99)
    np.save(tmp_path / "table.npy", table)
    geometry, limits = load_geometry("iiwa14"), limits_for("iiwa14")
    here = (-0.6, *REST[1:])
    check = StartCheck(request, ring.gate)
    ring.gate.passes(here, 0.001, 1)
    assert ring.gate.question is not None
    path = check._ramp(ring.gate.question)
    velocity = np.gradient(path, 0.001, axis=0)
    rest = [
        plan_stop_ramp(path[row], velocity[row], np.zeros(7), limits).position_at(10.0)
        for row in range(len(path) // 2, len(path), 20)
    ]
    reached, swung = (float(geometry.tip_path(np.array(each))[:, 1].max()) for each in (path, rest))
    assert swung - reached > 0.004
    tip = np.array([path[np.argmax(geometry.tip_path(path)[:, 1])]])
    wall = Workspace(walls=(Plane("wall", (0.0, -1.0, 0.0), -5.0),))
    beside = min(each.distance_m for each in workspace_clearances(tip, geometry, wall) if "wall" in each.pair)
    housing = 5.0 - reached - beside  # how far the arm reaches beyond the tool's end
    for share, clear in ((0.3, False), (1.5, True)):
        place = reached + housing + 0.02 + share * (swung - reached)
        (tmp_path / "cell.yaml").write_text(f"walls:\n- {{name: fence, normal: [0, -1, 0], offset_m: {-place}}}\n")
        gate = HandoverRing.create(8).gate
        request = make_request(tmp_path, lead_in_s=1.99, workspace_file=str(tmp_path / "cell.yaml"))
        np.save(tmp_path / "table.npy", table)
        walled = StartCheck(request, gate)
        gate.passes(here, 0.001, 1)
        sentence = walled.poll()
        assert ("In a stop on the start ramp" in sentence and "fence" in sentence) is not clear, (share, sentence)
        assert ("Nothing was moved" in sentence) is not clear


def test_an_arm_beyond_its_limits_is_refused_with_the_joint(ring: HandoverRing, tmp_path: Path) -> None:
    request = make_request(tmp_path, lead_in_s=0.2)
    gentle_table(tmp_path)
    check = StartCheck(request, ring.gate)
    ring.gate.passes((0.0, 0.3, 0.0, -2.4, 0.0, 0.8, 0.0), 0.001, 1)
    assert "oint 4" in check.poll()
    with pytest.raises(StartRefused):
        ring.gate.passes((0.0, 0.3, 0.0, -2.4, 0.0, 0.8, 0.0), 0.001, 1)


def test_a_workspace_file_that_cannot_be_used_ends_the_run_before_it_begins(ring: HandoverRing, tmp_path: Path) -> None:
    (tmp_path / "cell.yaml").write_text("flor_height_m: 1\n")
    with pytest.raises(ConfigurationError, match="flor_height_m"):
        StartCheck(make_request(tmp_path, workspace_file=str(tmp_path / "cell.yaml")), ring.gate)


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[tuple[int, Callable[[], dict[str, Any]]]]:
    """Port that a fake robot in T1 sends to, and how to end it and hear what it was commanded."""
    port, summary, mode = free_udp_port(), tmp_path / "robot.json", tmp_path / "t1.yaml"
    mode.write_text("session: {operation_mode: 0}\n")
    with fake_robot(port, "--json", summary, "--physics", mode) as process:

        def ended() -> dict[str, Any]:
            process.terminate()
            process.wait(600)
            account: dict[str, Any] = json.loads(summary.read_text())
            return account

        yield port, ended


def real_request(tmp_path: Path, port: int, **changes: Any) -> RunRequest:
    """Nobody said that only the fake robot may be moved, so whoever sends counts as a real one."""
    values = {"out_dir": str(tmp_path / "run"), "bind_host": "0.0.0.0", "bind_port": port, "lead_in_s": 0.2}
    request = make_request(tmp_path, **{**values, "start_timeout_s": 60.0, "fit": False, "periods": 1, **changes})
    gentle_table(tmp_path)
    return request


def test_an_arm_that_stands_inside_a_forbidden_box_never_moves(
    robot: tuple[int, Callable[[], dict[str, Any]]], tmp_path: Path
) -> None:
    """The first message of the fake robot tells where it stands; the box is put there."""
    port, ended = robot
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ear:
        ear.bind(("127.0.0.1", port))
        ear.settimeout(600.0)
        monitor = Codec(FriVersion.V1_15).decode_monitoring(ear.recv(2048)).monitor_data
    assert monitor is not None
    tip = load_geometry("iiwa14").tip_path(np.array([monitor.measured_joint_position]))[0].round(3).tolist()
    cell = tmp_path / "cell.yaml"
    cell.write_text(f"boxes:\n- {{name: crate, center_m: {tip}, size_m: [0.1, 0.1, 0.1]}}\n")
    request = real_request(tmp_path, port, simulation=True, workspace_file=str(cell))
    outcome = run_acquisition(request, observe=[].append)
    assert (outcome.outcome, outcome.exit_code) == ("refused", 1)
    assert "crate" in outcome.sentences[0]
    assert max(ended()["peak_command"]["velocity_rad_s"]) == 0.0


def test_a_real_arm_climbs_the_ladder_and_its_log_names_the_rung(
    robot: tuple[int, Callable[[], dict[str, Any]]], tmp_path: Path
) -> None:
    port, _ = robot
    ladder = str(tmp_path / "ladder.jsonl")
    with pytest.raises(LadderError):
        run_acquisition(real_request(tmp_path, port, amplitude=0.25, ladder_file=ladder), observe=[].append)
    said: list[str] = []
    request = real_request(tmp_path, port, amplitude=0.1, ladder_file=ladder)
    outcome = run_acquisition(request, observe=lambda event: said.append(event.sentence))
    assert outcome.exit_code == 0, outcome.sentences
    assert outcome.commissioning == {"commissioning": "0.1", "commissioning_ladder": "kept"}
    assert any("0.25 may follow" in sentence for sentence in said)
    assert any("from where the arm stands" in sentence for sentence in said)
    with Path(outcome.recordings[0]).open("rb") as stream:
        metadata = {record.name: record.metadata for record in make_reader(stream).iter_metadata()}
    assert metadata["iiwa_ident"]["commissioning"] == "0.1"
    assert admit(real_request(tmp_path, port, amplitude=0.25, ladder_file=ladder))


def test_a_rung_is_completed_also_where_the_disk_refuses_the_fit_that_follows(
    robot: tuple[int, Callable[[], dict[str, Any]]], tmp_path: Path
) -> None:
    """A folder stands where the fit's job would be written."""
    ladder = str(tmp_path / "ladder.jsonl")
    request = real_request(tmp_path, robot[0], amplitude=0.1, ladder_file=ladder, fit=True)
    (Path(request.out_dir) / "worker_job.json" / "in the way").mkdir(parents=True)
    outcome = run_acquisition(request, observe=[].append)
    assert (outcome.outcome, outcome.exit_code) == ("completed", 74), outcome.sentences
    assert admit(real_request(tmp_path, robot[0], amplitude=0.25, ladder_file=ladder))
