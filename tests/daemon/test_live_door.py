"""Claims about who may see a run: nobody beyond this machine without a key, and with one only by TLS.

Truth: Python's own TLS client, which trusts the test's certificate alone (data/robot-pc.pem, made for this test).
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import socket
import ssl
import subprocess
import sys
import time
from pathlib import Path

import pytest

from daemon.cli.live_view import LiveOptions
from daemon.errors import ConfigurationError, MissingInputError
from daemon.live import server
from daemon.live.door import Door, require_free
from tests.ports import free_tcp_port
from tests.watchdog import WATCHDOG_S

REPOSITORY = Path(__file__).resolve().parents[2]
IDENTITY = Path(__file__).parent / "data" / "robot-pc.pem"


@pytest.fixture
def key(tmp_path: Path) -> Path:
    file = tmp_path / "robot-pc.pem"
    shutil.copyfile(IDENTITY, file)
    file.chmod(0o600)
    return file


@pytest.mark.parametrize("held", ["FOXGLOVE_PORT", "PLOTJUGGLER_PORT"])
def test_a_second_run_is_not_told_to_look_at_the_view_of_the_first(
    held: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """With two arms both runs named one address, and what a viewer showed there was the other arm."""
    pytest.importorskip("foxglove")
    for name in ("FOXGLOVE_PORT", "PLOTJUGGLER_PORT"):
        monkeypatch.setattr(server, name, free_tcp_port())
    with socket.create_server(("127.0.0.1", getattr(server, held))):
        with pytest.raises(ConfigurationError, match="in use, as by the live view of another run"):
            LiveOptions(live=True).server()
        assert "ws://" not in capsys.readouterr().err
    assert LiveOptions(live=True).server() == ["--address", "127.0.0.1"]
    with pytest.raises(ConfigurationError, match=r"198\.51\.100\.77 cannot be served"):
        require_free("198.51.100.77", free_tcp_port())  # reserved for examples, of no machine


def test_without_options_the_door_is_on_loopback() -> None:
    assert Door.of(None, 8765, None).url == "ws://127.0.0.1:8765"


@pytest.mark.parametrize("address", ["192.168.10.5", "0.0.0.0", "::"])
def test_beyond_loopback_there_is_no_door_without_a_key(address: str) -> None:
    with pytest.raises(ConfigurationError, match="--live-key"):
        Door.of(address, 8765, None)


def test_with_a_key_foxglove_is_told_to_use_tls(key: Path) -> None:
    assert Door.of("192.168.10.5", 8765, key).url == "wss://192.168.10.5:8765"
    assert Door.of("fe80::5", 8765, key).url == "wss://[fe80::5]:8765"


def test_a_name_is_no_address() -> None:
    with pytest.raises(ConfigurationError, match="no IP address"):
        Door.of("robot-pc", 8765, None)


def test_a_key_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(MissingInputError, match="nothing\\.pem"):
        Door.of(None, 8765, tmp_path / "nothing.pem")


@pytest.mark.parametrize("missing", ["CERTIFICATE", "PRIVATE KEY"])
def test_half_an_identity_is_refused_with_the_way_to_make_a_whole_one(key: Path, missing: str) -> None:
    key.write_text(key.read_text().replace(missing, "NOTHING"))
    with pytest.raises(ConfigurationError, match="openssl req") as caught:
        Door.of(None, 8765, key)
    # What openssl would write over may be anything: a trajectory was named by mistake once.
    assert f"-keyout new-{key.stem}.pem" in str(caught.value)
    assert f" {key.name}" not in str(caught.value)


def test_a_private_key_that_others_may_read_is_refused(key: Path) -> None:
    key.chmod(0o644)
    with pytest.raises(ConfigurationError, match="chmod 600"):
        Door.of(None, 8765, key)


def _wait_for(port: int, process: subprocess.Popen[bytes]) -> None:
    while process.poll() is None:
        with contextlib.suppress(ConnectionRefusedError), socket.create_connection(("127.0.0.1", port)):
            return
        time.sleep(0.05)
    pytest.fail("the server did not begin")


def test_with_a_key_the_server_speaks_tls_alone(key: Path, tmp_path: Path) -> None:
    pytest.importorskip("foxglove")
    client = pytest.importorskip("websockets.sync.client")
    refused = pytest.importorskip("websockets.exceptions").WebSocketException
    port, plotjuggler_port = free_tcp_port(), free_tcp_port()
    process = subprocess.Popen(
        [sys.executable, "-m", "daemon.live.server", "--port", "30987", "--foxglove-port", str(port),
         "--plotjuggler-port", str(plotjuggler_port), "--address", "127.0.0.1", "--key", str(key)],
        stdin=subprocess.PIPE, cwd=REPOSITORY, env={**os.environ, "XDG_RUNTIME_DIR": str(tmp_path)},
    )  # fmt: skip
    assert process.stdin is not None
    with process.stdin:
        trusted = ssl.create_default_context(cafile=str(IDENTITY))
        subprotocols = ["foxglove.sdk.v1"]
        _wait_for(port, process)
        with client.connect(f"wss://127.0.0.1:{port}", ssl=trusted, subprotocols=subprotocols) as viewer:
            assert json.loads(viewer.recv(timeout=WATCHDOG_S))["op"] == "serverInfo"
        with pytest.raises((OSError, EOFError, refused)):
            client.connect(f"ws://127.0.0.1:{port}", subprotocols=subprotocols).close()
        with pytest.raises(ssl.SSLCertVerificationError):
            client.connect(f"wss://127.0.0.1:{port}", ssl=ssl.create_default_context(), subprotocols=subprotocols)
    assert process.wait(WATCHDOG_S) == 0
