"""Claims about counts in sentences: one thing is not spoken of as several."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

from daemon.api import LoopReport
from daemon.live.event_text import event_sentence
from daemon.run.outcome import outcome_sentences
from daemon.words import counted
from fri_client.handover.ring import EventCode
from fri_client.session.link_memory import RecentLink

from .producer import make_request


def test_one_is_singular_and_all_else_is_plural() -> None:
    assert [counted(n, "period") for n in (0, 1, 2)] == ["0 periods", "1 period", "2 periods"]
    assert [counted(n, "period", verb=True) for n in (1, 2)] == ["1 period is", "2 periods are"]


def test_where_nothing_came_no_partial_recording_is_said_to_be_kept(tmp_path: Path) -> None:
    report = LoopReport(outcome="stopped", reason="", sentence="")
    for samples in (0, 1):
        said = " ".join(outcome_sentences(report, make_request(tmp_path), samples, 0, 0, ()))
        assert ("partial recording is kept" in said) == bool(samples)


def test_answers_held_back_are_told_with_the_pace_of_a_robot_whose_clock_is_not_ours(tmp_path: Path) -> None:
    for spacing, words in ((1.003, "(a message came every 1.0030 ms, and the robot states 1 ms)"), (1.00002, "")):
        report = LoopReport(
            outcome="dropped", reason="", sentence="", received=9, held_back=7, message_spacing_ms=spacing,
            send_period_ms=1.0,
        )  # fmt: skip
        said = " ".join(outcome_sentences(report, make_request(tmp_path), 9, 0, 0, ()))
        assert f"7 answers held back{' ' * bool(words)}{words}, 0 late" in said


def test_the_account_of_a_run_of_one_period_speaks_of_one(tmp_path: Path) -> None:
    report = LoopReport(outcome="stopped", reason="", sentence="", received=1, held_back=1)
    said = " ".join(outcome_sentences(report, make_request(tmp_path, periods=1), 1, 0, 0, ()))
    said += RecentLink(1, 1, None, held_back=1).clause()
    for words in ("1 monitoring message received", "1 answer held back", "1 sample recorded", "0 of 1 period is",
                  "1 message missing, 1 answer held back and"):  # fmt: skip
        assert words in said


def test_a_gap_of_one_message_speaks_of_one() -> None:
    for missing, said in ((1, "1 monitoring message is missing"), (2, "2 monitoring messages are missing")):
        record = SimpleNamespace(event_code=EventCode.GAP, event_value=float(missing), event_limit=0.0, index=7)
        assert event_sentence(record, "") == f"{said} before sample 7."  # type: ignore[arg-type]
