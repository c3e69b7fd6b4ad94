"""Claims about what systemd hears; truth: a real datagram socket in its place, and the protocol of sd_notify(3)."""

from __future__ import annotations

import configparser
import os
import re
import shutil
import signal
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from daemon.errors import EXIT_INTERRUPTED
from daemon.queue.systemd_notify import SystemdNotifier

UNIT = Path(__file__).resolve().parents[2] / "packaging" / "iiwa-ident.service"


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[tuple[socket.socket, str]]:
    path = str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as channel:
        channel.bind(path)
        channel.settimeout(600.0)
        yield channel, path


def test_ready_status_and_end_are_one_datagram_each(manager: tuple[socket.socket, str]) -> None:
    channel, path = manager
    notifier = SystemdNotifier({"NOTIFY_SOCKET": path})
    notifier.ready("serving\nnow")
    notifier.status("running")
    notifier.status("running")
    notifier.stopping()
    assert [channel.recv(200) for _ in range(3)] == [b"READY=1\nSTATUS=serving now", b"STATUS=running", b"STOPPING=1"]
    notifier.close()


def test_the_watchdog_is_fed_at_half_its_time_and_not_at_every_turn(manager: tuple[socket.socket, str]) -> None:
    channel, path = manager
    notifier = SystemdNotifier({"NOTIFY_SOCKET": path, "WATCHDOG_USEC": "30000000", "WATCHDOG_PID": str(os.getpid())})
    assert notifier.watchdog_interval_s == 15.0
    for _ in range(50):
        notifier.beat()
    assert channel.recv(200) == b"WATCHDOG=1"
    channel.setblocking(False)
    with pytest.raises(BlockingIOError):
        channel.recv(200)
    notifier.close()


def test_a_watchdog_meant_for_another_process_is_not_ours() -> None:
    assert SystemdNotifier({"WATCHDOG_USEC": "1000000", "WATCHDOG_PID": "1"}).watchdog_interval_s is None


def test_an_abstract_address_is_understood() -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as channel:
        name = f"iiwa-ident-test-{os.getpid()}"
        channel.bind(f"\0{name}")
        channel.settimeout(600.0)
        notifier = SystemdNotifier({"NOTIFY_SOCKET": f"@{name}"})
        notifier.stopping()
        assert channel.recv(200) == b"STOPPING=1"
        notifier.close()


def test_children_do_not_inherit_the_address(manager: tuple[socket.socket, str]) -> None:
    environment = {"NOTIFY_SOCKET": manager[1], "WATCHDOG_USEC": "1000", "HOME": "/"}
    SystemdNotifier(environment).close()
    assert environment == {"HOME": "/"}


@pytest.mark.parametrize("path", ["", "/no/such/socket"])
def test_a_manager_that_is_not_there_costs_nothing(path: str) -> None:
    notifier = SystemdNotifier({"NOTIFY_SOCKET": path})
    notifier.ready("serving")
    notifier.beat()
    notifier.close()


def unit() -> dict[str, str]:
    parser = configparser.ConfigParser(strict=False, interpolation=None)
    parser.optionxform = str  # type: ignore[assignment,method-assign]
    parser.read(UNIT)
    return dict(parser["Service"])


def test_the_unit_never_ends_a_moving_arm_by_a_kill() -> None:
    service = unit()
    # What the watchdog sends goes to the loop too: it must be the signal that the loop answers with a ramp.
    assert getattr(signal, service["WatchdogSignal"]) == signal.SIGTERM
    assert service["KillMode"] == "control-group"
    assert int(service["TimeoutStopSec"]) >= 60
    assert service["SuccessExitStatus"] == str(EXIT_INTERRUPTED)
    assert service["Type"] == "notify"
    assert "CPUSchedulingPolicy" not in service
    assert int(service["LimitRTPRIO"]) >= 80
    assert service["LimitMEMLOCK"] == "infinity"


def test_systemd_itself_finds_no_fault_in_the_unit(tmp_path: Path) -> None:
    tool = shutil.which("systemd-analyze")
    if tool is None:
        pytest.skip("systemd-analyze is not installed")
    text = re.sub(r"^ExecStart=\S+", "ExecStart=/bin/true", UNIT.read_text(), flags=re.MULTILINE)
    (tmp_path / "iiwa-ident.service").write_text(text)
    result = subprocess.run(
        [tool, "verify", "--man=no", str(tmp_path / "iiwa-ident.service")], capture_output=True, text=True, check=False
    )
    assert "iiwa-ident.service" not in result.stderr, result.stderr


def test_what_a_full_disk_sends_to_the_temporary_folder_outlives_the_service() -> None:
    """A private /tmp is deleted when the unit stops; without one, a strictly protected system leaves /tmp open."""
    service = unit()
    assert (service["ProtectSystem"], service["PrivateTmp"]) == ("strict", "no")
    assert "/tmp" in service["ReadWritePaths"].split()


def test_the_record_of_the_ladder_stands_where_the_unit_may_write() -> None:
    """Else an amplitude that was completed counts as not done, for ever."""
    service = unit()
    lines = UNIT.read_text().splitlines()
    assert service["ProtectHome"] == "read-only"
    assert f"Environment=XDG_STATE_HOME=/var/lib/{service['StateDirectory']}/state" in lines
