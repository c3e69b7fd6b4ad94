"""Claims about the doctor: what it says of a socket, of the vendor's golden datagrams, and of links made to measure.

Truth: the versions and counters that the golden datagrams were recorded with; loss and jitter put in by this test.
"""

from __future__ import annotations

import json
import math
import os
import socket
import threading
from pathlib import Path
from typing import Any

import pytest

from daemon.doctor.doctor import DoctorReport, check_address, check_interfaces, examine, port_holder
from daemon.doctor.host_checks import DoctorCheck
from daemon.doctor.link_checks import check_link
from daemon.doctor.link_observation import LinkObservation
from daemon.runtime_folder import lock_port
from fri_client.messages import FriVersion
from fri_client.wire.version_guess import guess_version
from tests.daemon.command_line import run
from tests.ports import free_udp_port
from tests.reference import golden_datagrams

from .producer import Producer

SENDER = ("192.170.10.2", 30200)


def link(counters: list[int], times: list[float], version: FriVersion = FriVersion.V1_15) -> LinkObservation:
    producer = Producer(None, version)  # type: ignore[arg-type]
    return LinkObservation(
        tuple((at, SENDER, producer.monitoring(counter, 0.1)) for counter, at in zip(counters, times, strict=True)),
        times[-1] + 0.001,
    )


def verdict(observation: LinkObservation, name: str) -> DoctorCheck:
    return next(check for check in check_link(observation, "127.0.0.1", 1) if check.name == name)


def test_every_golden_datagram_is_guessed_as_its_version_where_its_fields_tell_and_left_open_where_not() -> None:
    versions = golden_datagrams()
    telling = {
        "1.15": {"commandedJointPosition"},
        "2.5": {"measuredCartesianPose", "measuredRedundancyInformation"},
    }
    for version, groups in versions.items():
        for vector in groups["monitoring"]:
            candidates = guess_version(bytes.fromhex(vector["hex"])).candidates
            fields = vector["fields"].get("monitorData", {}).keys()
            if version == "2.7" or fields & telling[version]:
                assert candidates == (version,), (version, vector["name"])
            else:
                assert version in candidates, (version, vector["name"])


def test_garbage_is_no_version() -> None:
    for data in (b"", b"hello", bytes(300), b"\xff" * 40):
        assert guess_version(data).candidates == ()


def test_a_perfect_link_has_grade_a() -> None:
    check = verdict(link(list(range(500)), [0.001 * tick for tick in range(500)]), "link")
    assert (check.status, check.sentence.split(":")[0]) == ("ok", "Grade A")


def test_loss_is_counted_across_the_wrap_of_the_counter_and_lowers_the_grade() -> None:
    ticks = [tick for tick in range(1000) if tick % 50 != 7]
    counters = [(2**32 - 300 + tick) % 2**32 for tick in ticks]
    check = verdict(link(counters, [0.001 * tick for tick in ticks]), "link")
    assert check.status == "failed"
    assert "20 lost" in check.sentence
    assert "Grade D" in check.sentence


def test_jitter_lowers_the_grade_without_loss() -> None:
    times = [0.001 * tick + (0.0009 if tick % 2 else 0.0) for tick in range(500)]
    check = verdict(link(list(range(500)), times), "link")
    assert check.status == "warning"
    assert "Grade C" in check.sentence
    assert "none lost" in check.sentence


@pytest.mark.parametrize(
    ("lost", "late_s", "grade"),
    [
        (0, 0.0002, "A"),
        (1, 0.0002, "B"),
        (0, 0.0004, "B"),
        (5, 0.0004, "C"),
        (0, 0.0008, "C"),
        (30, 0.0, "D"),
        (0, 0.003, "D"),
    ],
)
def test_grades_follow_their_rules(lost: int, late_s: float, grade: str) -> None:
    """Of 2000 messages every eleventh comes late by so much, and so many are missing."""
    ticks = [tick for tick in range(2000) if not (tick % 60 == 7 and tick // 60 < lost)]
    times = [0.001 * tick + (late_s if tick % 11 == 0 else 0.0) for tick in ticks]
    assert f"Grade {grade}" in verdict(link(ticks, times), "link").sentence


def test_a_link_that_fell_silent_has_grade_d_however_regular_it_was() -> None:
    steady = link(list(range(200)), [0.001 * tick for tick in range(200)])
    assert "Grade D" in verdict(LinkObservation(steady.datagrams, 2.0), "link").sentence


def test_two_senders_and_a_sender_that_stopped_are_told() -> None:
    steady = link(list(range(20)), [0.001 * tick for tick in range(20)])
    two = LinkObservation((*steady.datagrams, (0.02, ("10.0.0.9", 1), steady.datagrams[0][2])), 0.021)
    assert verdict(two, "robot").status == "warning"
    stopped = LinkObservation(steady.datagrams, 3.0)
    assert "2.98 s ago" in verdict(stopped, "robot").sentence
    assert verdict(stopped, "robot").status == "warning"


@pytest.mark.parametrize("other", [("192.170.10.2", 30201), ("10.0.0.9", 30200)])
def test_a_second_robot_and_another_program_are_named_and_take_nothing_from_the_grade(other: tuple[str, int]) -> None:
    """Whichever of them was heard last; a run too takes one address and port for the robot."""
    steady = link(list(range(200)), [0.001 * tick for tick in range(200)])
    second = link(list(range(70_000, 70_100)), [0.001 * tick + 0.0005 for tick in range(200) if tick % 2])
    strays = [(0.001 * tick + 0.0007, other, b"hello") for tick in range(200)]
    for disturbing in ([(at, other, datagram) for at, _, datagram in second.datagrams], strays):
        both = LinkObservation(tuple(sorted((*steady.datagrams, *disturbing))), 0.2)
        found = verdict(both, "robot")
        assert found.status == "warning"
        assert found.sentence.startswith("200 messages in 0.2 s from 192.170.10.2, the last 0.00 s ago.")
        assert f"others send here too: {other[0]}:{other[1]}." in found.sentence
        assert verdict(both, "link").sentence.startswith("Grade A: 200 messages, none lost")


@pytest.mark.parametrize(("value", "words"), [(math.nan, "is nan, which is impossible"), (50.0, "is 50, which is")])
def test_messages_that_a_run_would_refuse_are_told_and_say_nothing_of_a_load(value: float, words: str) -> None:
    """NaN is no position, and 50 rad are eight turns of a joint; whoever asks the doctor why no run begins hears it."""
    producer = Producer(None)  # type: ignore[arg-type]
    bad = tuple((0.001 * k, SENDER, producer.monitoring(k, value)) for k in range(40))
    found = {check.name: check for check in check_link(LinkObservation(bad, 0.041), "127.0.0.1", 1)}
    assert found["messages"].status == "failed"
    told = found["messages"].sentence
    assert told.startswith("40 of the newest 40 messages cannot be used, the last one because")
    assert f"the measured joint position of joint 1 {words}" in told
    assert "load data" not in found
    good = link(list(range(40)), [0.001 * k for k in range(40)])
    assert "messages" not in {check.name for check in check_link(good, "127.0.0.1", 1)}


def test_other_programs_datagrams_are_not_taken_for_a_robot() -> None:
    noise = LinkObservation(((0.0, SENDER, b"SSDP"),), 1.0)
    (check,) = check_link(noise, "127.0.0.1", 30200)
    assert check.status == "failed"
    assert SENDER[0] in check.sentence


def test_a_port_in_use_is_named_with_its_holder() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        report = examine(bind_port=port, listen_s=0.0)
        holder = port_holder(port)
    check = next(check for check in report.checks if check.name == "port")
    assert check.status == "failed"
    assert not report.passed
    assert str(port) in check.sentence
    assert holder is None or holder in check.sentence


def test_a_port_that_a_waiting_service_keeps_is_not_free(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Between two jobs it has no socket: the port was called free, and the next run refused."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    port = free_udp_port()
    for held, status in ((True, "warning"), (False, "ok")):
        with lock_port("127.0.0.1", port if held else 0):
            report = examine(bind_port=port, listen_s=0.0)
        check = next(check for check in report.checks if check.name == "port")
        assert check.status == status
        assert (f"(process {os.getpid()})" in check.sentence) == held


def test_a_port_of_a_run_names_who_can_be_stopped_and_not_its_loop(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The socket is the loop's: killed as the doctor said, it left a moving arm without answers."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        with lock_port("127.0.0.1", port):
            report = examine(bind_port=port, listen_s=0.0)
    check = next(check for check in report.checks if check.name == "port")
    assert check.status == "failed"
    assert f"another iiwa-ident (process {os.getpid()})" in check.sentence
    assert f"`iiwa-ident stop --port {port}`" in check.remedy


def test_an_address_of_another_machine_is_refused() -> None:
    report = examine(bind_host="203.0.113.7", bind_port=0, listen_s=0.0)
    assert {check.name for check in report.checks if check.status == "failed"} >= {"address", "port"}
    assert "203.0.113.7" in report.next_step


def test_silence_fails_and_says_what_to_do() -> None:
    report = examine(bind_port=0, listen_s=0.01)
    assert not report.passed
    assert "iiwa-ident fake-robot" in report.next_step
    assert "--bind" in report.next_step
    assert json.dumps(report.to_json())


def examined_until(wanted: str, **options: Any) -> dict[str, DoctorCheck]:
    """The checks by name once there is the wanted one: nobody knows when a busy machine lets the other side send."""
    for _ in range(200):
        found = {check.name: check for check in examine(**options).checks}
        if wanted in found:
            return found
    raise AssertionError(f"no check '{wanted}' in {list(found)}")


def test_a_talking_robot_is_heard_with_version_and_state() -> None:
    port, done = free_udp_port(), threading.Event()

    def talk() -> None:
        producer = Producer(None, FriVersion.V2_7)  # type: ignore[arg-type]
        counter = 0
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as robot:
            while not done.wait(0.005):
                robot.sendto(producer.monitoring(counter, 0.1), ("127.0.0.1", port))
                counter += 1

    thread = threading.Thread(target=talk)
    thread.start()
    try:
        found = examined_until("FRI version", bind_port=port, listen_s=0.5)
    finally:
        done.set()
        thread.join()
    assert "FRI 2.7" in found["FRI version"].sentence
    assert "COMMANDING_ACTIVE" in found["session"].sentence
    assert "127.0.0.1" in found["robot"].sentence


@pytest.mark.parametrize(
    ("statuses", "passed", "step"),
    [
        (("ok", "ok"), True, "iiwa-ident check"),
        (("warning", "ok"), True, "mend a"),
        (("warning", "failed"), False, "mend b"),
    ],
)
def test_the_next_step_mends_failures_before_warnings(statuses: tuple[str, str], passed: bool, step: str) -> None:
    checks = tuple(
        DoctorCheck(name, status, "…", f"mend {name}")  # type: ignore[arg-type]
        for name, status in zip("ab", statuses, strict=True)
    )
    report = DoctorReport(checks)
    assert report.passed is passed
    assert step in report.next_step


def test_silence_on_a_real_address_sends_the_operator_to_the_robot() -> None:
    (check,) = check_link(LinkObservation((), 3.0), "192.170.10.1", 30200)
    assert check.status == "failed"
    assert "start the FRI application" in check.remedy
    assert "192.170.10.1" in check.remedy


def test_the_machines_own_addresses_are_listed() -> None:
    assert "127.0.0.1" in check_interfaces().sentence


def test_every_interface_at_once_is_no_good_choice() -> None:
    assert check_address("0.0.0.0").status == "warning"


def test_a_robot_that_sends_to_another_address_of_this_machine_is_found() -> None:
    """127.0.0.2 is this machine as well; listening on 127.0.0.1 hears nothing of what is sent there."""
    port, done = free_udp_port(), threading.Event()

    def talk() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as robot:
            while not done.wait(0.02):
                robot.sendto(b"anything", ("127.0.0.2", port))

    thread = threading.Thread(target=talk)
    thread.start()
    try:
        found = examined_until("other address", bind_port=port, listen_s=0.3)
    finally:
        done.set()
        thread.join()
    assert found["robot"].status == "failed"
    assert "another address" in found["other address"].sentence


def test_address_and_folder_come_from_a_configuration_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = tmp_path / "robot.yaml"
    config.write_text(f"fri: {{bind_host: 127.0.0.3, bind_port: 0, version: '2.5'}}\noutput: {tmp_path}/data/runs\n")
    assert run("doctor", "--config", config, "--listen", "0.1", "--json", "-") == 1
    found = {check["name"]: check for check in json.loads(capsys.readouterr().out)["checks"]}
    assert "127.0.0.3" in found["port"]["sentence"]
    assert f"in {tmp_path}:" in found["disk"]["sentence"]
