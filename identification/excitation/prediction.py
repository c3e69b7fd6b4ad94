"""How well a motion will determine the base parameters, before the robot moves.

Here: the standard deviations that the periodic fit will report for a given torque noise, from the same rows it solves
(spectral lines of the base regressor up to the torque bandwidth). Not here: objectives of the design (`objective`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from identification.arrays import FloatArray
from identification.base_parameters import BaseRegressor
from identification.errors import DesignError
from identification.excitation.fourier import Trajectory
from identification.robots import RobotModel
from identification.signals.periodic import PeriodicSettings, to_lines, widest_lines

DEFAULT_TORQUE_NOISE_NM = (0.17, 0.17, 0.12, 0.12, 0.08, 0.04, 0.03)
"""Standard deviation of one torque sample at 1 kHz, Nm, joints 1 to 7: the order of what iiwa joint sensors show (the
design notes' noise model). A recording of the robot at hand tells better; give its noise instead."""


@dataclass(frozen=True, slots=True)
class NoiseColour:
    """Spectrum of torque noise: a share of its variance is first-order noise below a corner, the rest white.

    The default is the design notes' noise of an iiwa. It matters: below 5 Hz, where the motion is, its density is 20
    times that of white noise with the same deviation at 1 kHz.
    """

    share: float = 0.3
    corner_hz: float = 5.0

    def __post_init__(self) -> None:
        """Raise DesignError for a share outside 0 to 1 or a corner that is not positive."""
        if not (0.0 <= self.share <= 1.0 and np.isfinite(self.corner_hz) and self.corner_hz > 0.0):
            raise DesignError("The noise's colour is a share of variance, 0 to 1, and a positive corner in Hz.")

    def density(self, frequency_hz: npt.ArrayLike, rate_hz: float) -> FloatArray:
        """Power at frequencies relative to white noise of the same variance, sampled at rate_hz; its mean is 1."""
        pole = np.exp(-2.0 * np.pi * self.corner_hz / rate_hz)
        turn = 2.0 * np.pi * np.asarray(frequency_hz, dtype=np.float64) / rate_hz
        coloured = (1.0 - pole**2) / (1.0 - 2.0 * pole * np.cos(turn) + pole**2)
        return np.asarray(1.0 - self.share + self.share * coloured, dtype=np.float64)

    def row_factor(self, rows: int, period_s: float, rate_hz: float) -> FloatArray:
        """(rows,) by which white noise grows on the rows of `to_lines`: line 0, then cosine and sine of each line."""
        return np.sqrt(self.density((np.arange(rows) + 1) // 2 / period_s, rate_hz))


@dataclass(frozen=True, slots=True, eq=False)
class PredictedDeviations:
    """names, units: of the p base parameters. std: (p,) predicted σ. noise_nm: (n,) Nm per sample, assumed.

    periods: number of periods averaged.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    std: FloatArray
    noise_nm: FloatArray
    periods: int


def torque_noise(robot: RobotModel, noise_nm: npt.ArrayLike | None = None) -> FloatArray:
    """(n,) Nm per sample: what is given, or the iiwa's for seven joints. Raises DesignError for no such noise."""
    n = robot.n
    if noise_nm is None and n != len(DEFAULT_TORQUE_NOISE_NM):
        raise DesignError(f"State the torque noise of the {n} joints of {robot.name}, Nm per sample.")
    noise = np.asarray(DEFAULT_TORQUE_NOISE_NM if noise_nm is None else noise_nm, dtype=np.float64)
    if noise.shape != (n,) or not np.all(np.isfinite(noise) & (noise > 0.0)):
        raise DesignError(f"The torque noise needs one positive number for each of the {n} joints, Nm.")
    return noise


def predict_deviations(
    regressor: BaseRegressor,
    trajectory: Trajectory,
    *,
    noise_nm: FloatArray | None = None,
    periods: int = 16,
    rate_hz: float = 1000.0,
    settings: PeriodicSettings | None = None,
    colour: NoiseColour | None = None,
) -> PredictedDeviations:
    """Standard deviations of the weighted fit on `periods` periods of a trajectory with torque noise.

    They are the Cramér–Rao bound for this noise: σ² = diag((Σ_j Y_jᵀ S_j⁻¹ Y_j)⁻¹) / periods, rows Y_j the spectral
    lines of joint j and S_j its noise power on them. noise_nm: (n,) Nm per sample at rate_hz; the iiwa's default for
    seven joints. colour: spectrum of the noise, None for the iiwa's. Errors of the model are not in it. Raises
    DesignError for a noise that does not fit the robot or a motion that leaves parameters undetermined.
    """
    settings = settings if settings is not None else PeriodicSettings()
    n = regressor.robot.n
    noise = torque_noise(regressor.robot, noise_nm)
    samples = round(trajectory.period_s * rate_hz)
    matrix = regressor.matrix(*trajectory.evaluate(np.arange(samples) / rate_hz))
    lines = widest_lines(samples, trajectory.period_s, settings)
    factor = (colour or NoiseColour()).row_factor(2 * lines + 1, trajectory.period_s, rate_hz)[:, None]
    information = np.zeros((regressor.size, regressor.size))
    for joint in range(n):
        rows = to_lines(matrix[:, joint], lines) / (noise[joint] * factor)
        information += rows.T @ rows
    norms = np.sqrt(np.diag(information))
    values, vectors = np.linalg.eigh(information / np.outer(norms, norms)) if np.all(norms > 0.0) else ([0.0], None)
    if vectors is None or values[0] <= 1e-14 * values[-1]:
        raise DesignError("The motion leaves base parameters undetermined; σ would be infinite.")
    variance = np.sum(vectors**2 / values, axis=1) / norms**2 / periods
    return PredictedDeviations(regressor.names, regressor.units, np.sqrt(variance), noise, periods)
