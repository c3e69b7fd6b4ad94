"""What every test may use: the folder of reference material beside the checkout, where there is one; and no test that
draws its cases is judged by how long the machine takes.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

REPOSITORY = Path(__file__).resolve().parent.parent

settings.register_profile("any machine", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("any machine")


@pytest.fixture(scope="session")
def shared_folder() -> Path:
    """The folder `shared` beside the checkout: golden datagrams, tables, real recordings. Skips where it is absent."""
    folder = REPOSITORY.parent / "shared"
    if not folder.is_dir():
        pytest.skip("no folder 'shared' beside the checkout (real recordings and reference tables are not shipped)")
    return folder


@pytest.fixture(autouse=True)
def loud() -> Iterator[None]:
    """A command with --quiet that runs in this process leaves it quiet: the next test would see no progress."""
    yield
    if (output := sys.modules.get("daemon.cli.output")) is not None:
        output.set_verbosity(0, False)
