"""The rows of the fault table that robot and wire are to blame for; two files, so that two workers share the table."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.end_to_end.fault_case import FaultCase
from tests.end_to_end.fault_cases import FAULT_CASES, ROBOT_CASES
from tests.end_to_end.fault_check import check


def test_the_table_names_each_fault_once() -> None:
    names = [case.name for case in FAULT_CASES]
    assert len(names) == len(set(names)) >= 30


STOPPED_WITHIN_ONE_CYCLE = ("counter-jump", "counter-jump-far", "counter-restart")
"""The loop takes a gap of the counter as lost time without asking the robot's clock; the judge sees it."""


def marked(case: FaultCase) -> object:
    known = case.name in STOPPED_WITHIN_ONE_CYCLE
    return pytest.param(case, id=case.name, marks=[pytest.mark.xfail(reason="stops within one cycle")] if known else [])


@pytest.mark.parametrize("case", map(marked, ROBOT_CASES))
def test_fault(case: FaultCase, tmp_path: Path) -> None:
    check(case, tmp_path)
