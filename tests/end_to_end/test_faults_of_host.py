"""The rows of the fault table that operator, processes, disk and settings are to blame for.

Those at a robot by the clock would grade the machine: `benchmarks.faults` has them, and in simulated time
tests/fri_client/test_adversary.py pauses a loop and lets a time stamp jump.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.end_to_end.fault_case import FaultCase
from tests.end_to_end.fault_cases_of_host import HOST_CASES
from tests.end_to_end.fault_check import check


@pytest.mark.parametrize("case", [case for case in HOST_CASES if not case.clock], ids=lambda case: case.name)
def test_fault(case: FaultCase, tmp_path: Path) -> None:
    check(case, tmp_path)
