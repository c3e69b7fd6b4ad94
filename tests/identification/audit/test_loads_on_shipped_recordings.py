"""Claims about loads on a real arm whose recording is shipped: a Stäubli TX40, torque by motor current.

Truth: Pinocchio's Newton-Euler of the load alone, added to the second half; the model is of the first.
Of 3.7 s each: they tell a mass within a fifth, so what is asked is that the interval says so.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from identification.recordings import read_recording
from identification.robots import load_robot
from tests.identification.audit.halves import Bench, names, torque_of_load

RECORDINGS = Path(__file__).resolve().parents[3] / "fixtures" / "recordings"


@pytest.fixture(scope="module")
def tx40() -> Bench:
    robot = RECORDINGS / "tx40.urdf"
    return Bench.of_halves(read_recording(RECORDINGS / "tx40_excitation.npz", robot=robot), load_robot(robot))


@pytest.mark.parametrize("mass", [2.0, -2.0])
def test_a_load_is_named_alone_with_its_mass(tx40: Bench, mass: float) -> None:
    load = torque_of_load(tx40.robot, tx40.recording, abs(mass), np.array([0.02, -0.03, 0.08])) * np.sign(mass)
    found = tx40.with_torque(tx40.recording.torque + load)
    assert names(found) == [("payload", None, 6)]
    (number, *_) = found.differences[0].numbers
    low, high = number.interval
    assert low < mass < high
    assert high - low < 0.6 * abs(mass)


def test_without_a_load_nothing_is_named(tx40: Bench) -> None:
    assert tx40.asked(tx40.recording).differences == ()
