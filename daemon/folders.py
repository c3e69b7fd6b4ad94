"""A folder to write into, made with all above it.

Standard library only, because options of every command come through here (`cli.protection`).
"""

from __future__ import annotations

from pathlib import Path

from daemon.errors import LogIOError


def make_folder(folder: Path) -> Path:
    """The folder, made where it is not there. Raises LogIOError where it cannot be: also of /proc, which calls that a
    missing file.
    """
    try:
        # From above, one after the other: pathlib calls itself once a level, and Python ends that at some hundreds.
        for place in reversed(folder.parents):
            if not place.exists():
                place.mkdir(exist_ok=True)
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise LogIOError(str(folder), error) from error
    return folder
