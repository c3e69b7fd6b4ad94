"""Claims about motions that weigh a tool.

Truth: finite differences; least squares on drawn noise, whose scatter the promised σ foretells.
"""

from __future__ import annotations

import numpy as np
import pytest

from identification.excitation import default_trajectory, iiwa_limits
from identification.excitation.objective import BaseMatrix
from identification.excitation.payload_term import PayloadTerm, payload_deviations, wrist_limits
from identification.excitation.prediction import NoiseColour
from identification.regressor import torque_regressor
from identification.robots import RobotModel

NOISE_NM = np.array([0.17, 0.17, 0.12, 0.12, 0.08, 0.04, 0.03])


def test_the_gradient_is_that_of_finite_differences(iiwa14: RobotModel) -> None:
    base, term = BaseMatrix(iiwa14), PayloadTerm.of(iiwa14, NOISE_NM)
    motion = default_trajectory().evaluate(np.arange(60) / 6.0)
    _, gradients = base.value_and_gradient(*motion, [term])
    generator = np.random.default_rng(2)
    for kind, gradient in enumerate(gradients):
        for _ in range(3):
            place = (int(generator.integers(60)), int(generator.integers(7)))
            values = []
            for step in (1e-5, -1e-5):
                moved = [each.copy() for each in motion]
                moved[kind][place] += step
                values.append(term(base.samples(*moved))[0])
            assert gradient[place] == pytest.approx((values[0] - values[1]) / 2e-5, rel=1e-4, abs=1e-8)


def test_the_promised_deviation_is_the_scatter_of_weighings(iiwa14: RobotModel) -> None:
    white, seconds, rate_hz, draws = NoiseColour(0.0, 5.0), 10.0, 100.0, 400
    trajectory = default_trajectory()
    # White noise of a density: ten times fewer samples a second, each with a tenth of the variance.
    promised = payload_deviations(iiwa14, trajectory, seconds, noise_nm=NOISE_NM, colour=white)
    q, dq, ddq = trajectory.evaluate(np.arange(round(seconds * rate_hz)) / rate_hz)
    rows = np.zeros((len(q), 7, 10 + 21))
    rows[..., :10] = torque_regressor(iiwa14, q, dq, ddq)[..., 60:]
    for joint in range(7):
        rows[:, joint, 10 + joint] = dq[:, joint]
        rows[:, joint, 17 + joint] = np.tanh(dq[:, joint] / 0.02)
        rows[:, joint, 24 + joint] = 1.0
    stacked = (rows / NOISE_NM[:, None]).reshape(-1, 31)
    seen = np.linalg.pinv(stacked)[:4]
    noise = np.random.default_rng(3).standard_normal((len(stacked), draws)) * np.sqrt(2.0 * rate_hz / 1000.0)
    scatter = (seen @ noise).std(axis=1)
    np.testing.assert_allclose([promised.mass_kg, *promised.moment_kg_m], scatter, rtol=0.15)


def test_the_arm_before_the_wrist_hardly_moves() -> None:
    limits = wrist_limits(iiwa_limits("iiwa14"), np.zeros(7))
    np.testing.assert_allclose(limits.position_upper[:4], 0.35)
    np.testing.assert_allclose(limits.position_lower[:4], -0.35)
    np.testing.assert_allclose(limits.position_upper[4:], iiwa_limits("iiwa14").position_upper[4:])
