"""What a trajectory is worth for identification: scalars of the stacked base regressor, with exact gradients.

Here: log cond(Y_b) of eq. (13), the D criterion -log det(Y_bᵀ Y_b), the A criterion log trace((Y_bᵀ Y_b)⁻¹) and
weighted mixes of them, each with ∂/∂Y_b in closed form; the chain rule down to the coefficients of eq. (12). Not here:
bounds (`constraints`) and the search (`design`). Called by `design`, by its tests, and by whoever wants the figures of
a trajectory.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from identification.base_parameters import BaseRegressor, RegressorOptions
from identification.errors import DesignError
from identification.excitation.fourier import Trajectory, fourier_basis
from identification.excitation.regressor_adjoint import ChainRegressor
from identification.robots import RobotModel

FloatArray = npt.NDArray[np.float64]

SIGN_WIDTH_RAD_S = 0.02
"""Speed over which sign(q̇) is smoothed unless told otherwise, tanh(q̇ / width): wide enough for a hundred samples.

At the iiwa's (14) optimum it makes cond 3 % larger than the true sign() does, which all reported figures use."""

Criterion = Callable[[FloatArray], tuple[float, FloatArray]]


def log_condition_number(gram: FloatArray) -> tuple[float, FloatArray]:
    """Log cond(Y) and the matrix C with ∂/∂Y = Y C, from G = Yᵀ Y, eq. (13).

    d log σ = uᵀ dY v / σ for a singular triple, and u = Y v / σ: C = v₁ v₁ᵀ / λ₁ - v_p v_pᵀ / λ_p.
    Infinite, with C = 0, where the smallest eigenvalue is lost in rounding.
    """
    values, vectors = np.linalg.eigh(gram)
    if values[0] <= 1e-14 * values[-1]:
        return np.inf, np.zeros_like(gram)
    first, last = vectors[:, -1], vectors[:, 0]
    gradient = np.outer(first, first) / values[-1] - np.outer(last, last) / values[0]
    return 0.5 * float(np.log(values[-1] / values[0])), gradient


def negative_log_determinant(gram: FloatArray) -> tuple[float, FloatArray]:
    """-log det(G) (D criterion) and C = -2 G⁻¹ with ∂/∂Y = Y C."""
    values, vectors = np.linalg.eigh(gram)
    if values[0] <= 1e-14 * values[-1]:
        return np.inf, np.zeros_like(gram)
    return -float(np.sum(np.log(values))), -2.0 * (vectors / values) @ vectors.T


def log_trace_of_inverse(gram: FloatArray) -> tuple[float, FloatArray]:
    """Log trace(G⁻¹) (A criterion) and C = -2 G⁻² / trace(G⁻¹) with ∂/∂Y = Y C."""
    values, vectors = np.linalg.eigh(gram)
    if values[0] <= 1e-14 * values[-1]:
        return np.inf, np.zeros_like(gram)
    trace = float(np.sum(1.0 / values))
    return float(np.log(trace)), -2.0 / trace * (vectors / values**2) @ vectors.T


CRITERIA: dict[str, Criterion] = {
    "cond": log_condition_number,
    "d": negative_log_determinant,
    "a": log_trace_of_inverse,
}
"""The single objectives by the names of `design --objective`."""


def mixture_weights(text: str) -> dict[str, float]:
    """The weights of an objective's text: "cond", or a mix such as "cond:1,d:2" ("cond,d" weighs all alike).

    Raises DesignError for a name that is none of `CRITERIA`, a weight that is not positive, or a name given twice.
    """
    weights: dict[str, float] = {}
    for part in text.split(","):
        name, _, weight = part.strip().partition(":")
        try:
            value = float(weight) if weight else 1.0
        except ValueError:
            value = np.nan
        if name not in CRITERIA or name in weights or not (np.isfinite(value) and value > 0.0):
            raise DesignError(
                f"Unknown objective '{text}'; known are {', '.join(CRITERIA)} and mixes such as 'cond:1,d:2'."
            )
        weights[name] = value
    return weights


def criterion_of(text: str) -> Criterion:
    """The criterion of an objective's text, see `mixture_weights`.

    A mix adds its terms as logarithms that can be compared, each larger by 0.1 when 10 % worse: log cond, the mean of
    log σ over the p parameters (-log det / 2p), and the logarithm of the root mean square of σ (½ log(trace / p)).
    """
    weights = mixture_weights(text)
    if len(weights) == 1:
        return CRITERIA[next(iter(weights))]

    def mix(gram: FloatArray) -> tuple[float, FloatArray]:
        value, gradient = 0.0, np.zeros_like(gram)
        for name, weight in weights.items():
            term, slope = CRITERIA[name](gram)
            if not np.isfinite(term):
                return np.inf, np.zeros_like(gram)
            scale = weight * {"cond": 1.0, "d": 0.5 / len(gram), "a": 0.5}[name]
            value += scale * (term - np.log(len(gram)) if name == "a" else term)
            gradient += scale * slope
        return value, gradient

    return mix


class BaseMatrix:
    """The base regressor of one robot, eq. (7), with viscous and Coulomb columns, differentiable in the motion.

    The columns are those that `BaseRegressor` keeps, the inertial ones first; size: their number p.
    """

    def __init__(self, robot: RobotModel, *, viscous: bool = True, coulomb: bool = True) -> None:
        self.n = robot.n
        self.chain = ChainRegressor(robot.kinematics, np.asarray(robot.gravity, dtype=np.float64))
        # Without friction all columns are inertial, so `kept` counts in the 10 n columns of the chain's regressor.
        self.columns = BaseRegressor(robot, RegressorOptions(viscous=False, coulomb=False)).kept
        self.viscous, self.coulomb = viscous, coulomb
        self.size = len(self.columns) + self.n * (int(viscous) + int(coulomb))

    def matrix(self, q: FloatArray, dq: FloatArray, ddq: FloatArray, sign: FloatArray) -> FloatArray:
        """Y_b of S samples, (S, n, p): inertial base columns, then FV_1..n, then FS_1..n. sign: (S, n), of q̇."""
        return self._with_friction(self.chain.matrix(self.chain.motion(q, dq, ddq)), dq, sign)

    def value_and_gradient(
        self,
        q: FloatArray,
        dq: FloatArray,
        ddq: FloatArray,
        criterion: Criterion,
        sign_width_rad_s: float = SIGN_WIDTH_RAD_S,
    ) -> tuple[float, tuple[FloatArray, FloatArray, FloatArray]]:
        """The criterion with smoothed sign and its gradients in q, q̇, q̈, each (S, n)."""
        smooth = np.tanh(dq / sign_width_rad_s)
        motion = self.chain.motion(q, dq, ddq)
        stacked = self._with_friction(self.chain.matrix(motion), dq, smooth).reshape(-1, self.size)
        value, inner = criterion(stacked.T @ stacked)
        weights = (stacked @ inner).reshape(len(q), self.n, self.size)
        inertial = np.zeros((len(q), self.n, 10 * self.n))
        inertial[:, :, self.columns] = weights[:, :, : len(self.columns)]
        by_q, by_dq, by_ddq = self.chain.gradient(motion, inertial)
        joints = np.arange(self.n)
        start = len(self.columns)
        if self.viscous:
            by_dq = by_dq + weights[:, joints, start + joints]
            start += self.n
        if self.coulomb:
            by_dq = by_dq + weights[:, joints, start + joints] * (1.0 - smooth**2) / sign_width_rad_s
        return value, (by_q, by_dq, by_ddq)

    def _with_friction(self, full: FloatArray, dq: FloatArray, sign: FloatArray) -> FloatArray:
        matrix = np.zeros((*full.shape[:2], self.size))
        matrix[:, :, : len(self.columns)] = full[:, :, self.columns]
        joints = np.arange(self.n)
        start = len(self.columns)
        if self.viscous:
            matrix[:, joints, start + joints] = dq
            start += self.n
        if self.coulomb:
            matrix[:, joints, start + joints] = sign
        return matrix


class FourierObjective:
    """A criterion as a function of (a, b, offset) of eq. (12), sampled at equal steps over one period."""

    def __init__(
        self,
        base: BaseMatrix,
        criterion: str,
        fundamental_frequency_hz: float,
        harmonics: int,
        samples: int,
        sign_width_rad_s: float = SIGN_WIDTH_RAD_S,
    ) -> None:
        self._base = base
        self._criterion = criterion_of(criterion)
        self._sign_width = sign_width_rad_s
        times = np.arange(samples) / (samples * fundamental_frequency_hz)
        self._basis = fourier_basis(times, fundamental_frequency_hz, harmonics)

    def __call__(self, coefficients: FloatArray, offset: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """Value, gradient in coefficients (n, 2 L) = [a, b] and gradient in offset (n,)."""
        position, velocity, acceleration = self._basis
        c = coefficients.T
        value, (by_q, by_dq, by_ddq) = self._base.value_and_gradient(
            position @ c + offset, velocity @ c, acceleration @ c, self._criterion, self._sign_width
        )
        gradient = by_q.T @ position + by_dq.T @ velocity + by_ddq.T @ acceleration
        return value, gradient, by_q.sum(axis=0)


def achieved_figures(base: BaseRegressor, trajectory: Trajectory, rate_hz: float = 100.0) -> dict[str, float]:
    """What a trajectory achieves at the paper's 100 Hz with the true sign().

    Keys: cond, log_det, trace_inverse, samples, parameters (p).

    cond is the ratio of the singular values of the (n S) × p matrix itself, not of its square; all by the regressor
    that fits use, not by the one the search differentiates.
    """
    samples = max(1, round(trajectory.period_s * rate_hz))
    stacked, _ = base.stacked(*trajectory.evaluate(np.arange(samples) * (trajectory.period_s / samples)))
    singular = np.linalg.svd(stacked, compute_uv=False)
    if singular[-1] <= 0.0:
        return {
            "cond": float("inf"), "log_det": float("-inf"), "trace_inverse": float("inf"),
            "samples": samples, "parameters": base.size,
        }  # fmt: skip
    return {
        "cond": float(singular[0] / singular[-1]),
        "log_det": float(2.0 * np.sum(np.log(singular))),
        "trace_inverse": float(np.sum(singular**-2.0)),
        "samples": samples,
        "parameters": base.size,
    }
