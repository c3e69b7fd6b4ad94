"""The private folder for sockets and locks, one per user: where it is, what may stand in it, and the locks themselves.

Here: `runtime_folder`, the endpoints in it, the locks that keep one UDP port for one supervisor and one folder for one
command, and what is cleared of those that were killed.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import os
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path

import psutil

from daemon.endpoints import LONGEST_SOCKET_PATH
from daemon.errors import ConfigurationError, PortInUseError

_LONGEST_NAME = len("/daemon-65535")


def runtime_folder() -> Path:
    """The folder, made with mode 0700: in $XDG_RUNTIME_DIR, or one per user in the folder for temporary files.

    Raises ConfigurationError when what stands there is not a private folder of this user: somebody else's sockets must
    not be taken for the service's.
    """
    base = os.environ.get("XDG_RUNTIME_DIR", "")
    folder = Path(base) / "iiwa-ident"
    if not os.path.isdir(base) or len(os.fsencode(folder)) + _LONGEST_NAME > LONGEST_SOCKET_PATH:
        folder = Path(tempfile.gettempdir()) / f"iiwa-ident-{os.getuid()}"
    if len(os.fsencode(folder)) + _LONGEST_NAME > LONGEST_SOCKET_PATH:
        # Names of sockets have a limit; the system's own folder is short.
        folder = Path("/tmp") / f"iiwa-ident-{os.getuid()}"
    with contextlib.suppress(FileExistsError):
        folder.mkdir(mode=0o700)
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or stat.S_IMODE(found.st_mode) & 0o077:
        raise ConfigurationError(
            f"{folder} must be a folder of user {os.getuid()} that nobody else may enter (mode 0700): remove it or set "
            "XDG_RUNTIME_DIR."
        )
    return folder


def default_endpoint(port: int) -> str:
    """Where the service of one UDP port is reached when nothing else is said: a socket in the private folder."""
    return f"ipc://{runtime_folder() / f'daemon-{port}'}"


def live_endpoint(port: int) -> str:
    """Where the recorder of the run on one UDP port broadcasts its live view: in the private folder as well."""
    return f"ipc://{runtime_folder() / f'watch-{port}'}"


@contextlib.contextmanager
def lock_port(host: str, port: int) -> Iterator[None]:
    """Hold UDP port `port` of this user for the block; port 0 (the system's choice) needs no lock.

    The kernel gives the lock back when its holder ends, however it ends. What killed holders left of theirs is cleared.
    Raises PortInUseError naming the holder.
    """
    if port == 0:
        yield
        return
    _clear_left_behind(except_port=port)
    try:
        with _held(runtime_folder() / f"port-{port}.lock"):
            yield
    except _HeldError as error:
        raise PortInUseError(host, port, holder_pid=error.pid) from error


def port_has_holder(port: int) -> bool:
    """Whether a run or a service of this user, or what came after it under its number, holds that UDP port.

    Only read: a lock that is tried could be in the way of a run that begins at this moment.
    """
    with contextlib.suppress(OSError):
        holder = (runtime_folder() / f"port-{port}.lock").read_text(errors="replace").strip()
        return not holder.isdigit() or psutil.pid_exists(int(holder))
    return False


def port_holders() -> dict[int, int]:
    """Which process of this user holds which UDP port at this moment, for a run or as a service."""
    holders = {}
    for path in runtime_folder().glob("port-*.lock"):
        try:
            with _opened(path) as descriptor:
                fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            port, holder = path.stem.removeprefix("port-"), path.read_text(errors="replace").strip()
            if port.isdigit() and holder.isdigit():
                holders[int(port)] = int(holder)
        except OSError:
            continue  # it went meanwhile
    return holders


@contextlib.contextmanager
def lock_folder(folder: Path) -> Iterator[None]:
    """Hold the folder that a command writes to, which need not exist yet, for the block.

    Two commands of this user with one folder would each write the other's motion into it. The kernel gives the lock
    back as that of a port. Raises ConfigurationError naming the holder.
    """
    digest = hashlib.sha256(os.fsencode(os.path.realpath(folder))).hexdigest()[:32]
    try:
        with _held(runtime_folder() / f"folder-{digest}.lock"):
            yield
    except _HeldError as error:
        holder = "another iiwa-ident" if error.pid is None else f"another iiwa-ident (process {error.pid})"
        raise ConfigurationError(
            f"{folder} is being written to by {holder}; wait for its end or choose another folder."
        ) from error


class _HeldError(Exception):
    """A lock is held by another process. Carries its number, where it wrote it."""

    def __init__(self, pid: int | None) -> None:
        self.pid = pid
        super().__init__(f"held by process {pid}")


@contextlib.contextmanager
def _held(path: Path) -> Iterator[None]:
    descriptor = _locked(path)
    try:
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, f"{os.getpid()}\n".encode(), 0)
        yield
    finally:
        # Removed while it is held, so nobody can hold a file that is about to go.
        path.unlink(missing_ok=True)
        os.close(descriptor)


def _clear_left_behind(except_port: int) -> None:
    """Remove locks that nobody holds, and the sockets of their ports: a watcher would ask each of them in vain."""
    for path in runtime_folder().glob("*.lock"):
        kind, _, port = path.stem.partition("-")
        if kind != "folder" and (kind != "port" or not port.isdigit() or int(port) == except_port):
            continue
        sockets = (f"watch-{port}", f"daemon-{port}") if kind == "port" else ()
        with contextlib.suppress(OSError), _opened(path) as descriptor:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # One that was taken and removed meanwhile is not this one: its sockets are those of a new holder.
            if os.path.samestat(os.fstat(descriptor), path.stat()):
                for left in (*sockets, path.name):
                    path.with_name(left).unlink(missing_ok=True)


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[int]:
    descriptor = os.open(path, os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW)
    try:
        yield descriptor
    finally:
        os.close(descriptor)


def _locked(path: Path) -> int:
    """Descriptor of the locked file that stands at `path` now. Raises _HeldError."""
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            holder = os.pread(descriptor, 32, 0).decode(errors="replace").strip()
            os.close(descriptor)
            raise _HeldError(int(holder) if holder.isdigit() else None) from error
        with contextlib.suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(descriptor), path.stat()):
                return descriptor
        # Its last holder removed it between our opening and locking it.
        os.close(descriptor)
