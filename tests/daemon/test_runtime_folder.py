"""Claims about the private folder and the lock per port; locks are held by real processes and really killed."""

from __future__ import annotations

import fcntl
import os
import signal
import stat
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from daemon.cli.app import main
from daemon.cli.service import Connection
from daemon.endpoints import LONGEST_SOCKET_PATH
from daemon.errors import ConfigurationError, PortInUseError
from daemon.queue.control_api import RefusedRequestError
from daemon.runtime_folder import default_endpoint, lock_folder, lock_port, port_holders, runtime_folder
from daemon.stop_handle import StopHandle
from tests.daemon.command_line import run
from tests.ports import free_udp_port

REPOSITORY = Path(__file__).resolve().parents[2]
HOLDER = (
    "import sys\nfrom daemon.runtime_folder import lock_port\n"
    "with lock_port('127.0.0.1', 31999):\n print('held', flush=True)\n sys.stdin.read()"
)


@pytest.fixture(autouse=True)
def private(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return tmp_path / "iiwa-ident"


@pytest.fixture
def holder() -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(
        [sys.executable, "-c", HOLDER], cwd=REPOSITORY, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.communicate()


def test_stop_reaches_a_run_that_no_service_keeps(capsys: pytest.CaptureFixture[str]) -> None:
    """It named keys and endpoints, and the arm went on. Truth: the signal of Ctrl-C at who has the port's lock."""
    port, other, stop = free_udp_port(), free_udp_port(), StopHandle()
    with stop.on_signals(), lock_port("127.0.0.1", port):
        assert run("stop", "--port", other) == 69
        said = capsys.readouterr().err
        assert f"on {port}: say --port" in said
        assert "emergency stop" in said
        assert not stop.requested
        assert run("stop", "--port", port) == 0
        said = capsys.readouterr().out
        assert f"Process {os.getpid()}" in said
        assert "with --endpoint it would have gone on" in said  # the same signal ends a service, which was not said
        assert stop.signal_number == signal.SIGINT
    assert run("stop", "--port", port) == 69


def test_stop_without_a_port_reaches_whatever_this_user_drives(capsys: pytest.CaptureFixture[str]) -> None:
    """An operator in a hurry says no port: it named the port of the run that went on. Truth: the signal of Ctrl-C."""
    first, second, stop = free_udp_port(), free_udp_port(), StopHandle()
    with stop.on_signals(), lock_port("127.0.0.1", first), lock_port("127.0.0.1", second):
        assert run("stop") == 0
        assert stop.signal_number == signal.SIGINT
        said = capsys.readouterr().out
        assert all(f"UDP port {port}: Process {os.getpid()}" in said for port in (first, second))
    assert run("stop") == 69
    assert "on any UDP port" in capsys.readouterr().err


def test_a_stop_that_one_service_refuses_says_the_others_too(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The arms that were stopped stood nowhere, only the error did."""
    port, refusing, stop = free_udp_port(), free_udp_port(), StopHandle()
    plain = Connection.ask

    def ask(service: Connection, request: Any, kind: Any) -> Any:
        if service.port == refusing:
            raise RefusedRequestError("refused", "This client has no key.", 69)
        return plain(service, request, kind)

    monkeypatch.setattr(Connection, "ask", ask)
    with stop.on_signals(), lock_port("127.0.0.1", port), lock_port("127.0.0.1", refusing):
        assert run("stop") == 69
    said = capsys.readouterr()
    assert stop.signal_number == signal.SIGINT
    assert f"Process {os.getpid()}" in said.out
    assert "no key" in said.err


@pytest.mark.parametrize("left", ["", "1\n", "no number"])
def test_who_left_a_lock_behind_is_not_stopped(private: Path, left: str) -> None:
    """Process 1 may be anybody by now."""
    lock = runtime_folder() / "port-31998.lock"
    lock.write_text(left)
    assert run("stop", "--port", 31998) == 69
    with lock.open() as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        assert port_holders() == ({31998: 1} if left == "1\n" else {})


def test_the_folder_is_for_its_user_alone(private: Path) -> None:
    assert runtime_folder() == private
    assert stat.S_IMODE(private.stat().st_mode) == 0o700


def test_a_folder_that_others_may_enter_is_refused(private: Path) -> None:
    private.mkdir(mode=0o755)
    with pytest.raises(ConfigurationError) as caught:
        runtime_folder()
    assert str(private) in str(caught.value)


def test_a_link_in_the_place_of_the_folder_is_refused(private: Path, tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir(mode=0o700)
    private.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(ConfigurationError):
        runtime_folder()


def test_the_name_of_a_socket_fits_into_its_address_however_long_the_folders(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    deep = tmp_path / ("d" * 90)
    deep.mkdir()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(deep))
    assert len(default_endpoint(65535).removeprefix("ipc://").encode()) <= LONGEST_SOCKET_PATH


def test_a_port_has_one_supervisor_and_the_refusal_names_it(holder: subprocess.Popen[str]) -> None:
    with pytest.raises(PortInUseError) as caught, lock_port("127.0.0.1", 31999):
        pytest.fail("two hold one port")
    assert caught.value.holder_pid == holder.pid
    assert str(holder.pid) in str(caught.value)
    assert caught.value.exit_code == 69


def test_another_port_is_free_meanwhile(holder: subprocess.Popen[str]) -> None:
    with lock_port("127.0.0.1", 31998):
        pass


def test_a_killed_holder_leaves_no_lock_behind(holder: subprocess.Popen[str]) -> None:
    holder.send_signal(signal.SIGKILL)
    holder.wait(600)
    with lock_port("127.0.0.1", 31999):
        pass


def test_the_next_start_clears_what_a_killed_holder_left_and_nothing_of_one_that_lives(
    private: Path, holder: subprocess.Popen[str]
) -> None:
    left = [private / name for name in ("port-31999.lock", "watch-31999", "daemon-31999")]
    for path in left[1:]:
        path.touch()
    with lock_port("127.0.0.1", 31998):
        assert all(path.exists() for path in left)
    holder.send_signal(signal.SIGKILL)
    holder.wait(600)
    with lock_port("127.0.0.1", 31998):
        assert [path.name for path in private.iterdir()] == ["port-31998.lock"]


def test_the_lock_goes_when_the_block_ends(private: Path) -> None:
    for _ in range(3):
        with lock_port("127.0.0.1", 31997):
            assert (private / "port-31997.lock").read_text() == f"{os.getpid()}\n"
    assert not (private / "port-31997.lock").exists()


def test_a_folder_has_one_holder_whatever_it_is_called(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with lock_folder(Path("run")):
        with (
            pytest.raises(ConfigurationError, match=rf"iiwa-ident \(process {os.getpid()}\)"),
            lock_folder(tmp_path / "other" / ".." / "run"),
        ):
            pass
        with lock_folder(Path("run2")):
            pass
    with lock_folder(tmp_path / "run"):
        pass


@pytest.mark.parametrize("words", [["run", "--no-confirm", "--start-timeout", "0.1"], ["investigate", "--budget", "4"]])
def test_two_commands_never_write_into_one_folder(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Else the table that one has checked could be that of the other by the time its loop reads it."""
    folder = tmp_path / "out"
    with lock_folder(folder), pytest.raises(SystemExit) as end:
        main([*words, "--out", str(folder), "--bind", f"127.0.0.1:{free_udp_port()}"])
    assert end.value.code == 78
    assert "is being written to by another iiwa-ident" in " ".join(capsys.readouterr().err.split())
    assert not folder.exists()


def test_links_that_lead_in_a_circle_are_no_fault_of_ours(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "one").symlink_to(tmp_path / "other")
    (tmp_path / "other").symlink_to(tmp_path / "one")
    with pytest.raises(SystemExit) as end:
        main(["run", "--no-confirm", "--out", str(tmp_path / "one"), "--bind", f"127.0.0.1:{free_udp_port()}"])
    assert end.value.code == 74
    assert str(tmp_path / "one") in "".join(capsys.readouterr().err.split())
