"""The rows of the fault table that operator, processes, disk and settings are to blame for.

Those at a robot by the clock would grade the machine: `benchmarks.faults` has them, and in simulated time
tests/fri_client/test_adversary.py pauses a loop and lets a time stamp jump. What is asked where a process is killed,
beyond its row, stands here too: the recording read back by rosbags, and the reports.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

from daemon.api import RunOutcome
from daemon.json_files import read_json
from tests.daemon.recorder_results import read_events, read_states
from tests.daemon.service_runs import assert_nothing_missing
from tests.end_to_end.fault_case import FaultCase
from tests.end_to_end.fault_cases_of_host import HOST_CASES
from tests.end_to_end.fault_check import check


def a_killed_recorder_costs_no_sample(folder: Path) -> None:
    outcome = read_json(folder / "run.json", RunOutcome)
    assert outcome.loop is not None
    assert (outcome.loop.reason, outcome.loop.standstill_confirmed) == ("RECORDER_LOST", True)
    log = Path(outcome.recordings[0])
    assert log == folder / "recording.mcap"
    assert_nothing_missing(log)
    assert len(read_states(log)) == outcome.loop.received
    assert "RECORDER_LOST" in {event.name for event in read_events(log)}


def a_killed_loop_leaves_a_whole_recording_and_the_truth_about_it(folder: Path) -> None:
    outcome = read_json(folder / "run.json", RunOutcome)
    assert "killed by signal 9" in outcome.sentences[0]
    log = Path(outcome.recordings[0])
    states = read_states(log)
    assert_nothing_missing(log)
    assert outcome.samples == len(states)
    # What the loop saw last comes from its ring, and stands in the log as well.
    kept = json.loads((folder / "last_samples.json").read_text())
    assert kept["reason"] == "LOOP_LOST"
    assert kept["columns"]["measured_position"][-1] == pytest.approx(list(states[-1].measured_joint_position))
    with log.open("rb") as stream:
        assert "last_samples.json" in {each.name for each in make_reader(stream).iter_attachments()}


def a_killed_supervisor_leaves_a_whole_file(folder: Path) -> None:
    assert report_of_a_whole_file(folder)["reason"] == "SUPERVISOR_LOST"


def with_the_recorder_killed_as_well_the_loop_closes_the_books(folder: Path) -> None:
    assert report_of_a_whole_file(folder)["reason"] in ("SUPERVISOR_LOST", "RECORDER_LOST")
    assert "Supervisor and recorder were gone" in (folder / "loop.log").read_text()


def report_of_a_whole_file(folder: Path) -> dict[str, Any]:
    report: dict[str, Any] = json.loads((folder / "loop_report.json").read_text())
    assert report["standstill_confirmed"]
    assert_nothing_missing(folder / "recording.mcap")
    assert len(read_states(folder / "recording.mcap")) == report["received"]
    return report


MORE: dict[str, Callable[[Path], None]] = {
    "kill-recorder-excitation": a_killed_recorder_costs_no_sample,
    "kill-loop-excitation": a_killed_loop_leaves_a_whole_recording_and_the_truth_about_it,
    "kill-supervisor-excitation": a_killed_supervisor_leaves_a_whole_file,
    "kill-recorder-supervisor": with_the_recorder_killed_as_well_the_loop_closes_the_books,
}


@pytest.mark.parametrize("case", [case for case in HOST_CASES if not case.clock], ids=lambda case: case.name)
def test_fault(case: FaultCase, tmp_path: Path) -> None:
    check(case, tmp_path)
    MORE.get(case.name, lambda _: None)(tmp_path / "run")


def test_more_is_asked_of_rows_that_there_are() -> None:
    assert MORE.keys() <= {case.name for case in HOST_CASES if not case.clock}
