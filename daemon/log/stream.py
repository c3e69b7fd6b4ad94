"""The file under the log: bytes are kept until the disk has really taken them, and never half of them.

Here: the stream the MCAP writer writes into, and a reserve of disk space for the day the disk is full.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
from pathlib import Path

from daemon.errors import LogIOError


class PatientFile:
    """A file that is only appended to, whole flushes at a time.

    `write` collects in memory; `flush` hands everything to the operating system. When that fails (disk full), the file
    is cut back to the end of the last whole flush, nothing collected is forgotten, LogIOError is raised and a later
    `flush` tries again. Kept without fsync: what `flush` handed over survives any kill -9, not a power cut.
    While it is open it is locked (flock): others can tell a recording that goes on from one that was broken off.
    """

    def __init__(self, path: Path) -> None:
        """Create the file, which must not exist yet. Raises LogIOError."""
        self._path = path
        try:
            self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        except OSError as error:
            raise LogIOError(str(path), error) from error
        # A file system without locks is no reason not to record.
        with contextlib.suppress(OSError):
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
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
    def is_in_place(self) -> bool:
        """False once nothing has its name any more: what is written then, nobody finds.

        Which file has it is not asked: not every network disk numbers its files.
        """
        try:
            self._path.stat()
        except (FileNotFoundError, NotADirectoryError):
            return False
        except OSError:
            pass  # a disk that does not answer now has its own patience
        return True

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
    """`size` bytes on the disk of a folder, really allocated, given back when the disk is full.

    It buys the room for the stop ramp, the last samples and the closing of the file. The file has no name: it is gone
    with the process, however that ends.
    """

    def __init__(self, folder: Path, name: str, size: int) -> None:
        """Allocate; `name` is seen for an instant only. Raises LogIOError when the room is not there now: then the run
        should not begin.
        """
        path = folder / name
        self._descriptor = -1
        try:
            self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o600)
            path.unlink()
            os.posix_fallocate(self._descriptor, 0, size)
        except OSError as error:
            self.give_back()
            raise LogIOError(str(folder), error) from error

    @property
    def bytes_held(self) -> int:
        """Bytes that nobody else can take."""
        return os.fstat(self._descriptor).st_blocks * 512 if self._descriptor >= 0 else 0

    def give_back(self) -> bool:
        """Free the room; False when that was done before."""
        descriptor, self._descriptor = self._descriptor, -1
        if descriptor >= 0:
            os.close(descriptor)
        return descriptor >= 0


def is_being_written(path: Path) -> bool:
    """True when a living process has this file open as its PatientFile."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    finally:
        os.close(descriptor)
    return False


def is_full(error: LogIOError) -> bool:
    """True when the refusal means a full disk or an exhausted quota."""
    return error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
