"""What the band that `fit` chooses costs in σ, against what any estimator could reach from all rows at 1 kHz.

Truth: the Cramér-Rao bound of white noise of known size on every row, (K Σ_j Y_jᵀ Y_j / σ_j²)⁻¹ for K periods, from the
regressor of the true motion with no filter at all. The same with the rows that the pipeline keeps is what it can reach.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fixtures.physics import iiwa14_table_three
from identification.base_parameters import BaseRegressor
from identification.excitation.reference import default_trajectory
from identification.physical_parameters import PhysicalParameters
from identification.recordings import read_recording
from identification.robots import load_robot
from identification.signals.periodic import process_periodic
from tests.identification.synthetic import inverse_dynamics

NOISE_NM = np.array([0.17, 0.17, 0.12, 0.12, 0.08, 0.04, 0.03])
"""As the demo's fake robot has it, white here: a bound needs its size on every line."""
PERIODS = 4


def test_the_default_band_costs_at_most_a_twentieth_of_any_sigma(tmp_path: Path) -> None:
    robot, links = load_robot("iiwa14"), iiwa14_table_three()
    physical = PhysicalParameters(links.mass, links.center_of_mass, links.inertia, links.viscous, links.coulomb)
    motion, generator = default_trajectory(), np.random.default_rng(11)
    states = motion.evaluate(np.arange(round(1000 * motion.period_s)) * 1e-3)
    torque = np.tile(inverse_dynamics(robot, physical, *states), (PERIODS, 1))
    torque += NOISE_NM * generator.standard_normal(torque.shape)
    position = np.tile(states[0], (PERIODS, 1)) + 1e-5 * generator.standard_normal(torque.shape)
    file = tmp_path / "run.npz"
    stamps = np.arange(len(torque)) * 1e-3
    np.savez(file, t=stamps, q=position, tau=torque, period_s=motion.period_s, robot="iiwa14")
    signals, regressor = process_periodic(read_recording(file)), BaseRegressor(robot)

    def sigma(columns: np.ndarray) -> np.ndarray:
        rows = (columns / NOISE_NM[:, None]).reshape(-1, regressor.size)
        return np.sqrt(np.diag(np.linalg.inv(PERIODS * rows.T @ rows)))

    seen = regressor.matrix(signals.position, signals.velocity, signals.acceleration)
    ratio = sigma(signals.project(seen)) / sigma(regressor.matrix(*states))
    coulomb = np.array([name.startswith("FS_") for name in regressor.names])
    assert ratio.max() < 1.05
    assert np.median(ratio[coulomb]) < 1.01
