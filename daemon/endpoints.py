"""Which addresses there are to listen at: one rule, for the checks of settings and for the sockets themselves."""

from __future__ import annotations

import ipaddress
import os
import re

LONGEST_SOCKET_PATH = 107
"""Bytes; sun_path of unix(7) less its closing zero."""
_TCP = re.compile(r"tcp://(?P<host>[^/]+):(?P<port>[0-9]{1,5})")


def endpoint_reason(endpoint: str, *, with_keys: bool) -> str:
    """Why the service may not listen there; empty for ipc, loopback, and any IPv4 address where keys are required."""
    if endpoint.startswith("ipc://"):
        path = endpoint.removeprefix("ipc://")
        if not os.path.isabs(path):
            return f"'{endpoint}' needs an absolute path (ipc:///run/...)."
        if len(os.fsencode(path)) > LONGEST_SOCKET_PATH:
            return f"'{path}' is longer than the {LONGEST_SOCKET_PATH} bytes a socket's name may have."
        return ""
    found = _TCP.fullmatch(endpoint)
    try:
        address = ipaddress.IPv4Address(found["host"] if found else "")
    except ValueError:
        return f"'{endpoint}' is neither ipc:///PATH nor tcp://IPV4-ADDRESS:PORT."
    if found is None or int(found["port"]) > 65535:
        return f"'{endpoint}' names no TCP port (0 to 65535)."
    if not address.is_loopback and not with_keys:
        return (
            f"{address} can be reached from other machines: that needs keys (control.server_key and "
            "control.authorised_clients; `iiwa-ident keys` makes them)."
        )
    return ""


def is_ipv4(text: str) -> bool:
    """Whether a text is an IPv4 address; names are not looked up, because FRI's peers are fixed by their numbers."""
    try:
        ipaddress.IPv4Address(text)
    except ValueError:
        return False
    return True
