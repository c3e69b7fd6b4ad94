"""Ports of tests that run beside each other. Truth: the kernel, asked for each of them."""

from __future__ import annotations

import socket

import pytest

from tests.ports import free_tcp_port, free_udp_port


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
