"""One entry for every recording: picks the reader by the file's suffix and hands its rows to the cleaning.

Called by the fit, the diagnosis and the command line. The parsing of each format lives in its own module.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable
from pathlib import Path

from identification.errors import RecordingError, RecordingNotFoundError
from identification.recordings.cleaning import build_recording
from identification.recordings.csv_reader import read_csv
from identification.recordings.mcap_reader import read_mcap
from identification.recordings.npz_reader import read_npz
from identification.recordings.recording import Recording
from identification.recordings.table import RawTable

READERS: dict[str, Callable[[Path, str | None], RawTable | Recording]] = {
    ".npz": read_npz,
    ".csv": read_csv,
    ".mcap": read_mcap,
}


def read_recording(path: str | Path, *, robot: str | Path | None = None) -> Recording:
    """Read a recording: .npz and .csv as described in the README, .mcap of this project or of ROS 2.

    path: the file. robot: name or path of the robot; overrides what the file says. Doubtful rows are found, named in
    `Recording.report` and left out. Raises RecordingNotFoundError (exit 66) when there is no such file, RecordingError
    (exit 65) when the file cannot be used; the text says why.
    """
    path = Path(path)
    if not path.exists():
        raise RecordingNotFoundError(f"{path}: there is no such recording", file=path)
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise RecordingError(
            f"{path.name}: recordings end in {', '.join(READERS)}, this one in '{path.suffix}'", file=path
        )
    if path.is_dir():
        raise RecordingError(f"{path}: is a folder; give the recording inside it", file=path)
    robot_name = None if robot is None else str(robot)
    table = reader(path, robot_name)
    if isinstance(table, Recording):
        return table
    return build_recording(table, sha256=file_digest(path), robot=robot_name)


def file_digest(path: Path) -> str:
    """SHA-256 of a file's bytes, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def robot_of(recordings: Iterable[Recording]) -> str:
    """The robot that all the recordings name.

    Raises RecordingError when one of them names none or two name different ones: the caller must then say which.
    """
    named: str | None = None
    first = ""
    for recording in recordings:
        name = Path(recording.source.path).name
        if recording.robot is None:
            raise RecordingError(
                f"{name}: does not say which robot it is of; give --robot NAME or --robot FILE.urdf",
                file=recording.source.path,
                field="robot",
            )
        if named is not None and recording.robot != named:
            raise RecordingError(
                f"{name}: is of robot {recording.robot}, but {first} is of {named}; give --robot to use one for both",
                file=recording.source.path,
                field="robot",
            )
        named, first = recording.robot, name
    if named is None:
        raise RecordingError("No recording was given")
    return named
