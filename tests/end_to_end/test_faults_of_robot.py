"""The rows of the fault table that robot and wire are to blame for; two files, so that two workers share the table.

Those at a robot by the clock: see `test_faults_of_host`.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.end_to_end.fault_case import FaultCase
from tests.end_to_end.fault_cases import FAULT_CASES, ROBOT_CASES, SURVIVED, TOGETHER
from tests.end_to_end.fault_check import check


def test_the_table_names_each_fault_once() -> None:
    names = [case.name for case in FAULT_CASES]
    assert len(names) == len(set(names)) >= 30


def test_no_fault_is_left_out_of_the_runs_that_have_several() -> None:
    kinds = [each["fault"] for case in TOGETHER for each in case.faults]
    assert sorted(kinds) == sorted(each["fault"] for case in SURVIVED for each in case.faults)
    assert sum(case.gap for case in TOGETHER) == sum(case.gap for case in SURVIVED)


ALONE = [case for case in ROBOT_CASES if not case.clock and case not in SURVIVED]


@pytest.mark.parametrize("case", [*ALONE, *TOGETHER], ids=lambda case: case.name)
def test_fault(case: FaultCase, tmp_path: Path) -> None:
    check(case, tmp_path)
