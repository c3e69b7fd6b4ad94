"""The present as text, for reports and status files."""

from __future__ import annotations

from datetime import UTC, datetime

__all__ = ["now_text"]


def now_text() -> str:
    """The present as ISO 8601 in UTC."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")
