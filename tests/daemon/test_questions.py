"""Claims about questions before an arm moves; truth: a terminal of the kernel, typed into before and after."""

from __future__ import annotations

import contextlib
import os
import pty
import select
import subprocess
import sys
import threading

import pytest
import typer

from daemon.cli.questions import agreed
from tests.watchdog import WATCHDOG_S


def test_what_was_typed_before_the_question_is_no_answer_to_it(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """A second Enter after the answer to one rung of the ladder started the next one, unread."""
    ours, theirs = pty.openpty()
    with os.fdopen(ours, "wb", buffering=0) as keys, os.fdopen(theirs, encoding="utf-8") as terminal:
        keys.write(b"y\n")
        assert select.select([terminal], [], [], 10.0)[0]
        monkeypatch.setattr(sys, "stdin", terminal)
        ask, left = typer.confirm, []

        def answer(*words: object, **options: object) -> bool:
            left.extend(select.select([terminal], [], [], 0.0)[0])
            threading.Thread(target=keys.write, args=(b"n\n",)).start()
            return ask(*words, **options)  # type: ignore[arg-type]

        monkeypatch.setattr(typer, "confirm", answer)
        assert not agreed("Start")
        assert not left
        with pytest.raises(typer.Abort):
            agreed("Start", abort=True)


def test_where_there_is_no_terminal_the_question_is_asked_as_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    reads, writes = os.pipe()
    os.write(writes, b"y\n")
    os.close(writes)
    with os.fdopen(reads, encoding="utf-8") as words:
        monkeypatch.setattr(sys, "stdin", words)
        assert agreed("Start")


INTERRUPTED_AT_EVERY_MOMENT = """
import os, signal, sys, threading
from daemon.cli.questions import agreed

def interrupt(*_):
    raise KeyboardInterrupt

def press(key):
    os.write(int(sys.argv[1]), key)
    os._exit(1)

signal.signal(signal.SIGALRM, interrupt)
for place in range(1200):
    impatient = threading.Timer(20.0, press, (b"n\\n",))
    impatient.start()
    try:
        signal.setitimer(signal.ITIMER_REAL, (20 + place % 120) * 1e-6)
        agreed("Start")
    except KeyboardInterrupt:
        pass
    signal.setitimer(signal.ITIMER_REAL, 0)
    impatient.cancel()
"""


def test_a_ctrl_c_is_heard_at_whatever_moment_of_the_question_it_comes() -> None:
    """The timer's signal stands for Ctrl-C; who is not heard for 20 s presses a key. Before, a signal between Python's
    look for signals and its read was told only after that key.
    """
    ours, theirs = pty.openpty()
    command = [sys.executable, "-c", INTERRUPTED_AT_EVERY_MOMENT, str(ours)]
    with subprocess.Popen(command, stdin=theirs, stdout=theirs, stderr=theirs, pass_fds=(ours,)) as asked:
        os.close(theirs)
        shown = threading.Thread(target=_drained, args=(ours,))
        shown.start()
        asked.wait(WATCHDOG_S)
        shown.join(WATCHDOG_S)
    assert asked.returncode == 0


def _drained(terminal: int) -> None:
    """Read what is shown, until the other side is closed."""
    with contextlib.suppress(OSError):
        while os.read(terminal, 4096):
            pass
    os.close(terminal)


def test_a_ctrl_c_at_the_question_is_an_interrupt_and_no_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    """It ended `run` with 1, as a no does; truth: the table of exit codes, 130 for what was interrupted."""

    class InterruptedKeys:
        def readline(self, *_: object) -> str:
            raise KeyboardInterrupt

        def fileno(self) -> int:
            raise OSError

    monkeypatch.setattr(sys, "stdin", InterruptedKeys())
    for abort in (True, False):
        with pytest.raises(KeyboardInterrupt):
            agreed("Start", abort=abort)
