"""How good the link was, read out of logs as the mcap library writes them, and put into plain words."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from mcap.writer import Writer

from identification.report.link import link_facts, link_sentence, read_loop_report

CLEAN: dict[str, Any] = {"received": 1000, "answered": 1000, "late": 0, "missing": 0, "lost_in_handover": 0}


def log_with(file: Path, **attachments: bytes) -> Path:
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2")
        for name, data in attachments.items():
            writer.add_attachment(0, 0, name.replace("_json", ".json"), "application/json", data)
        writer.finish()
    return file


def test_report_is_found_among_the_attachments(tmp_path: Path) -> None:
    log = log_with(tmp_path / "a.mcap", host_json=b"{}", loop_report_json=json.dumps(CLEAN).encode())
    assert read_loop_report(log) == CLEAN


@pytest.mark.parametrize("content", [b"", b"no mcap at all", b"\x89MCAP0\r\n"])
def test_a_file_that_tells_nothing_is_no_error(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "broken.mcap").write_bytes(content)
    assert read_loop_report(tmp_path / "broken.mcap") is None
    assert read_loop_report(tmp_path / "absent.mcap") is None
    assert read_loop_report(log_with(tmp_path / "b.mcap", loop_report_json=b"[1, 2")) is None
    assert read_loop_report(log_with(tmp_path / "c.mcap", loop_report_json=b"[1, 2]")) is None


def test_a_clean_link_is_called_clean_and_each_fault_is_counted() -> None:
    assert "clean: all 1000 messages" in link_sentence(CLEAN)
    sentence = link_sentence({**CLEAN, "missing": 3, "late": 7, "lost_in_handover": 1})
    assert "clean" not in sentence
    assert "3 missing, 7 answered late, 1 not recorded" in sentence


def test_times_are_upper_bounds_from_the_histogram() -> None:
    # 990 of 1000 answers took 10 to 20 µs, 9 took 20 to 30, one more than 30.
    histogram = {"edges_us": [10.0, 20.0, 30.0], "counts": [990, 9, 1]}
    facts = dict(link_facts({**CLEAN, "turn_around": histogram}))
    assert facts["Answered within"] == "20.0 µs (half of them), 20.0 µs (99 %), 30.0 µs (all)"
    assert "Jitter of arrival" not in facts
