"""Synthetic periodic data for the tests, made with Pinocchio's inverse dynamics: independent of our regressor.

The plant is Table 3 of the paper; the motion is a random Fourier series within modest limits. No test in here.
"""

from __future__ import annotations

import hashlib

import numpy as np
import numpy.typing as npt
import pinocchio

from identification.physical_parameters import PhysicalParameters
from identification.recordings import ImportReport, Recording, RecordingSource
from identification.robots import RobotModel
from tests.reference import TABLES

FloatArray = npt.NDArray[np.float64]


def table_three() -> PhysicalParameters:
    """The plant's true parameters, Table 3 of the paper."""
    rows: dict[str, FloatArray] = {}
    for line in (TABLES / "table3_physical_parameters.csv").read_text().splitlines()[1:]:
        name, *values = line.split(",")
        rows[name] = np.array([float(value) for value in values])
    inertia = np.zeros((7, 3, 3))
    for row, first in enumerate("xyz"):
        for column, second in enumerate("xyz"):
            name = f"I{first}{second}" if row <= column else f"I{second}{first}"
            inertia[:, row, column] = rows[name]
    center = np.column_stack([rows["lCx"], rows["lCy"], rows["lCz"]])
    return PhysicalParameters(rows["m"], center, inertia, rows["Fv"], rows["Fs"])


def fourier_motion(
    joints: int, *, period_s: float, samples: int, seed: int, speed: float = 0.6
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """One period of a random series of five harmonics: q, q̇, q̈ (samples, joints), exact. speed: rms rad/s about."""
    generator = np.random.default_rng(seed)
    time = np.arange(samples)[:, None, None] * period_s / samples
    w = 2.0 * np.pi / period_s * np.arange(1, 6)
    a, b = generator.normal(scale=speed / np.sqrt(5.0), size=(2, joints, 5))
    sine, cosine = np.sin(w * time), np.cos(w * time)
    offset = generator.uniform(-0.3, 0.3, joints)
    position = (a / w * sine - b / w * cosine).sum(axis=2) + offset
    return position, (a * cosine + b * sine).sum(axis=2), (w * (b * cosine - a * sine)).sum(axis=2)


def inverse_dynamics(
    robot: RobotModel, plant: PhysicalParameters, q: FloatArray, dq: FloatArray, ddq: FloatArray
) -> FloatArray:
    """Torque by Pinocchio's recursive Newton-Euler algorithm plus viscous and Coulomb friction, (S, n) Nm."""
    model = robot.pinocchio_model.copy()
    for link in range(plant.n):
        model.inertias[link + 1] = pinocchio.Inertia(
            float(plant.mass[link]), plant.center_of_mass[link], plant.inertia[link]
        )
    data = model.createData()
    torque = np.array([pinocchio.rnea(model, data, *state) for state in zip(q, dq, ddq, strict=True)])
    return torque + plant.viscous * dq + plant.coulomb * np.sign(dq)


def recording_of(
    position: FloatArray,
    torque: FloatArray,
    *,
    period_s: float,
    periods: int = 1,
    robot: str = "iiwa14",
    kind: str = "log",
) -> Recording:
    """A Recording with labels from rows laid out period after period, (periods · M, n)."""
    rows = position.shape[0]
    per_period = rows // periods
    step = period_s / per_period
    return Recording(
        time=np.arange(rows) * step,
        position=position,
        torque=torque,
        sampling_period_s=step,
        source=RecordingSource("synthetic.mcap", hashlib.sha256(torque.tobytes()).hexdigest(), kind),
        report=ImportReport(rows, rows),
        robot=robot,
        period_index=np.arange(rows) // per_period,
        sample_in_period=np.arange(rows) % per_period,
        period_s=period_s,
        samples_per_period=per_period,
    )


def coloured_noise(shape: tuple[int, int], *, deviation: float, correlation: float, seed: int) -> FloatArray:
    """First-order autoregressive noise along axis 0 with that standard deviation and correlation of neighbours."""
    generator = np.random.default_rng(seed)
    white = generator.normal(size=shape)
    result = np.empty(shape)
    result[0] = white[0]
    for row in range(1, shape[0]):
        result[row] = correlation * result[row - 1] + np.sqrt(1.0 - correlation**2) * white[row]
    return deviation * result
