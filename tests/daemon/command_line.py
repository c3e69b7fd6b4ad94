"""The command line, called as a user calls it."""

from __future__ import annotations

import pytest

from daemon.cli.app import main


def run(*words: object) -> int:
    """The exit code of these words."""
    with pytest.raises(SystemExit) as end:
        main([str(word) for word in words])
    return int(end.value.code or 0)
