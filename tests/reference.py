"""What others measured and published, for every test: real recordings, the paper's tables, golden datagrams."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from fixtures.real_recordings import real_recording

TABLES = Path(__file__).parent / "identification" / "data"
"""Tables 1 to 4 of the paper (README.md beside them)."""


ARM_OF = {
    "kr300_a": "kr300.urdf",
    "kr300_b": "kr300.urdf",
    "tx40_excitation": "tx40.urdf",
    "lbrmed7": "med7dock.urdf",
    "ur10": "ur10_mdh.csv",
    "emps_a": "emps.urdf",
    "emps_b": "emps.urdf",
    "panda_excitation": "panda.urdf",
}
"""Of each real recording the file of its arm."""
NOT_SHIPPED = ("panda_excitation.npz", "panda.urdf")
"""Under a licence (GPL) that does not let them come along."""


def recording_file(name: str) -> Path:
    """Path of a real recording or of its arm's file; skips the test where it is one of NOT_SHIPPED and not here.

    Raises FileNotFoundError for any other that is missing.
    """
    try:
        return real_recording(name)
    except FileNotFoundError as error:
        if name not in NOT_SHIPPED:
            raise
        pytest.skip(f"{error}: its licence (GPL) does not let it come along")


def golden_datagrams() -> dict[str, Any]:
    """Datagrams that the vendor's own client wrote, by version of FRI (tests/data/fri_vectors.json)."""
    text = (Path(__file__).parent / "data" / "fri_vectors.json").read_text(encoding="utf-8")
    versions: dict[str, Any] = json.loads(text)["versions"]
    return versions
