"""The file under the log: bytes are kept until the disk has really taken them, and never half of them.

Here: the stream the MCAP writer writes into, and a reserve of disk space for the day the disk is full. Not here:
MCAP, messages. The writer uses it.
"""

from __future__ import annotations

import errno
import os
from pathlib import Path

from daemon.errors import LogIOError

__all__ = ["DiskReserve", "PatientFile", "is_full"]


class PatientFile:
    """A file that is only appended to, whole flushes at a time.

    `write` collects in memory; `flush` hands everything to the operating system. When that fails (disk full), the file
    is cut back to the end of the last whole flush, nothing collected is forgotten, LogIOError is raised and a later
    `flush` tries again. Kept without fsync: what `flush` handed over survives any kill -9, not a power cut.
    """

    def __init__(self, path: Path) -> None:
        """Create the file, which must not exist yet. Raises LogIOError."""
        self._path = path
        try:
            self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        except OSError as error:
            raise LogIOError(str(path), error) from error
        self._committed = 0
        self._pending = bytearray()

    def write(self, data: bytes) -> int:
        """Collect; cannot fail."""
        self._pending += data
        return len(data)

    def tell(self) -> int:
        """Position at which the next byte will stand."""
        return self._committed + len(self._pending)

    def flush(self) -> None:
        """Hand everything to the operating system, or nothing. Raises LogIOError; can be repeated."""
        view = memoryview(self._pending)
        done = 0
        try:
            while done < len(view):
                done += os.pwrite(self._descriptor, view[done:], self._committed + done)
        except OSError as error:
            # Nothing half written may stay: a reader of the file stops at the first broken record.
            os.ftruncate(self._descriptor, self._committed)
            raise LogIOError(str(self._path), error) from error
        finally:
            view.release()
        self._committed += done
        self._pending = bytearray()

    @property
    def committed(self) -> int:
        """Bytes the operating system has."""
        return self._committed

    @property
    def pending(self) -> int:
        """Bytes still in memory."""
        return len(self._pending)

    def sync(self) -> None:
        """Ask the disk to keep what it has (fsync). Raises LogIOError."""
        try:
            os.fsync(self._descriptor)
        except OSError as error:
            raise LogIOError(str(self._path), error) from error

    def close(self) -> None:
        """Close the descriptor; what was not flushed is gone."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1


class DiskReserve:
    """A file of `size` bytes beside the log, really allocated, given back when the disk is full.

    It buys the room for the stop ramp, the last samples and the closing of the file.
    """

    def __init__(self, folder: Path, name: str, size: int) -> None:
        """Allocate. Raises LogIOError when the room is not there now: then the run should not begin."""
        self._path = folder / name
        try:
            descriptor = os.open(self._path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o600)
            try:
                os.posix_fallocate(descriptor, 0, size)
            finally:
                os.close(descriptor)
        except OSError as error:
            self._path.unlink(missing_ok=True)
            raise LogIOError(str(folder), error) from error
        self._held = True

    def give_back(self) -> bool:
        """Free the room; False when that was done before."""
        held, self._held = self._held, False
        self._path.unlink(missing_ok=True)
        return held


def is_full(error: LogIOError) -> bool:
    """True when the refusal means a full disk or an exhausted quota."""
    return error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
