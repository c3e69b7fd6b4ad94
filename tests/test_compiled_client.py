"""Claims about the C++ client of the benchmark: it answers the vendor's own datagrams with what stands in them."""

from __future__ import annotations

import socket
import threading
from pathlib import Path
from typing import Any

import pytest

from benchmarks.compiled_client import compile_client, serve
from fri_client.loop.channel import UdpChannel
from fri_client.messages import FriVersion
from fri_client.wire.codec import Codec
from tests.reference import golden_datagrams

VECTORS = golden_datagrams()


@pytest.mark.parametrize("version", ["1.15", "2.5"])
def test_the_compiled_client_answers_as_the_vendors_does(version: str, tmp_path: Path) -> None:
    program = compile_client(tmp_path)
    if program is None:
        pytest.skip("no C++ compiler on this machine")
    whole = [
        entry
        for entry in VECTORS[version]["monitoring"]
        if entry["fields"].get("connectionInfo", {}).get("sessionState", 0) >= 3
        and len(entry["fields"].get("ipoData", {}).get("jointPosition", {}).get("value", ())) == 7
    ]
    assert whole
    codec = Codec(FriVersion(version))
    with UdpChannel() as channel, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as robot:
        channel.bind("127.0.0.1", 0)
        robot.bind(("127.0.0.1", 0))
        robot.settimeout(600.0)
        found: list[Any] = []
        client = threading.Thread(target=lambda: found.append(serve(program, channel.fileno(), len(whole))))
        client.start()
        for number, entry in enumerate(whole):
            robot.sendto(bytes.fromhex(entry["hex"])[: len(entry["hex"]) // 2 - 1], channel.address)  # cut: no answer
            robot.sendto(bytes.fromhex(entry["hex"]), channel.address)
            position = tuple(entry["fields"]["ipoData"]["jointPosition"]["value"])
            counter = entry["fields"]["header"]["sequenceCounter"]
            assert robot.recv(2048) == codec.encode_position_command(number, counter, position)
        client.join(60.0)
    assert len(found[0]) == len(whole)
    assert (found[0] > 0).all()
