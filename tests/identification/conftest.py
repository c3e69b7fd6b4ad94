"""What the tests of identification share: the iiwa 14, the paper's tables, a rich motion."""

from __future__ import annotations

import csv
from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest

from identification.base_parameters import BaseRegressor
from identification.physical_parameters import PhysicalParameters
from identification.robots import RobotModel, load_robot
from tests.identification.synthetic import table_three
from tests.reference import TABLES

FloatArray = npt.NDArray[np.float64]
Motion = tuple[FloatArray, FloatArray, FloatArray]


def _rows(name: str) -> list[list[str]]:
    with (TABLES / name).open(newline="") as file:
        return list(csv.reader(file))[1:]


@pytest.fixture(scope="session")
def iiwa14() -> RobotModel:
    return load_robot("iiwa14")


@pytest.fixture(scope="session")
def iiwa14_base(iiwa14: RobotModel) -> BaseRegressor:
    return BaseRegressor(iiwa14)


@pytest.fixture(scope="session")
def table2() -> dict[str, float]:
    """The paper's Table 2: base parameters by name, in its order."""
    return {row[0]: float(row[1]) for row in _rows("table2_base_parameters.csv")}


@pytest.fixture(scope="session")
def table3() -> PhysicalParameters:
    """The paper's Table 3: physical parameters."""
    return table_three()


@pytest.fixture(scope="session")
def table4_base_rms() -> FloatArray:
    """The paper's Table 4, first column: RMS of each joint with the base parameters, Nm."""
    return np.array([float(row[1]) for row in _rows("table4_rms_nm.csv")[:7]])


@pytest.fixture(scope="session")
def rich_motion() -> Callable[..., Motion]:
    """(robot, samples, seed) → positions, velocities, accelerations of a random Fourier series of 10 s."""

    def motion(robot: RobotModel, samples: int = 1000, seed: int = 1) -> Motion:
        generator = np.random.default_rng(seed)
        time = np.arange(samples)[:, None] * 10.0 / samples
        q, dq, ddq = (np.zeros((samples, robot.n)) for _ in range(3))
        for harmonic in range(1, 6):
            omega = 2.0 * np.pi * 0.1 * harmonic
            amplitude = generator.normal(0.0, 0.5 / np.sqrt(harmonic), robot.n)
            phase = omega * time + generator.uniform(0.0, 2.0 * np.pi, robot.n)
            q += amplitude * np.sin(phase)
            dq += omega * amplitude * np.cos(phase)
            ddq -= omega**2 * amplitude * np.sin(phase)
        return q, dq, ddq

    return motion
