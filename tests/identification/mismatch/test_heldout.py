"""What a model leaves on held-out recordings. Truth: SciPy's normal distribution, and draws from it."""

from __future__ import annotations

import numpy as np
import pytest

from identification.mismatch.heldout import Residuals

JOINTS, ROWS, DIRECTIONS = 2, 15, 3


def drawn(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Sensor noise (n, R) Nm, scatter (n, R, k) Nm: a few times the noise along three directions."""
    random = np.random.default_rng(seed)
    noise = random.uniform(0.5, 2.0, (JOINTS, ROWS))
    return noise, random.normal(size=(JOINTS, ROWS, DIRECTIONS)) * noise[..., None]


def left(rows: np.ndarray, noise: np.ndarray, scatter: np.ndarray) -> Residuals:
    wide = np.sqrt(noise**2 + (scatter**2).sum(axis=2))
    return Residuals(rows=rows, noise=wide, sensor_noise=noise, used=noise > 0.0, samples=1, scatter=scatter)


def test_excess_energy_scatters_as_much_as_it_says_where_few_parameters_move_all_rows() -> None:
    noise, scatter = drawn(5)
    random = np.random.default_rng(6)
    parameters = random.normal(size=(20_000, DIRECTIONS))
    rows = noise * random.normal(size=(20_000, *noise.shape)) + np.einsum("nrk,sk->snr", scatter, parameters)
    model = left(np.zeros_like(noise), noise, scatter)
    energies = (rows**2 - model.noise**2).sum(axis=2)
    assert energies.std(axis=0) == pytest.approx(model.excess_deviation, rel=0.05)
