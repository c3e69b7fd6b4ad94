"""The rows of the fault table that operator, processes, disk and settings are to blame for."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.end_to_end.fault_case import FaultCase
from tests.end_to_end.fault_cases_of_host import HOST_CASES
from tests.end_to_end.fault_check import check


@pytest.mark.parametrize("case", HOST_CASES, ids=lambda case: case.name)
def test_fault(case: FaultCase, tmp_path: Path) -> None:
    check(case, tmp_path)
