"""Where the files of a run go when its own folder cannot be written any more: the disk is full, or gone.

Here: one private folder per run in the system's temporary folder, the same for all of its processes, and the writing of
small files with it as the second choice. Not here: the samples (`recorder`).
"""

from __future__ import annotations

import errno
import hashlib
import itertools
import os
import re
import stat
import tempfile
from pathlib import Path
from typing import Any

import msgspec

from daemon.api import Message, RunRequest
from daemon.errors import LogIOError
from daemon.json_files import write_bytes_atomically


def spare_folder(request: RunRequest) -> Path:
    """Create the run's spare folder, or take the one another process of the run has created.

    Raises LogIOError when it cannot be created, or when somebody else put something of that name there.
    """
    folder = _spare_path(request)
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except OSError as error:
        raise LogIOError(str(folder), error) from error
    if not _is_ours(found):
        raise LogIOError(str(folder), OSError(errno.EPERM, "is not a private folder of this user"))
    return folder


def set_earlier_aside(request: RunRequest) -> None:
    """Rename what an earlier run of the same name and folder left in its spare folder: it is not this run's.

    Nothing is deleted. Raises LogIOError.
    """
    earlier = _spare_path(request)
    if not earlier.exists():
        return
    names = (earlier.with_name(f"{earlier.name}-earlier-{number}") for number in itertools.count(1))
    aside = next(place for place in names if not place.exists())
    try:
        earlier.rename(aside)
    except OSError as error:
        raise LogIOError(str(earlier), error) from error


def write_run_file(request: RunRequest, name: str, value: Any) -> Path:
    """Write a small JSON file of the run atomically, into its folder or else into the spare one; where it stands.

    value: what msgspec can encode; a Message is indented for people. Raises LogIOError when both refuse.
    """
    data = msgspec.json.encode(value)
    if isinstance(value, Message):
        data = msgspec.json.format(data, indent=2) + b"\n"
    try:
        write_bytes_atomically(Path(request.out_dir) / name, data)
        return Path(request.out_dir) / name
    except OSError:
        file = spare_folder(request) / name
    try:
        write_bytes_atomically(file, data)
    except OSError as error:
        raise LogIOError(str(file), error) from error
    return file


def find_run_file(request: RunRequest, name: str) -> Path:
    """Where a file of the run stands: in the spare folder when it is there, else in the run's own."""
    spare = _spare_path(request) / name
    return spare if spare.is_file() else Path(request.out_dir) / name


def files_elsewhere(request: RunRequest) -> dict[str, Path]:
    """By their names, what the processes of a run left in its spare folder; request: with the folder it began in."""
    folder = _spare_path(request)
    try:
        return {file.name: file for file in sorted(folder.iterdir())} if _is_ours(folder.lstat()) else {}
    except OSError:
        return {}


def _is_ours(found: os.stat_result) -> bool:
    """The name can be foreseen, so a folder is trusted only when it is ours and nobody else may write into it."""
    return stat.S_ISDIR(found.st_mode) and found.st_uid == os.geteuid() and not found.st_mode & 0o077


def _spare_path(request: RunRequest) -> Path:
    run = re.sub(r"[^\w.-]", "_", request.run_id)[:64]
    digest = hashlib.sha256(request.out_dir.encode()).hexdigest()[:12]
    return Path(tempfile.gettempdir()) / f"iiwa-ident-{run}-{digest}"
