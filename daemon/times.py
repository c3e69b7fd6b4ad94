"""The present as text, for reports and status files."""

from __future__ import annotations

from collections.abc import Container
from datetime import UTC, datetime


def now_text() -> str:
    """The present as ISO 8601 in UTC."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


def new_job_id(taken: Container[str]) -> str:
    """A number that sorts by time and is not taken: 20261121T103000123Z, then ...123Z-1."""
    now = datetime.now(UTC)
    first = now.strftime("%Y%m%dT%H%M%S") + f"{now.microsecond // 1000:03d}Z"
    job_id, count = first, 0
    while job_id in taken:
        count += 1
        job_id = f"{first}-{count}"
    return job_id
