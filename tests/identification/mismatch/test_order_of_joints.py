"""The order of torques on an arm of few joints. Truth: torques by the closed form, two of them exchanged."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from identification.mismatch.set_up import examine_set_up
from identification.robots import load_robot
from tests.identification.exported import random_arm, random_bodies
from tests.identification.synthetic import fourier_motion, inverse_dynamics, recording_of


@pytest.mark.parametrize("seed", [0, 3, 7])
def test_two_torques_exchanged_on_an_arm_of_three_joints_are_told(seed: int, tmp_path: Path) -> None:
    """The columns of a joint take more than half of any torque here, and those of the right one all of it."""
    file = tmp_path / "arm.urdf"
    file.write_text(random_arm(3, seed))
    robot = load_robot(file)
    states = fourier_motion(3, period_s=20.0, samples=4000, seed=seed)
    torque = inverse_dynamics(robot, random_bodies(3, seed), *states)
    torque += 0.01 * np.random.default_rng(seed).standard_normal(torque.shape)
    sound = recording_of(states[0], torque, period_s=20.0)
    exchanged = replace(sound, torque=torque[:, [1, 0, 2]])
    found, right = ({item.name: item for item in examine_set_up([each], robot)} for each in (exchanged, sound))
    assert found["order of joints"].status == "failed"
    assert "that of joint 1 stands under joint 2" in found["order of joints"].sentence
    assert found["torque signs"].status != "failed"
    assert {right[name].status for name in ("order of joints", "torque signs")} == {"ok"}
