"""The parts of one recording in its folder: which there are, how they become one file, what a broken-off run needs.

Here: names and order of parts, joining, recovery of a whole folder. Not here: reading and writing of logs (`recover`),
who started which recorder. The supervisor joins what its recorders left, the loop what it had to rescue by itself, the
command line recovers.

    recording.mcap          the recording; while it is written its recorder holds a lock on it
    recording.partN.mcap    what a successor of a killed recorder found in the ring, N = 1, 2, ...
    recording.broken.mcap   the file of the killed recorder, kept once the parts were joined into recording.mcap
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from daemon.errors import LogIOError, MissingInputError
from daemon.log.recover import RecoverReport, is_finished, merge_logs, recover_log
from daemon.log.stream import is_being_written

RECORDING_NAME = "recording.mcap"
_BROKEN_NAME = "recording.broken.mcap"


def part_path(folder: Path, part: int) -> Path:
    """Where the recorder number `part` of a run writes."""
    return folder / (RECORDING_NAME if part == 0 else f"recording.part{part}.mcap")


def parts_of(folder: Path) -> list[Path]:
    """The parts that still are to be joined, in their order; the recording alone when that was done before."""
    first, broken = folder / RECORDING_NAME, folder / _BROKEN_NAME
    rest = [part for number in range(1, 100) if (part := part_path(folder, number)).is_file()]
    if first.is_file():
        return [first] if broken.is_file() else [first, *rest]
    return [broken, *rest] if broken.is_file() else rest


def join_parts(parts: Sequence[Path]) -> RecoverReport:
    """Join the parts of a run, in their order, into recording.mcap; the first is kept as recording.broken.mcap.

    The joined file stands where the last part that went elsewhere stands (the run's own disk was full then), else in
    the run's folder. Raises BadLogError when nothing is readable, LogIOError when the disk refuses.
    """
    sources = list(parts)
    home = sources[0].parent
    folder = next((part.parent for part in reversed(sources) if part.parent != home), home)
    if sources[0].name == RECORDING_NAME:
        broken = sources[0].with_name(_BROKEN_NAME)
        try:
            os.replace(sources[0], broken)
        except OSError as error:
            raise LogIOError(str(sources[0]), error) from error
        sources[0] = broken
    return merge_logs(sources, folder / RECORDING_NAME)


def recover(path: Path) -> RecoverReport:
    """Recover one log, or the recording of a run's folder with all its parts.

    Raises MissingInputError, BadLogError when nothing usable is in it, LogIOError (also while it is being recorded).
    """
    if not path.is_dir():
        return recover_log(path)
    parts = parts_of(path)
    if not parts:
        raise MissingInputError(str(path / RECORDING_NAME), "the log to recover")
    if len(parts) == 1:
        return recover_log(parts[0])
    for part in parts:
        if is_being_written(part):
            return recover_log(part)  # which says so
    return join_parts(parts)


def state_of_recording(folder: Path) -> str:
    """What a folder holds: "none", "recording" (being written), "broken" (its recorder was killed) or "whole".

    A finished recording is whole whatever was damaged in it since: `recover` looks at what it holds.
    """
    parts = parts_of(folder)
    if not parts:
        return "none"
    if any(is_being_written(part) for part in parts):
        return "recording"
    return "whole" if len(parts) == 1 and is_finished(parts[0]) else "broken"
