"""Ports of tests that run beside each other. Truth: the kernel, asked for each of them."""

from __future__ import annotations

import ast
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.ports import free_tcp_port, free_udp_port

REPOSITORY = Path(__file__).resolve().parents[1]


def test_a_port_is_free_for_its_own_kind_and_given_to_no_other_test() -> None:
    for given, kind, other in (
        (free_udp_port, socket.SOCK_DGRAM, socket.SOCK_STREAM), (free_tcp_port, socket.SOCK_STREAM, socket.SOCK_DGRAM)
    ):  # fmt: skip
        ports = [given() for _ in range(30)]
        assert len(set(ports)) == 30
        for port in ports:
            with socket.socket(type=kind) as own, socket.socket(type=other) as mark:
                own.bind(("127.0.0.1", port))
                with pytest.raises(OSError, match="in use"):
                    mark.bind(("127.0.0.1", port))


@pytest.mark.parametrize("folder", ["tests/daemon", "tests/end_to_end", "tests/fri_client", "benchmarks"])
def test_no_port_of_the_kernels_choice_is_given_back_before_it_is_used(folder: str) -> None:
    """Once its socket is closed, the kernel gives it to whoever asks next: to a test that runs beside."""
    found = [
        f"{file.name}:{block.lineno}"
        for file in (REPOSITORY / folder).rglob("*.py")
        for block in ast.walk(ast.parse(file.read_text("utf-8")))
        if isinstance(block, ast.With) and "getsockname" in set(names_in(block.body[-1]))
    ]
    assert found == []


def names_in(statement: ast.stmt) -> Iterator[str]:
    """The attributes that it reads."""
    return (node.attr for node in ast.walk(statement) if isinstance(node, ast.Attribute))
