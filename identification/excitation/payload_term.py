"""How well a motion shows a load: σ of its mass and centre from one run without it and one with it.

Here: the objective of `design --for payload` with its gradient, and the figures that it promises. Not here: the
weighing itself (`audit.payload`). The same motion is driven twice, so the arm's own torque is the same in both; what is
left is the load's, and what each joint's friction and offset differ by, of which nothing is known.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from identification.arrays import FloatArray
from identification.base_parameters import BaseRegressor, RegressorOptions
from identification.excitation.fourier import Trajectory
from identification.excitation.limits import ExcitationLimits
from identification.excitation.objective import BaseMatrix, Samples
from identification.excitation.prediction import NoiseColour, torque_noise
from identification.regressor import INERTIAL_SYMBOLS
from identification.robots import RobotModel

BODY = len(INERTIAL_SYMBOLS)
WANTED = 4
"""Mass and first moments; the inertia is fitted beside them."""
REACH_M = 0.1
"""A centre so far out weighs as much as the mass: 1 kg against 0.1 kg m."""
SCALE = np.array([1.0, *3 * [1.0 / REACH_M]])
ARM_RANGE_RAD = 0.35
"""How far the joints before the wrist may go from their centre."""
WRIST = 3


@dataclass(frozen=True, slots=True, eq=False)
class PayloadTerm:
    """½ log of the mean variance of mass and first moments, in kg and REACH_M kg m; a term of the objective.

    body: (p, 10) base columns of the last link's parameters. noise_nm: (n,) by which the joints' rows are weighed.
    """

    body: FloatArray
    noise_nm: FloatArray

    @classmethod
    def of(cls, robot: RobotModel, noise_nm: FloatArray) -> PayloadTerm:
        """For a robot's last link."""
        base = BaseRegressor(robot, RegressorOptions(viscous=False, coulomb=False))
        return cls(base.regrouping[:, BODY * (robot.n - 1) :], noise_nm)

    def __call__(self, samples: Samples) -> tuple[float, FloatArray, FloatArray, FloatArray]:
        """See `objective.Term`; nothing besides the matrix, whose friction columns are the motion itself."""
        rows = self._rows(samples)
        count, n, _ = rows.shape
        covariance = self.covariance(samples)
        chosen = covariance[:, :WANTED] * SCALE
        mean = float(SCALE**2 @ np.diag(covariance)[:WANTED]) / WANTED
        inner = -(chosen @ chosen.T) / (WANTED * mean * count)
        slopes = (rows @ inner) / self.noise_nm[:, None]
        own, joints = len(self.body), np.arange(n)
        by_matrix = np.zeros_like(samples.matrix)
        by_matrix[..., :own] = slopes[..., :BODY] @ self.body.T
        for kind in range(2):
            by_matrix[:, joints, own + kind * n + joints] = slopes[:, joints, BODY + kind * n + joints]
        nothing = np.zeros_like(samples.velocity)
        return 0.5 * float(np.log(mean)), by_matrix, nothing, nothing

    def covariance(self, samples: Samples) -> FloatArray:
        """(10 + 3 n, 10 + 3 n) of the body, then friction and offsets, from one row of white noise in all."""
        rows = self._rows(samples)
        stacked = rows.reshape(-1, rows.shape[2])
        gram = stacked.T @ stacked / len(rows)
        return np.asarray(np.linalg.inv(gram + np.diag(1.0 / _widths(rows.shape[1]) ** 2)))

    def _rows(self, samples: Samples) -> FloatArray:
        """(S, n, 10 + 3 n) columns of the body, then viscous and Coulomb friction and offsets, over the noise."""
        count, n, _ = samples.matrix.shape
        rows = np.zeros((count, n, BODY + 3 * n))
        rows[..., :BODY] = samples.matrix[..., : len(self.body)] @ self.body
        joints = np.arange(n)
        for kind, values in enumerate((samples.velocity, samples.sign, np.ones_like(samples.velocity))):
            rows[:, joints, BODY + kind * n + joints] = values
        return rows / self.noise_nm[:, None]


def _widths(n: int) -> FloatArray:
    """Standard deviations that keep a motion finite which shows next to nothing: far above those of a real one."""
    body = [1e3, *3 * [1e3 * REACH_M], *(BODY - WANTED) * [1e3 * REACH_M**2]]
    return np.array([*body, *3 * n * [1e4]])


@dataclass(frozen=True, slots=True)
class PayloadDeviations:
    """σ of a load weighed with this motion: mass_kg, and moment_kg_m of mass times centre, x, y, z of the last link."""

    mass_kg: float
    moment_kg_m: tuple[float, float, float]

    def center_mm(self, mass_kg: float) -> tuple[float, float, float]:
        """σ of the centre, mm, of a load whose centre is at the link's frame."""
        x, y, z = (1e3 * each / mass_kg for each in self.moment_kg_m)
        return x, y, z


def payload_deviations(
    robot: RobotModel, trajectory: Trajectory, seconds: float, *, noise_nm: FloatArray | None = None,
    colour: NoiseColour | None = None,
) -> PayloadDeviations:  # fmt: skip
    """σ from two runs of so many seconds, with and without; noise_nm, colour: as `predict_deviations` takes them."""
    noise, kind = torque_noise(robot, noise_nm), colour or NoiseColour()
    base = BaseMatrix(robot)
    rate_hz = 100.0
    times = np.arange(round(rate_hz * trajectory.period_s)) / rate_hz
    samples = base.samples(*trajectory.evaluate(times))
    term = PayloadTerm.of(robot, noise)
    # Power of the noise at the motion's own frequencies, at 1 kHz; two runs are subtracted.
    density = float(kind.density(2.0 / trajectory.period_s, 1000.0))
    covariance = 2.0 * density / (1000.0 * seconds) * term.covariance(samples)
    deviations = np.sqrt(np.diag(covariance)[:WANTED])
    return PayloadDeviations(float(deviations[0]), (float(deviations[1]), float(deviations[2]), float(deviations[3])))


def wrist_limits(limits: ExcitationLimits, center: FloatArray) -> ExcitationLimits:
    """The limits with the joints before the wrist held within ARM_RANGE_RAD of a centre (n,)."""
    arm = np.arange(limits.joints) < limits.joints - WRIST
    return replace(
        limits,
        position_lower=np.where(arm, np.maximum(limits.position_lower, center - ARM_RANGE_RAD), limits.position_lower),
        position_upper=np.where(arm, np.minimum(limits.position_upper, center + ARM_RANGE_RAD), limits.position_upper),
    )
