"""Claims about questions before an arm moves; truth: a terminal of the kernel, typed into before and after."""

from __future__ import annotations

import os
import pty
import select
import sys
import threading

import pytest
import typer

from daemon.cli.questions import agreed


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
