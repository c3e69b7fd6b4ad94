"""The rigid torque of a displaced joint, from a few places of it. Truth: Pinocchio at the displaced motion."""

from __future__ import annotations

import numpy as np
import pytest

from identification.mismatch.effects.displaced_torque import change_of_torque
from identification.robots import load_robot
from tests.identification.mismatch.effects.motions import (
    motion_of,
    pinocchio_model,
    pinocchio_torque,
    random_links,
    sliding_robot,
)


@pytest.mark.parametrize("size", [1e-3, 2.0])
@pytest.mark.parametrize("arm", ["iiwa14", "sliding"])
def test_any_displacement_of_any_joint_is_inverse_dynamics(arm: str, size: float) -> None:
    robot = sliding_robot() if arm == "sliding" else load_robot(arm)
    links = random_links(robot.n, 3)
    motion = motion_of(robot, links, rate_hz=20.0)
    model = pinocchio_model(robot, links)
    still = pinocchio_torque(model, motion.position, motion.velocity, motion.acceleration)
    random = np.random.default_rng(0)
    for joint in range(robot.n):
        displacement, rate, growth = (size * factor * random.normal(size=motion.samples) for factor in (1.0, 3.0, 9.0))
        places = [
            values + np.outer(change, np.eye(robot.n)[joint])
            for values, change in zip(
                (motion.position, motion.velocity, motion.acceleration), (displacement, rate, growth), strict=True
            )
        ]
        truth = pinocchio_torque(model, *places)
        change = change_of_torque(motion, joint, displacement, rate, growth)
        np.testing.assert_allclose(change, truth - still, atol=1e-11 * np.abs(truth).max(), rtol=0.0)
        assert np.abs(change).max() > 0.0
