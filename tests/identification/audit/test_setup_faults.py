"""Claims about the benchmark of faults in real recordings (benchmarks/setup_faults.py).

Truth: the odds that a kind has beforehand, by the table of them and the number of joints.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.setup_faults import Background, Fault, known
from identification.audit.hypotheses import ODDS
from identification.recordings import read_recording
from identification.robots import load_robot
from tests.identification.audit.halves import Bench
from tests.reference import recording_file


@pytest.fixture(scope="module")
def background() -> Background:
    """A real UR10 of six joints: the second half, and a model of the first."""
    robot = recording_file("ur10_mdh.csv")
    halves = Bench.of_halves(read_recording(recording_file("ur10.npz"), robot=robot), load_robot(robot))
    return Background("ur10", halves.recording, halves.robot, halves.model, np.zeros(0), 10.0)


def faulty(background: Background, name: str) -> Fault:
    """Half a newton metre more on joint 4, said to be of this name."""
    recording = background.recording
    return Fault(replace(recording, torque=recording.torque + 0.5 * np.eye(6)[3]), ((name, 4),), None)


def test_who_does_not_know_the_kind_of_a_fault_pays_the_odds_of_its_name(background: Background) -> None:
    seen, found = known(background, faulty(background, "torque_offset"))
    assert seen > 0.0
    assert seen - found == pytest.approx(-np.log(ODDS["torque_offset"] / 6))


def test_a_fault_that_no_number_says_is_neither_seen_nor_found(background: Background) -> None:
    assert np.isnan(known(background, faulty(background, "wrong_joint_order"))).all()
