"""What a trajectory is worth for identification: scalars of the stacked base regressor, with exact gradients.

Here: log cond(Y_b) of eq. (13), the D criterion -log det(Y_bᵀ Y_b), the A criterion log trace((Y_bᵀ Y_b)⁻¹) and
weighted mixes of them, each with ∂/∂Y_b in closed form; the chain rule down to the coefficients of eq. (12), also for
terms from elsewhere. Not here: those terms (`detectability_term`, `nominal`), bounds (`constraints`) and the search
(`design`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from identification.arrays import FloatArray
from identification.base_parameters import BaseRegressor, RegressorOptions
from identification.errors import DesignError
from identification.excitation.fourier import Trajectory, fourier_basis
from identification.excitation.regressor_adjoint import ChainMotion, ChainRegressor
from identification.robots import RobotModel

SIGN_WIDTH_RAD_S = 0.02
"""Speed over which sign(q̇) is smoothed unless told otherwise, tanh(q̇ / width): wide enough for a hundred samples.

At the iiwa's (14) optimum it makes cond 3 % larger than the true sign() does, which all reported figures use."""

Criterion = Callable[[FloatArray], tuple[float, FloatArray]]


def log_condition_number(gram: FloatArray, sharpness: float | None = None) -> tuple[float, FloatArray]:
    """Log cond(Y) and the matrix C with ∂/∂Y = Y C, from G = Yᵀ Y, eq. (13).

    d log σ = uᵀ dY v / σ for a singular triple, and u = Y v / σ: C = v₁ v₁ᵀ / λ₁ - v_p v_pᵀ / λ_p.
    Infinite, with C = 0, where the smallest eigenvalue is lost in rounding. With a sharpness s the means
    (Σ λˢ)^(1/s) and (Σ λ⁻ˢ)^(-1/s) stand for the largest and the smallest eigenvalue: where the smallest ones meet, at
    every good motion, cond has an edge along which a descent creeps, and these have none.
    """
    values, vectors = np.linalg.eigh(gram)
    if values[0] <= 1e-14 * values[-1]:
        return np.inf, np.zeros_like(gram)
    if sharpness is not None:
        upper, lower = (values / values[-1]) ** sharpness, (values[0] / values) ** sharpness
        ratio = np.log(values[-1] / values[0]) + (np.log(upper.sum()) + np.log(lower.sum())) / sharpness
        weights = (upper / upper.sum() - lower / lower.sum()) / values
        return 0.5 * float(ratio), (vectors * weights) @ vectors.T
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
"""The objectives of the base regressor alone, by the names of `design --objective`."""

DETECTABILITY = "detectability"
"""Name of the objective that needs a prior of the arm, see `detectability_term`."""
PAYLOAD = "payload"
"""Name of the objective that is a load's mass and centre, see `payload_term`."""
OTHERS = (DETECTABILITY, PAYLOAD)
"""Objectives that are no function of the Gram of the base regressor."""


def mixture_weights(text: str) -> dict[str, float]:
    """The weights of an objective's text: "cond", or a mix such as "cond:1,d:2" ("cond,d" weighs all alike).

    Raises DesignError for a name that is neither of `CRITERIA` nor of `OTHERS`, for a weight that is not positive,
    or for a name given twice.
    """
    weights: dict[str, float] = {}
    for part in text.split(","):
        name, _, weight = part.strip().partition(":")
        try:
            value = float(weight) if weight else 1.0
        except ValueError:
            value = np.nan
        if name not in (*CRITERIA, *OTHERS) or name in weights or not (np.isfinite(value) and value > 0.0):
            raise DesignError(
                f"Unknown objective '{text}'; known are {', '.join((*CRITERIA, *OTHERS))} and mixes such as "
                "'cond:1,d:2'."
            )
        weights[name] = value
    return weights


def criterion_of(text: str, sharpness: float | None = None) -> Criterion:
    """The criterion of an objective's text, see `mixture_weights`; without `OTHERS`. sharpness: of cond.

    A mix adds its terms as logarithms that can be compared, each larger by 0.1 when 10 % worse: log cond, the mean of
    log σ over the p parameters (-log det / 2p), and the logarithm of the root mean square of σ (½ log(trace / p)).
    """
    weights = mixture_weights(text)
    criteria = _criteria(sharpness)
    return criteria[next(iter(weights))] if len(weights) == 1 else _mix(weights, criteria)


def _criteria(sharpness: float | None) -> Mapping[str, Criterion]:
    return CRITERIA if sharpness is None else {**CRITERIA, "cond": lambda gram: log_condition_number(gram, sharpness)}


def _mix(weights: dict[str, float], criteria: Mapping[str, Criterion]) -> Criterion:
    def mix(gram: FloatArray) -> tuple[float, FloatArray]:
        value, gradient = 0.0, np.zeros_like(gram)
        for name, weight in weights.items():
            term, slope = criteria[name](gram)
            if not np.isfinite(term):
                return np.inf, np.zeros_like(gram)
            scale = weight * {"cond": 1.0, "d": 0.5 / len(gram), "a": 0.5}[name]
            value += scale * (term - np.log(len(gram)) if name == "a" else term)
            gradient += scale * slope
        return value, gradient

    return mix


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """What a term of the objective sees: position, velocity (S, n), smoothed sign of the velocity and the speed over
    which it is smoothed, and Y_b of these samples, matrix (S, n, p), in the order of `BaseMatrix`.
    """

    position: FloatArray
    velocity: FloatArray
    sign: FloatArray
    sign_width_rad_s: float
    matrix: FloatArray


Term = Callable[[Samples], tuple[float, FloatArray, FloatArray, FloatArray]]
"""Value, and gradients in the matrix (S, n, p), and besides in position and velocity (S, n) with the matrix fixed."""


@dataclass(frozen=True, slots=True, eq=False)
class GramTerm:
    """A criterion of Gᵀ = Yᵀ W Y as a term. noise_nm: (n,) deviation of each joint's rows, W = 1/noise²; None for 1."""

    criterion: Criterion
    noise_nm: FloatArray | None = None

    def __call__(self, samples: Samples) -> tuple[float, FloatArray, FloatArray, FloatArray]:
        """See `Term`; nothing besides the matrix."""
        scale = np.ones(samples.matrix.shape[1]) if self.noise_nm is None else 1.0 / self.noise_nm
        stacked = (samples.matrix * scale[:, None]).reshape(-1, samples.matrix.shape[2])
        value, inner = self.criterion(stacked.T @ stacked)
        nothing = np.zeros_like(samples.velocity)
        return value, (stacked @ inner).reshape(samples.matrix.shape) * scale[:, None], nothing, nothing


def terms_of(
    text: str,
    noise_nm: FloatArray | None = None,
    others: Mapping[str, Term | None] | None = None,
    sharpness: float | None = None,
) -> tuple[Term, ...]:
    """The terms of an objective's text. With noise_nm (n,) the D and A criteria weigh each joint's rows by 1/noise².

    cond stays that of Y_b as it is, eq. (13), or with rounded edges, see `log_condition_number`. others: the terms of
    OTHERS that the text has.
    """
    weights = mixture_weights(text)
    terms: list[Term] = []
    for name in OTHERS:
        wanted, term = weights.pop(name, None), (others or {}).get(name)
        if wanted is not None:
            assert term is not None, "the design refuses this objective without what it needs"
            terms.append(_Scaled(term, wanted))
    if terms and not weights:
        return tuple(terms)
    if not terms and (len(weights) == 1 or noise_nm is None):
        noisy = noise_nm if "cond" not in weights else None
        return (GramTerm(criterion_of(text, sharpness), noisy),)
    plain = {name: weight for name, weight in weights.items() if name == "cond" or noise_nm is None}
    weighed = {name: weight for name, weight in weights.items() if name not in plain}
    criteria = _criteria(sharpness)
    terms += [GramTerm(_mix(part, criteria), noise) for part, noise in ((plain, None), (weighed, noise_nm)) if part]
    return tuple(terms)


@dataclass(frozen=True, slots=True, eq=False)
class _Scaled:
    """A term times a weight."""

    term: Term
    weight: float

    def __call__(self, samples: Samples) -> tuple[float, FloatArray, FloatArray, FloatArray]:
        value, *gradients = self.term(samples)
        by_matrix, by_position, by_velocity = (self.weight * gradient for gradient in gradients)
        return self.weight * value, by_matrix, by_position, by_velocity


class BaseMatrix:
    """The base regressor of one robot, eq. (7), with viscous and Coulomb columns, differentiable in the motion.

    The columns are those that `BaseRegressor` keeps, the inertial ones first; size: their number p.
    """

    def __init__(self, robot: RobotModel) -> None:
        self.n = robot.n
        self.chain = ChainRegressor(robot.kinematics, np.asarray(robot.gravity, dtype=np.float64))
        # Without friction all columns are inertial, so `kept` counts in the 10 n columns of the chain's regressor.
        self.columns = BaseRegressor(robot, RegressorOptions(viscous=False, coulomb=False)).kept
        self.size = len(self.columns) + 2 * self.n

    def samples(
        self, q: FloatArray, dq: FloatArray, ddq: FloatArray, sign_width_rad_s: float = SIGN_WIDTH_RAD_S
    ) -> Samples:
        """What terms see of a motion, each argument (S, n)."""
        return self._samples(self.chain.motion(q, dq, ddq), q, dq, sign_width_rad_s)

    def _samples(self, motion: ChainMotion, q: FloatArray, dq: FloatArray, sign_width_rad_s: float) -> Samples:
        smooth = np.tanh(dq / sign_width_rad_s)
        matrix = self._with_friction(self.chain.matrix(motion), dq, smooth)
        return Samples(q, dq, smooth, sign_width_rad_s, matrix)

    def value_and_gradient(
        self,
        q: FloatArray,
        dq: FloatArray,
        ddq: FloatArray,
        terms: Sequence[Term],
        sign_width_rad_s: float = SIGN_WIDTH_RAD_S,
    ) -> tuple[float, tuple[FloatArray, FloatArray, FloatArray]]:
        """The sum of the terms with smoothed sign and its gradients in q, q̇, q̈, each (S, n); infinite with zeros."""
        motion = self.chain.motion(q, dq, ddq)
        samples = self._samples(motion, q, dq, sign_width_rad_s)
        value, weights, direct_q, direct_dq = 0.0, np.zeros_like(samples.matrix), np.zeros_like(q), np.zeros_like(q)
        for term in terms:
            part, by_matrix, by_position, by_velocity = term(samples)
            if not np.isfinite(part):
                return np.inf, (np.zeros_like(q), np.zeros_like(q), np.zeros_like(q))
            value, weights = value + part, weights + by_matrix
            direct_q, direct_dq = direct_q + by_position, direct_dq + by_velocity
        inertial = np.zeros((len(q), self.n, 10 * self.n))
        inertial[:, :, self.columns] = weights[:, :, : len(self.columns)]
        by_q, by_dq, by_ddq = self.chain.gradient(motion, inertial)
        by_q, by_dq = by_q + direct_q, by_dq + direct_dq
        joints, start = np.arange(self.n), len(self.columns)
        by_dq = by_dq + weights[:, joints, start + joints]
        by_dq = by_dq + weights[:, joints, start + self.n + joints] * (1.0 - samples.sign**2) / sign_width_rad_s
        return value, (by_q, by_dq, by_ddq)

    def _with_friction(self, full: FloatArray, dq: FloatArray, sign: FloatArray) -> FloatArray:
        matrix = np.zeros((*full.shape[:2], self.size))
        matrix[:, :, : len(self.columns)] = full[:, :, self.columns]
        joints, start = np.arange(self.n), len(self.columns)
        matrix[:, joints, start + joints] = dq
        matrix[:, joints, start + self.n + joints] = sign
        return matrix


class FourierObjective:
    """A sum of terms as a function of (a, b, offset) of eq. (12), sampled at equal steps over one period.

    terms: an objective's text without detectability, or the terms themselves.
    """

    def __init__(
        self,
        base: BaseMatrix,
        terms: str | Sequence[Term],
        fundamental_frequency_hz: float,
        harmonics: int,
        samples: int,
        sign_width_rad_s: float = SIGN_WIDTH_RAD_S,
    ) -> None:
        self._base = base
        self._terms = terms_of(terms) if isinstance(terms, str) else tuple(terms)
        self._sign_width = sign_width_rad_s
        times = np.arange(samples) / (samples * fundamental_frequency_hz)
        self._basis = fourier_basis(times, fundamental_frequency_hz, harmonics)

    def __call__(self, coefficients: FloatArray, offset: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """Value, gradient in coefficients (n, 2 L) = [a, b] and gradient in offset (n,)."""
        position, velocity, acceleration = self._basis
        c = coefficients.T
        value, (by_q, by_dq, by_ddq) = self._base.value_and_gradient(
            position @ c + offset, velocity @ c, acceleration @ c, self._terms, self._sign_width
        )
        gradient = by_q.T @ position + by_dq.T @ velocity + by_ddq.T @ acceleration
        return value, gradient, by_q.sum(axis=0)


def achieved_figures(
    base: BaseRegressor, trajectory: Trajectory, noise_nm: FloatArray | None = None
) -> dict[str, float]:
    """What a trajectory achieves at the paper's 100 Hz with the true sign().

    Keys: cond, log_det, trace_inverse, samples, parameters (p); with noise_nm (n,) also weighted_log_det and
    weighted_trace_inverse of the rows divided by each joint's noise.

    cond is the ratio of the singular values of the (n S) × p matrix itself, not of its square; all by the regressor
    that fits use, not by the one the search differentiates.
    """
    samples = max(1, round(trajectory.period_s * 100.0))
    stacked, joint = base.stacked(*trajectory.evaluate(np.arange(samples) * (trajectory.period_s / samples)))
    figures: dict[str, float] = {"cond": np.inf, "samples": samples, "parameters": base.size}
    kinds = {"": stacked}
    if noise_nm is not None:
        kinds["weighted_"] = stacked / noise_nm[joint][:, None]
    for prefix, rows in kinds.items():
        singular = np.linalg.svd(rows, compute_uv=False)
        full = bool(singular[-1] > 0.0)
        figures[f"{prefix}log_det"] = float(2.0 * np.sum(np.log(singular))) if full else -np.inf
        figures[f"{prefix}trace_inverse"] = float(np.sum(singular**-2.0)) if full else np.inf
        if full and not prefix:
            figures["cond"] = float(singular[0] / singular[-1])
    return figures
