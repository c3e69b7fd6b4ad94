"""CURVE keys of the control interface: making them, and reading them with care for who else can.

A key pair is two files as ZeroMQ's own tools write them: NAME.key (public) and NAME.key_secret (public and secret).
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import zmq.auth

from daemon.errors import ConfigurationError, LogIOError, MissingInputError

AUTHORISED = "authorised"


def create_keys(folder: Path, client: str) -> list[Path]:
    """Make the service's pair (once) and one for `client`, whose public key is authorised; the files made.

    Secret files get mode 0600, folders 0700. Raises ConfigurationError for a name that is none or has keys already, and
    LogIOError.
    """
    if not client.replace("-", "").replace("_", "").isalnum() or client == "server":
        raise ConfigurationError(f"'{client}' is no name for a client: letters, digits, - and _ (not 'server').")
    if (folder / f"{client}.key_secret").exists():
        raise ConfigurationError(f"{folder} holds keys of {client} already; remove them first if they are to be new.")
    before = os.umask(0o077)
    try:
        authorised = folder / AUTHORISED
        authorised.mkdir(parents=True, exist_ok=True, mode=0o700)
        made = []
        for name in ("server", client):
            if not (folder / f"{name}.key_secret").exists():
                made += [Path(file) for file in zmq.auth.create_certificates(folder, name)]
        shutil.copyfile(folder / f"{client}.key", authorised / f"{client}.key")
        return [*made, authorised / f"{client}.key"]
    except OSError as error:
        raise LogIOError(str(folder), error) from error
    finally:
        os.umask(before)


def read_public_key(file: Path) -> bytes:
    """The public key in a file. Raises MissingInputError, ConfigurationError."""
    return _load(file)[0]


def read_secret_key(file: Path) -> tuple[bytes, bytes]:
    """Public and secret key. Raises MissingInputError, ConfigurationError, also for a file that others may read."""
    public, secret = _load(file)
    if secret is None:
        raise ConfigurationError("holds no secret key; give the file that ends in .key_secret.", file=str(file))
    if file.stat().st_mode & 0o077:
        raise ConfigurationError("holds a secret key that other users may read: `chmod 600` it.", file=str(file))
    return public, secret


def _load(file: Path) -> tuple[bytes, bytes | None]:
    if not file.is_file():
        raise MissingInputError(str(file), "a key")
    try:
        return zmq.auth.load_certificate(file)
    except (OSError, ValueError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"is no key file: {error}.", file=str(file)) from error
