"""For every test: none that draws its cases is judged by how long the machine takes, each begins loud and leaves the
signals as they were, and a hang-up does what it does in a terminal.
"""

from __future__ import annotations

import gc
import signal
import sys
from collections.abc import Iterator

import pytest
from hypothesis import HealthCheck, settings

settings.register_profile("any machine", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("any machine")

# A suite that was started with nohup, or in the background of a script, ignores them, and so would all its children.
signal.signal(signal.SIGHUP, signal.SIG_DFL)
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_finish() -> None:
    """All tests and what they load stay to the end: no look for circles has to go through them, a quarter of a second
    each time, as it would not in a process that runs one thing.
    """
    gc.collect()
    gc.freeze()


@pytest.fixture(autouse=True)
def loud() -> Iterator[None]:
    """A command with --quiet that runs in this process leaves it quiet: the next test would see no progress."""
    yield
    if (output := sys.modules.get("daemon.cli.output")) is not None:
        output.set_verbosity(0, False)


@pytest.fixture(autouse=True)
def signals_as_before() -> Iterator[None]:
    """A handler that a test leaves behind takes the Ctrl-C of the next one, which then waits for it for ever."""
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = [signal.getsignal(number) for number in numbers]
    yield
    assert [signal.getsignal(number) for number in numbers] == before
