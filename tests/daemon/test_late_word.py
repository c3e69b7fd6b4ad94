"""Claims about a supervisor that was held (SIGTSTP, SIGSTOP) while its run ended: what it hears late still counts.

Truth: the order of what is heard, which this test gives out itself.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from daemon.control_messages import ControlMessage, RecorderFinished
from daemon.run.service import _Acquisition
from daemon.stop_handle import StopHandle

from .service_runs import gentle_request


class LateInbox:
    """Hands out one batch each time it is asked."""

    def __init__(self, *batches: list[ControlMessage]) -> None:
        self._batches = iter(batches)

    def receive(self, timeout_s: float) -> Iterator[ControlMessage]:
        del timeout_s
        yield from next(self._batches)


def test_a_recorder_that_ended_well_is_not_replaced_before_its_last_word_is_heard(tmp_path: Path) -> None:
    """Else an empty second part is left behind, and the run says that its recorder was lost."""
    last = RecorderFinished(
        part=0, samples=5, samples_in_periods=0, last_index=4, sequence_gaps=0, handover_gaps=0
    )  # fmt: skip
    closed: list[bool] = []
    recorder: Any = SimpleNamespace(
        alive=False, process=SimpleNamespace(returncode=0), wait=lambda _: 0, close=lambda: closed.append(True)
    )  # fmt: skip
    run = _Acquisition(gentle_request(tmp_path, 1), lambda _: None, StopHandle())
    inbox: Any = LateInbox([], [], [], [last])
    run._inbox, run._recorder, run._parts = inbox, recorder, [tmp_path / "recording.mcap"]
    run._watch_recorder()
    run._finish_recording()
    run._end_recorder()  # as once the books are closed
    assert run._finished == {0: last}
    assert run._parts == [tmp_path / "recording.mcap"]
    assert closed == [True]
