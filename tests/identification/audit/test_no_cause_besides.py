"""One thing that is different on a real arm is not told as two. Truth: the torque that was put in.

The first half of a recording of a UR10 beside a model of its second half. Their second joints differ by 3 Nm RMS.
"""

from __future__ import annotations

import importlib
from dataclasses import replace

import numpy as np
import pytest

from identification.audit.basis import Explanation
from identification.audit.between import model_of
from identification.audit.numbers import Found
from identification.recordings import read_recording
from identification.robots import load_robot
from tests.identification.audit.halves import Bench, names, torque_of_load
from tests.reference import recording_file


@pytest.fixture(scope="module")
def bench() -> Bench:
    arm = recording_file("ur10_mdh.csv")
    whole, robot = read_recording(recording_file("ur10.npz"), robot=arm), load_robot(arm)
    middle = 0.5 * float(whole.time[-1])
    return Bench(robot, model_of(whole.rows(whole.time >= middle), robot), whole.rows(whole.time < middle))


def test_without_a_fault_nothing_differs(bench: Bench) -> None:
    assert not names(bench.asked(bench.recording))


@pytest.mark.parametrize("center", [(-0.064, -0.036, 0.0), (-0.09, -0.05, 0.02), (0.0, 0.0, 0.05)])
@pytest.mark.parametrize("mass", [4.0, 5.66])
def test_a_load_taken_off_turns_no_joint(bench: Bench, mass: float, center: tuple[float, float, float]) -> None:
    """Joint 1 turned round left a little less of what the halves differ by, which the model is in doubt of anyway."""
    off = torque_of_load(bench.robot, bench.recording, mass, np.array(center))
    found = bench.with_torque(bench.recording.torque - off)
    assert names(found) == [("payload", None, 6)]
    assert found.differences[0].numbers[0].value == pytest.approx(-mass, rel=0.1)


@pytest.mark.parametrize(("viscous", "coulomb"), [(43.4, 0.0), (60.0, 0.0), (0.0, 14.5), (0.0, 20.0)])
def test_friction_that_changed_is_no_other_link(bench: Bench, viscous: float, coulomb: float) -> None:
    """A link of eight numbers took what the halves differ by, with 6 to 9 nats; no one had repaired the arm."""
    recording = bench.recording
    speed = np.gradient(recording.position[:, 1], recording.sampling_period_s)
    more = np.zeros_like(recording.torque)
    more[:, 1] = viscous * speed + coulomb * np.tanh(speed / 0.02)
    assert names(bench.asked(replace(recording, torque=recording.torque + more))) == [("friction_change", 2, None)]


def test_a_change_that_parts_of_the_recording_disagree_about_is_not_said(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A scale of 1.033 ± 0.098 was said of a sound arm: its interval held that nothing differs."""
    recording, numbers = bench.recording, importlib.import_module("identification.audit.numbers")
    speed = np.gradient(recording.position[:, 1], recording.sampling_period_s)
    torque = recording.torque + 43.4 * speed[:, None] * np.eye(6)[1]
    assert names(bench.with_torque(torque)) == [("friction_change", 2, None)]

    def disagreeing(now: Explanation) -> list[Found]:
        return [replace(each, covariance=1e3 * each.covariance) for each in numbers.found_numbers(now)]

    monkeypatch.setattr(importlib.import_module("identification.audit.audit"), "found_numbers", disagreeing)
    found = bench.with_torque(torque)
    assert not found.differences
    assert found.verdict == "unexplained"


@pytest.mark.parametrize("pair", [(2, 4), (2, 6), (3, 2)])
def test_exchanged_torques_leave_nothing_once_they_are_put_right(bench: Bench, pair: tuple[int, int]) -> None:
    """Offsets differ from day to day by a share of the joint's torque, which was that of the torque as exchanged."""
    order = np.arange(6)
    order[[pair[0] - 1, pair[1] - 1]] = order[[pair[1] - 1, pair[0] - 1]]
    assert names(bench.with_torque(bench.recording.torque[:, order])) == [("wrong_joint_order", None, None)]
