"""The command line `iiwa-ident`: parse, call, print. No computation lives here; each command is one call into a room."""

from __future__ import annotations

from daemon.cli.app import main

__all__ = ["main"]
