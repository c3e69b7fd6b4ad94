"""No command writes over a recording: measurements cannot be made again. Nor does one work for a file it cannot write.

Here: what a recording looks like from outside, by its first bytes, and whether a file can be written. Options that name
a file to write ask here before the command begins. Standard library only, because every command's options come through
here.
"""

from __future__ import annotations

import errno
import os
import re
import sqlite3
import tempfile
import zipfile
from contextlib import closing
from pathlib import Path

import typer

from daemon.errors import LogIOError
from daemon.folders import make_folder

_MCAP = b"\x89MCAP0\r\n"
_SQLITE = b"SQLite format 3\x00"
_HEADER_BYTES = 65536


def is_recording(file: Path) -> bool:
    """Whether a file is an MCAP log, a ROS 2 database, or a table (.npz, .csv) with time, position and torque."""
    if not file.is_file():  # from a pipe nothing may be read, and nobody may be waited for
        return False
    try:
        with file.open("rb") as stream:
            head = stream.read(_HEADER_BYTES)
    except OSError:
        return False
    if head.startswith(_MCAP):
        return True
    if head.startswith(_SQLITE):
        return _is_bag(file)
    if head.startswith(b"PK"):
        try:
            with zipfile.ZipFile(file) as archive:
                return {"t.npy", "q.npy", "tau.npy"} <= set(archive.namelist())
        except (zipfile.BadZipFile, OSError):
            return False
    if file.suffix.lower() != ".csv":
        return False
    lines = head.decode("utf-8", errors="replace").lstrip("\ufeff").splitlines()
    header = next((line for line in lines if line.strip() and not line.lstrip().startswith("#")), "")
    names = {name.strip().strip('"') for name in header.split(",")}
    return bool(names & {"t", "time"}) and any(re.fullmatch(r"tau_?\d+", name) for name in names)


def _is_bag(file: Path) -> bool:
    try:
        with closing(sqlite3.connect(f"{file.resolve().as_uri()}?mode=ro&immutable=1", uri=True)) as database:
            names = {row[0] for row in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    except sqlite3.Error:
        return False
    return {"messages", "topics"} <= names


def not_a_recording(file: Path | None) -> Path | None:
    """The file as it is, for an option that names one to write. Raises a usage error where it is a recording, OSError
    or LogIOError where it cannot be written: better now than after an hour, or after a motion.
    """
    if file is None or str(file) == "-":
        return file
    if is_recording(file):
        raise typer.BadParameter(f"{file} is a recording, and no command writes over one; give another name.")
    if file.is_dir():
        raise OSError(errno.EISDIR, os.strerror(errno.EISDIR), str(file))
    if file.exists():
        _require_access(file, file)
    else:
        _require_room(file.absolute().parent, file)
    return file


def folder_to_write(folder: Path | None) -> Path | None:
    """The folder as it is, for an option that names one to write into. Raises OSError, LogIOError where it cannot be
    one.
    """
    if folder is not None:
        _require_room(folder, folder)
    return folder


def _require_room(folder: Path, named: Path) -> None:
    """Raises OSError or LogIOError, which name `named`, where the folder is no folder and cannot be made one, or takes
    nothing.
    """
    there = next(place for place in (folder, *folder.absolute().parents) if place.exists())
    if not there.is_dir():
        raise OSError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(named))
    _require_access(there, named)
    try:
        os.rmdir(tempfile.mkdtemp(dir=there))
    except OSError as error:  # of /proc, of which everybody else says that it can be written to
        raise LogIOError(str(named), error) from error


def _require_access(place: Path, named: Path) -> None:
    if not os.access(place, os.W_OK):
        raise OSError(errno.EACCES, os.strerror(errno.EACCES), str(named))


def in_its_folder(file: Path) -> Path:
    """The file, once the folder that it is to stand in is there. Raises LogIOError where no folder can be."""
    make_folder(file.parent)
    return file
