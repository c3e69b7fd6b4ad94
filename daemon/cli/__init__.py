"""The command line `iiwa-ident`: parse, call, print. Nothing is computed here; each command is one call."""

from __future__ import annotations

from daemon.cli.app import main

__all__ = ["main"]
