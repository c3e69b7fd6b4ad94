"""Where Foxglove finds a run: on loopback, or with a TLS key on another address of this machine."""

from __future__ import annotations

import errno
import ipaddress
import re
import socket
from pathlib import Path
from typing import NamedTuple

from daemon.errors import ConfigurationError, MissingInputError

LOOPBACK = "127.0.0.1"
_BLOCK = re.compile(rb"-----BEGIN ([A-Z ]+)-----.+?-----END \1-----\n?", re.DOTALL)


class Door(NamedTuple):
    """A TCP port on an address of this machine; identity: PEM certificates and private key for TLS."""

    address: str
    port: int
    identity: tuple[bytes, bytes] | None

    @classmethod
    def of(cls, address: str | None, port: int, key: Path | None) -> Door:
        """The door at an address, loopback where none is given.

        Raises ConfigurationError for what is no IP address, for one beyond loopback without a key, and for a key file
        that is incomplete or readable by others; MissingInputError.
        """
        address = address or LOOPBACK
        try:
            is_here = ipaddress.ip_address(address).is_loopback
        except ValueError as error:
            raise ConfigurationError(f"'{address}' is no IP address.", field="--live-address") from error
        if not is_here and key is None:
            raise ConfigurationError(
                f"at {address} other machines can see the run: give --live-key FILE too, a certificate with its "
                "private key.",
                field="--live-address",
            )
        return cls(address, port, None if key is None else _read_identity(key))

    @property
    def url(self) -> str:
        """What to type into Foxglove."""
        host = f"[{self.address}]" if ":" in self.address else self.address
        return f"{'ws' if self.identity is None else 'wss'}://{host}:{self.port}"


def require_free(address: str, port: int) -> None:
    """Raises ConfigurationError for a TCP port that cannot be listened on, such as that of another run's live view."""
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as door:
        door.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # what an ended run left does not count
        try:
            door.bind((address, port))
            return
        except OSError as error:
            why = error.strerror
            if error.errno == errno.EADDRINUSE:
                why = "in use, as by the live view of another run, which a viewer would show in place of this one"
    raise ConfigurationError(f"TCP port {port} on {address} cannot be served ({why}).", field="--live")


def _read_identity(file: Path) -> tuple[bytes, bytes]:
    """Certificates and PKCS #8 private key of a PEM file that only its owner can read."""
    if not file.is_file():
        raise MissingInputError(str(file), "a key")
    try:
        text = file.read_bytes()
        mode = file.stat().st_mode
    except OSError as error:
        raise ConfigurationError(f"cannot be read: {error.strerror}.", file=str(file)) from error
    blocks = [(match[1], match[0]) for match in _BLOCK.finditer(text)]
    certificates = b"".join(block for name, block in blocks if name == b"CERTIFICATE")
    keys = [block for name, block in blocks if name == b"PRIVATE KEY"]
    if not certificates or len(keys) != 1:
        # What stands in the file named may be anything else: its name is not one to have openssl write to.
        new = f"new-{file.stem}.pem"
        raise ConfigurationError(
            "must hold a certificate and one private key (PKCS #8), both as PEM. `openssl req -x509 -newkey rsa:3072 "
            f"-nodes -days 365 -subj /CN=robot-pc -keyout {new} -out certificate.pem` and then `cat "
            f"certificate.pem >> {new}` make such a file.",
            file=str(file),
        )
    if mode & 0o077:
        raise ConfigurationError("holds a private key that other users may read: `chmod 600` it.", file=str(file))
    return certificates, keys[0]
