"""Claims about what an audit says of physics that it has no name for, on an arm whose truth is known.

Truth: Pinocchio's torque of the paper's arm with noise, and Stribeck friction put on it, which is none of the audit's
differences.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fixtures.physics import iiwa14_table_three
from identification.audit import audit
from identification.audit.rows import rows_of
from identification.model_file import Model, read_model, write_model
from identification.physical_parameters import PhysicalParameters
from identification.recording_fit import FitSettings, fit_recordings
from identification.recordings import Recording, read_recording
from identification.robots import load_robot
from tests.identification.synthetic import fourier_motion, inverse_dynamics

NOISE_NM = np.array([0.17, 0.17, 0.12, 0.12, 0.08, 0.04, 0.03])
STRIBECK_NM = np.array([2.0, 3.0, 1.5, 2.0, 1.0, 0.6, 0.5])


def recorded(folder: Path, seed: int, stribeck_nm: np.ndarray | float = 0.0, width: float = 0.15) -> Recording:
    links, samples = iiwa14_table_three(), 2000
    physical = PhysicalParameters(links.mass, links.center_of_mass, links.inertia, links.viscous, links.coulomb)
    states = fourier_motion(7, period_s=20.0, samples=samples, seed=seed)
    generator = np.random.default_rng(100 + seed)
    torque = inverse_dynamics(load_robot("iiwa14"), physical, *states)
    torque += NOISE_NM * generator.standard_normal((samples, 7))
    torque += stribeck_nm * np.exp(-((np.abs(states[1]) / width) ** 1.5)) * np.tanh(states[1] / 0.002)
    file = folder / f"{seed}.npz"
    np.savez(file, t=np.arange(samples) * 0.01, q=states[0], tau=torque, robot="iiwa14")
    return read_recording(file)


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Model:
    folder = tmp_path_factory.mktemp("model")
    result = fit_recordings([recorded(folder, 21)], load_robot("iiwa14"), FitSettings(physical=False))
    return read_model(write_model(result.to_model_json(notes=False), folder / "model.json"))


def test_no_difference_is_said_that_explains_nothing(model: Model, tmp_path: Path) -> None:
    # The evidence likes friction of four joints here; on the rows that report only one of them takes anything away.
    found = audit([recorded(tmp_path, 22, 0.6 * STRIBECK_NM)], load_robot("iiwa14"), model)
    assert all(item.explained > 0.02 for item in found.differences), found.sentence
    assert {item.effect for item in found.differences} <= {"friction_change"}
    assert found.verdict in ("partly", "unexplained")


def test_a_later_torque_of_the_rows_is_that_of_the_recording_so_much_later(tmp_path: Path) -> None:
    """Truth: a sine in the band passes the filter as it is, so its later value is known in closed form."""
    time, delay = np.arange(30000) * 1e-3, 0.0237
    omega = 2.0 * np.pi * np.array([0.3, 0.7])
    file = tmp_path / "sine.npz"
    np.savez(file, t=time, q=np.sin(np.outer(time, [1.0, 1.3])), tau=np.sin(np.outer(time, omega)))
    rows = rows_of([read_recording(file)])
    at = np.concatenate([stretch.samples * stretch.step_s for stretch in rows.smooth])
    torque, rate = rows.torque_after(delay)
    assert len(at) == len(rows.block)
    inner = slice(5, -5)
    np.testing.assert_allclose(torque[inner], np.sin(np.outer(at + delay, omega))[inner], atol=2e-3)
    np.testing.assert_allclose(rate[inner], (omega * np.cos(np.outer(at + delay, omega)))[inner], atol=2e-2)
    np.testing.assert_allclose(rows.torque[inner], np.sin(np.outer(at, omega))[inner], atol=2e-3)
