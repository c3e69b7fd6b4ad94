"""Claims about who can speak to the service; truth: real sockets, real keys, and raw bytes from a plain ZeroMQ peer."""

from __future__ import annotations

import contextlib
import os
import socket
import stat
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import zmq

from daemon.errors import ConfigurationError, DaemonError, MissingInputError
from daemon.queue.control_api import (
    MAXIMUM_REQUEST_BYTES,
    ErrorReply,
    Ping,
    Pong,
    RefusedRequestError,
    SubmitRun,
    decode_request,
)
from daemon.queue.control_socket import ControlSocket, ServerKeys, ServiceUnreachableError, ask, check_endpoint
from daemon.queue.keys import create_keys
from tests.watchdog import WATCHDOG_S

PONG = Pong(pid=7, software_version="test")


@contextlib.contextmanager
def served(endpoint: str, keys: ServerKeys | None = None) -> Iterator[ControlSocket]:
    """A socket whose thread answers every readable request with PONG."""
    end = threading.Event()
    ready: list[ControlSocket] = []
    started = threading.Event()

    def serve() -> None:
        with ControlSocket(endpoint, keys) as control:
            ready.append(control)
            started.set()
            while not end.is_set():
                for address, data in control.receive(0.02):
                    try:
                        decode_request(data)
                        control.reply(address, PONG)
                    except RefusedRequestError as error:
                        control.reply(address, ErrorReply(code=error.code, sentence=str(error), exit_code=65))

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        assert started.wait(WATCHDOG_S)
        yield ready[0]
    finally:
        end.set()
        thread.join()


@pytest.fixture
def keys(tmp_path: Path) -> Path:
    folder = tmp_path / "keys"
    create_keys(folder, "office")
    return folder


def server_keys(folder: Path) -> ServerKeys:
    return ServerKeys(folder / "server.key_secret", folder / "authorised")


def test_the_socket_is_a_file_for_its_owner_alone(tmp_path: Path) -> None:
    path = tmp_path / "control"
    with served(f"ipc://{path}"):
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        assert ask(f"ipc://{path}", Ping(), timeout_s=WATCHDOG_S) == PONG


def test_an_address_in_use_is_not_taken_away_and_is_free_again_afterwards(tmp_path: Path) -> None:
    endpoint = f"ipc://{tmp_path / 'control'}"
    with served(endpoint):
        with pytest.raises(ConfigurationError):
            ControlSocket(endpoint)
        assert ask(endpoint, Ping(), timeout_s=WATCHDOG_S) == PONG
    assert not (tmp_path / "control").exists()
    with served(endpoint):
        assert ask(endpoint, Ping(), timeout_s=WATCHDOG_S) == PONG


@pytest.mark.parametrize(
    "endpoint",
    [
        *("tcp://0.0.0.0:5555", "tcp://192.168.1.4:5555", "tcp://*:5555", "tcp://eth0:5555", "tcp://localhost:5555"),
        *(
            "tcp://127.0.0.1",
            "tcp://127.0.0.1:70000",
            "udp://127.0.0.1:5",
            "inproc://x",
            "ipc://relative",
            "ipc://@abs",
        ),
        *("tcp://[::]:5555", "tcp://192.168.1.4;127.0.0.1:5555", "", "ipc:///" + "d" * 120),
    ],
)
def test_an_address_that_others_can_reach_or_that_is_none_is_refused_with_exit_code_78(endpoint: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        check_endpoint(endpoint, with_keys=False)
    assert caught.value.exit_code == 78


def test_with_keys_other_addresses_are_taken() -> None:
    check_endpoint("tcp://192.168.1.4:5555", with_keys=True)
    check_endpoint("tcp://127.0.0.1:5555", with_keys=False)


def test_the_right_key_is_served(keys: Path) -> None:
    with served("tcp://127.0.0.1:0", server_keys(keys)) as control:
        reply = ask(
            control.endpoint, Ping(), timeout_s=WATCHDOG_S,
            key_file=keys / "office.key_secret", server_key_file=keys / "server.key",
        )  # fmt: skip
        assert reply == PONG


def test_a_key_that_is_not_authorised_is_not_answered(keys: Path, tmp_path: Path) -> None:
    create_keys(tmp_path / "foreign", "office")
    with served("tcp://127.0.0.1:0", server_keys(keys)) as control, pytest.raises(ServiceUnreachableError) as caught:
        ask(
            control.endpoint, Ping(), timeout_s=1.0,
            key_file=tmp_path / "foreign" / "office.key_secret", server_key_file=keys / "server.key",
        )  # fmt: skip
    assert caught.value.exit_code == 69


def test_without_a_key_nothing_is_answered(keys: Path) -> None:
    with served("tcp://127.0.0.1:0", server_keys(keys)) as control, pytest.raises(ServiceUnreachableError):
        ask(control.endpoint, Ping(), timeout_s=1.0)


def test_a_client_does_not_speak_to_a_service_with_another_key(keys: Path, tmp_path: Path) -> None:
    create_keys(tmp_path / "foreign", "office")
    with served("tcp://127.0.0.1:0", server_keys(keys)) as control, pytest.raises(ServiceUnreachableError):
        ask(
            control.endpoint, Ping(), timeout_s=1.0,
            key_file=keys / "office.key_secret", server_key_file=tmp_path / "foreign" / "server.key",
        )  # fmt: skip


def test_an_emptied_folder_serves_nobody(keys: Path) -> None:
    (keys / "authorised" / "office.key").unlink()
    with served("tcp://127.0.0.1:0", server_keys(keys)) as control, pytest.raises(ServiceUnreachableError):
        ask(
            control.endpoint, Ping(), timeout_s=1,
            key_file=keys / "office.key_secret", server_key_file=keys / "server.key",
        )  # fmt: skip


def test_secret_keys_are_for_their_owner_alone_and_refused_when_they_are_not(keys: Path) -> None:
    for secret in keys.glob("*.key_secret"):
        assert stat.S_IMODE(secret.stat().st_mode) == 0o600
    os.chmod(keys / "server.key_secret", 0o640)
    with pytest.raises(ConfigurationError) as caught:
        ControlSocket("tcp://127.0.0.1:0", server_keys(keys))
    assert "server.key_secret" in str(caught.value)


def test_a_second_client_gets_a_pair_of_its_own_and_the_services_pair_stays(keys: Path) -> None:
    before = (keys / "server.key_secret").read_bytes()
    create_keys(keys, "lab-2")
    assert (keys / "server.key_secret").read_bytes() == before
    assert {file.name for file in (keys / "authorised").iterdir()} == {"office.key", "lab-2.key"}
    for name in ("office", "server", "../x", ""):
        with pytest.raises(ConfigurationError):
            create_keys(keys, name)


@pytest.mark.parametrize(("secret", "authorised"), [("none.key_secret", "authorised"), ("server.key_secret", "none")])
def test_missing_keys_are_said_before_anything_is_served(keys: Path, secret: str, authorised: str) -> None:
    with pytest.raises(DaemonError) as caught:
        ControlSocket("tcp://127.0.0.1:0", ServerKeys(keys / secret, keys / authorised))
    assert isinstance(caught.value, (MissingInputError, ConfigurationError))


def raw(endpoint: str, kind: int) -> Any:
    channel = zmq.Context.instance().socket(kind)
    channel.linger = 0
    channel.connect(endpoint)
    return channel


def test_frames_that_are_no_request_are_counted_and_the_next_request_is_served(tmp_path: Path) -> None:
    endpoint = f"ipc://{tmp_path / 'control'}"
    with served(endpoint) as control:
        peer = raw(endpoint, zmq.DEALER)
        for frames in ([b""] * 4, [b"a", b"b"], [b"x"] * 50):
            peer.send_multipart(frames)
        assert ask(endpoint, Ping(), timeout_s=WATCHDOG_S) == PONG
        peer.send(b"\xff\xfe")
        assert peer.poll(1e3 * WATCHDOG_S)
        assert b'"bad_request"' in peer.recv_multipart()[-1]
        assert control.malformed == 3
        peer.close()


def test_a_message_beyond_the_limit_costs_its_sender_the_connection_and_nobody_else(tmp_path: Path) -> None:
    endpoint = f"ipc://{tmp_path / 'control'}"
    with served(endpoint):
        peer = raw(endpoint, zmq.DEALER)
        peer.send(b" " * (MAXIMUM_REQUEST_BYTES + 1))
        assert not peer.poll(500)
        assert ask(endpoint, Ping(), timeout_s=WATCHDOG_S) == PONG
        peer.close()


def test_a_file_that_is_too_long_is_said_by_the_client(tmp_path: Path) -> None:
    """The service's socket gives no answer to it, and it was said that no service was there."""
    endpoint = f"ipc://{tmp_path / 'control'}"
    with served(endpoint), pytest.raises(RefusedRequestError, match="at most 8388608 are read") as caught:
        ask(endpoint, SubmitRun(trajectory=bytes(MAXIMUM_REQUEST_BYTES), suffix=".npz", name="big"), timeout_s=0.1)
    assert caught.value.exit_code == 65


def test_bytes_that_are_not_even_zeromq_do_no_harm(tmp_path: Path) -> None:
    path = tmp_path / "control"
    with served(f"ipc://{path}"):
        with socket.socket(socket.AF_UNIX) as channel:
            channel.connect(str(path))
            channel.sendall(os.urandom(5000))
        assert ask(f"ipc://{path}", Ping(), timeout_s=WATCHDOG_S) == PONG


def test_silence_is_exit_code_69_and_names_the_address(tmp_path: Path) -> None:
    endpoint = f"ipc://{tmp_path / 'nobody'}"
    with pytest.raises(ServiceUnreachableError) as caught:
        ask(endpoint, Ping(), timeout_s=0.2)
    assert caught.value.exit_code == 69
    assert endpoint in str(caught.value)
