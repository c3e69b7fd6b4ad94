"""Child processes of the supervisor, and the environment every process of ours is started with."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import IO

import psutil

from daemon.errors import ChildProcessFailedError, DaemonError, LogIOError
from fri_client.handover.ring import HandoverRing


class Child:
    """A process of ours with its last words in a file; it is told the hand-over ring and who started it.

    Raises LogIOError where that file cannot be written.
    """

    def __init__(self, role: str, module: str, arguments: list[str], ring: HandoverRing, folder: Path) -> None:
        self.role = role
        self._words_file = folder / f"{role}.log"
        try:
            self._stream: IO[bytes] = self._words_file.open("ab")
        except OSError as error:
            raise LogIOError(str(self._words_file), error) from error
        told = ["--ring-fd", str(ring.fd), "--supervisor", str(os.getpid())]
        self.process = start_python(module, [*arguments, *told], self._stream, pass_fds=(ring.fd,))

    @property
    def alive(self) -> bool:
        """True while it runs."""
        return self.process.poll() is None

    @property
    def is_stopped(self) -> bool:
        """True while a signal holds it (SIGSTOP)."""
        with contextlib.suppress(psutil.Error):
            return psutil.Process(self.process.pid).status() == psutil.STATUS_STOPPED
        return False

    @property
    def last_words(self) -> str:
        """What it said on stderr, the end of it."""
        with contextlib.suppress(OSError):
            return self._words_file.read_bytes()[-2000:].decode(errors="replace")
        return ""

    def wait(self, patience_s: float) -> None:
        """Until it has ended; it is killed where it has not after so many seconds."""
        ended_within(self.process, patience_s)

    def failed(self) -> DaemonError:
        """The error that says how it ended; its own sentence where the disk refused what it had to write."""
        code, words = self.process.poll(), self.last_words
        if code == LogIOError.exit_code and words.strip():
            return LogIOError.said(words.strip().splitlines()[-1])
        return ChildProcessFailedError(self.role, code, words)

    def close(self) -> None:
        """Forget its words' file when it said nothing."""
        self._stream.close()
        with contextlib.suppress(OSError):
            if not self._words_file.stat().st_size:
                self._words_file.unlink()


def start_python(
    module: str, arguments: Sequence[str], words: IO[bytes] | int, pass_fds: Sequence[int] = ()
) -> subprocess.Popen[bytes]:
    """Start a module in its own session (no key of the terminal reaches it), with nothing to read.

    words: where it says what it says.
    """
    return subprocess.Popen(
        [sys.executable, "-m", module, *arguments], pass_fds=pass_fds, stdin=subprocess.DEVNULL, stdout=words,
        stderr=words, start_new_session=True, env=child_environment(),
    )  # fmt: skip


def how_ended(code: int) -> str:
    """The end of a sentence about a process that left no answer."""
    return f"was ended by signal {-code}" if code < 0 else f"ended with return code {code}"


def ended_within(process: subprocess.Popen[bytes], patience_s: float) -> bool:
    """Whether a process ends by itself within so many seconds; one that does not is killed. It is waited for."""
    try:
        process.wait(patience_s)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
        return False
    return True


def processes_of(module: str, folder: Path) -> list[psutil.Process]:
    """Those that were started as this module and told a file in this folder."""
    found = []
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error):
            words = process.cmdline()
            if module in words and any(Path(word).parent == folder for word in words):
                found.append(process)
    return found


def child_environment() -> dict[str, str]:
    """The environment, with this package findable even where it is not installed."""
    root = str(Path(__file__).resolve().parent.parent)
    path = os.environ.get("PYTHONPATH")
    return {**os.environ, "PYTHONPATH": f"{root}{os.pathsep}{path}" if path else root}
