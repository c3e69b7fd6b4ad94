"""How good the link was while a log was recorded, from the report that the log carries as an attachment.

Here: reading that one attachment and putting it into words. Logs without it, or files of others, have no link to judge.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap.records import Attachment

from identification.recordings.mcap_records import attachment_of
from identification.report.numbers import rounded

ATTACHMENT = "loop_report.json"
_RECORD_HEAD_BYTES = 9
"""Kind and length of an MCAP record, before its content."""


def read_loop_report(file: Path) -> Mapping[str, Any] | None:
    """The acquisition's own account inside an MCAP log; None where there is none or it cannot be read."""
    if file.suffix.lower() != ".mcap" or not file.is_file():
        return None
    try:
        with file.open("rb") as stream:
            summary = make_reader(stream).get_summary()
            for index in () if summary is None else summary.attachment_indexes:
                if index.name == ATTACHMENT:
                    stream.seek(index.offset + _RECORD_HEAD_BYTES)
                    found = attachment_of(stream.read(index.length - _RECORD_HEAD_BYTES))
                    report = json.loads(found.data) if isinstance(found, Attachment) else None
                    return report if isinstance(report, Mapping) else None
    except Exception:  # the library leaks errors of its decoders; a log that breaks off has no closing attachments
        return None
    return None


def link_sentence(report: Mapping[str, Any]) -> str:
    """Whether every message of the robot arrived, was answered in time and was recorded."""
    faults = [
        f"{report[name]} {words}"
        for name, words in (
            ("missing", "missing"),
            ("late", "answered late"),
            ("lost_in_handover", "not recorded"),
            ("undecodable", "not readable"),
            ("refused", "not usable"),
        )
        if report.get(name)
    ]
    received = report.get("received", 0)
    if not faults:
        return f"The link was clean: all {received} messages of the robot arrived, were answered in time and recorded."
    return f"Of {received} messages received from the robot: {', '.join(faults)}."


def link_facts(report: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Counters and times of the link as terms with texts."""
    names = ("received", "answered", "late", "missing", "duplicates", "stale", "refused", "undecodable", "foreign")
    facts = [("Messages", ", ".join(f"{report[name]} {name}" for name in names if name in report))]
    for name, title in (("turn_around", "Answered within"), ("jitter", "Jitter of arrival")):
        histogram = report.get(name) or {}
        shares = _quantiles(histogram.get("edges_us") or (), histogram.get("counts") or (), (0.5, 0.99, 1.0))
        if shares:
            half, most, last = (f"{rounded(value)} µs" for value in shares)
            facts.append((title, f"{half} (half of them), {most} (99 %), {last} (all)"))
    if report.get("sentence"):
        facts.append(("End of the motion", str(report["sentence"])))
    return facts


def _quantiles(edges: Sequence[float], counts: Sequence[int], shares: Sequence[float]) -> list[float]:
    """Upper edges of the bins that hold these shares; the last bin is open, its lower edge stands for it."""
    total = sum(counts)
    if not total or len(edges) != len(counts):
        return []
    found = []
    for share in shares:
        reached, index = 0, 0
        while index < len(counts) - 1 and reached + counts[index] < share * total:
            reached += counts[index]
            index += 1
        found.append(float(edges[min(index + 1, len(edges) - 1)]))
    return found
