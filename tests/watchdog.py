"""How long a test waits for what will come: so long that only what never comes ends it, on however busy a machine."""

from __future__ import annotations

WATCHDOG_S = 600.0
"""Nothing is judged by it."""
