"""Structures and bytes to and from files, each written whole or not at all.

Here: JSON files of msgspec structures, and the atomic write under them. Not here: what the structures mean (`api`).
Every process of the daemon that leaves a file behind calls this.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from daemon.errors import ConfigurationError, MissingInputError

StructType = TypeVar("StructType", bound=msgspec.Struct)


def read_json(path: str | Path, kind: type[StructType]) -> StructType:
    """Read a structure from a JSON file. Raises MissingInputError, or ConfigurationError naming file and field."""
    data = read_bytes(path, kind.__name__)
    try:
        return msgspec.json.decode(data, type=kind)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"{error}.", file=str(Path(path))) from error


def read_bytes(path: str | Path, purpose: str) -> bytes:
    """A file that is needed for a purpose. Raises MissingInputError, ConfigurationError where it cannot be read."""
    file = Path(path)
    try:
        return file.read_bytes()
    except FileNotFoundError as error:
        raise MissingInputError(str(file), purpose) from error
    except OSError as error:
        raise ConfigurationError(f"cannot be read: {error.strerror}.", file=str(file)) from error


def write_json(path: str | Path, value: msgspec.Struct | dict[str, Any]) -> None:
    """Write a structure as indented JSON, atomically: a reader sees the old file or the new one, never a part."""
    write_bytes_atomically(path, msgspec.json.format(msgspec.json.encode(value), indent=2) + b"\n")


def write_bytes_atomically(path: str | Path, data: bytes) -> None:
    """Write a file beside the target, flush it to the disk and rename it over the target. Raises OSError."""
    file = Path(path)
    descriptor, temporary = tempfile.mkstemp(dir=file.parent, prefix=f".{file.name}.")
    try:
        with os.fdopen(descriptor, "wb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        os.chmod(temporary, 0o644)
        os.replace(temporary, file)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
