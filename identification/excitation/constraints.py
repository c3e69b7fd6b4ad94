"""What a Fourier trajectory must keep to: the paper's (14c)-(14g), corrected, or the true limits on a grid.

Here: the equalities as a null space, the inequalities g(c) ≥ 0 with their derivatives, the exact repair of what an
optimiser leaves slightly outside, and the verification on the 1 kHz grid. Not here: the objective and the search.
All sets are convex, hold for each joint by itself and contain rest, so that shrinking one joint's amplitude always
leads inside.

(14c) is printed with a and b exchanged; for eq. (12) rest at t = 0 means Σ b_l / l = 0 (position), Σ a_l = 0
(velocity) and Σ l b_l = 0 (acceleration).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.linalg import null_space

from identification.arrays import FloatArray
from identification.errors import DesignError
from identification.excitation.fourier import FourierTrajectory, fourier_basis
from identification.excitation.limits import ExcitationLimits

_COMMANDS_HZ = 1000.0
_SMOOTHING = 1e-12
"""Added under the square roots of (14d, e), (rad/s)²: their derivative at zero amplitude stays finite."""


def rest_at_start(harmonics: int) -> FloatArray:
    """Matrix E of the corrected (14c), E (a, b) = 0, (3, 2 L): rows position, velocity, acceleration at t = 0."""
    order = np.arange(1, harmonics + 1)
    zero = np.zeros(harmonics)
    return np.stack(
        [np.concatenate([zero, 1.0 / order]), np.concatenate([np.ones(harmonics), zero]), np.concatenate([zero, order])]
    )


def rest_null_space(harmonics: int) -> FloatArray:
    """Orthonormal basis N (2 L, 2 L - 3) of the coefficients that start at rest. Raises DesignError for L < 3."""
    if harmonics < 3:
        raise DesignError(f"a trajectory that starts at rest needs at least 3 harmonics, not {harmonics}")
    return null_space(rest_at_start(harmonics))


class PaperConstraints:
    """(14d): Σ √(a²+b²)/l ≤ ω q_max, (14e): Σ √(a²+b²) ≤ q̇_max, (14f, g): |a|, |b| ≤ min(l ω q_max / L, q̇_max).

    The 5 in (14f, g) is the number of harmonics, which share the position range. Coefficients are (n, 2 L) = [a, b].
    """

    def __init__(self, limits: ExcitationLimits, offset: FloatArray, frequency_hz: float, harmonics: int) -> None:
        self._order = np.arange(1, harmonics + 1)
        self._omega = 2.0 * np.pi * frequency_hz
        self._reach = limits.reach(offset)
        self._velocity = limits.velocity
        box = np.minimum(np.multiply.outer(self._reach, self._omega * self._order / harmonics), self._velocity[:, None])
        self.box = np.concatenate([box, box], axis=1)

    def values(self, coefficients: FloatArray) -> tuple[FloatArray, FloatArray]:
        """g(c) ≥ 0 of (14d) and (14e) relative to their limits, (n, 2), and ∂g/∂c, (n, 2, 2 L)."""
        a, b = np.split(coefficients, 2, axis=1)
        size = np.sqrt(a * a + b * b + _SMOOTHING)
        direction = coefficients / np.concatenate([size, size], axis=1)
        weights = np.stack([1.0 / self._order, np.ones_like(self._order, dtype=np.float64)])
        bound = np.stack([self._omega * self._reach, self._velocity], axis=1)
        values = 1.0 - (size @ weights.T) / bound
        slopes = -direction[:, None, :] * np.concatenate([weights, weights], axis=1) / bound[:, :, None]
        return values, slopes

    def linear_rows(self) -> FloatArray:
        """Rows r with |r·c| ≤ 1 for each joint, (n, rows, 2 L): the box (14f, g)."""
        return np.asarray(np.eye(self.box.shape[1]) / self.box[:, :, None])

    def excess(self, coefficients: FloatArray) -> FloatArray:
        """Largest ratio value / limit over (14d)-(14g) for each joint, (n,); above 1 is outside."""
        size = np.hypot(*np.split(coefficients, 2, axis=1))
        position = np.sum(size / self._order, axis=1) / (self._omega * self._reach)
        velocity = np.sum(size, axis=1) / self._velocity
        return np.asarray(np.maximum.reduce([position, velocity, np.max(np.abs(coefficients) / self.box, axis=1)]))


class TrueConstraints:
    """|q - offset| ≤ q_max, |q̇| ≤ q̇_max, |q̈| ≤ q̈_max at the samples of a grid over one period.

    grid: number of samples; between them the trajectory may pass the limit by a little, which `excess` on a fine grid
    and the final shrinking take care of.
    """

    def __init__(
        self, limits: ExcitationLimits, offset: FloatArray, frequency_hz: float, harmonics: int, grid: int
    ) -> None:
        self._bounds = np.stack([limits.reach(offset), limits.velocity, limits.acceleration], axis=1)
        self._coarse = self._rows(frequency_hz, harmonics, grid)
        fine = 200 * harmonics
        self._fine = self._rows(frequency_hz, harmonics, fine)
        # Ehlich and Zeller 1964: between N equal steps a trigonometric polynomial of degree L rises above its samples
        # by no more than this factor.
        self._between = 1.0 / np.cos(np.pi * harmonics / fine)

    def values(self, coefficients: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Nothing nonlinear here: empty (n, 0) and (n, 0, 2 L)."""
        n, width = coefficients.shape
        return np.zeros((n, 0)), np.zeros((n, 0, width))

    def linear_rows(self) -> FloatArray:
        """Rows r with |r·c| ≤ 1 for each joint, (n, 3 · grid, 2 L); accelerations only where they can matter."""
        kinds = [k for k in range(3) if self._can_bind(k)]
        return np.concatenate([self._coarse[k] / self._bounds[:, k, None, None] for k in kinds], axis=1)

    def excess(self, coefficients: FloatArray) -> FloatArray:
        """Largest ratio value / limit for each joint, (n,): an upper bound over all times, not only a grid's."""
        peaks = np.stack([np.max(np.abs(rows @ coefficients.T), axis=0) for rows in self._fine], axis=1)
        return np.asarray(self._between * np.max(peaks / self._bounds, axis=1))

    def _can_bind(self, kind: int) -> bool:
        """Whether acceleration limits can be reached within the velocity limits at all (fastest harmonic)."""
        if kind < 2:
            return True
        # |q̈| ≤ L ω |q̇| by Bernstein's inequality for trigonometric polynomials.
        fastest = np.max(np.abs(self._coarse[2])) / np.max(np.abs(self._coarse[1]))
        return bool(np.any(fastest * self._bounds[:, 1] > self._bounds[:, 2]))

    @staticmethod
    def _rows(frequency_hz: float, harmonics: int, grid: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        return fourier_basis(np.arange(grid) / (grid * frequency_hz), frequency_hz, harmonics)


Constraints = PaperConstraints | TrueConstraints


def repaired(coefficients: FloatArray, constraints: Constraints, basis: FloatArray) -> FloatArray:
    """The nearest point that starts at rest, each joint then shrunk until no constraint is exceeded, (n, 2 L)."""
    projected = coefficients @ basis @ basis.T
    excess = constraints.excess(projected)
    # A hair below 1 keeps the sums inside after they are recomputed in another order.
    factor = np.minimum(1.0, (1.0 - 1e-12) / np.maximum(excess, 1e-300))
    return projected * factor[:, None]


def verify(
    trajectory: FourierTrajectory,
    limits: ExcitationLimits,
    torque_of: Callable[[FloatArray, FloatArray, FloatArray], FloatArray] | None = None,
) -> dict[str, Any]:
    """Check a trajectory at every command of its table, 1000 a second, and against (14).

    Returns `samples`, peak ratios to the limits per joint (`position`, `velocity`, `acceleration`), `rest_at_start`
    (largest |q - offset|, |q̇|, |q̈| at t = 0), `paper` (largest ratio over (14d)-(14g) per joint) and the booleans
    `within_limits` (true limits on the grid, velocity also between successive commands) and `within_paper_limits`.
    torque_of: foreseen torque (S, n) of a motion; with it also `torque`, and `within_limits` counts it.
    """
    q, dq, ddq = trajectory.evaluate(trajectory.sample_times(_COMMANDS_HZ))
    half = 0.5 * (limits.position_upper - limits.position_lower)
    step = np.abs(np.diff(q, axis=0, append=q[:1])) * _COMMANDS_HZ
    position = np.max(np.abs(q - limits.middle), axis=0) / half
    velocity = np.maximum(np.max(np.abs(dq), axis=0), np.max(step, axis=0)) / limits.velocity
    acceleration = np.max(np.abs(ddq), axis=0) / limits.acceleration
    coefficients = np.concatenate([trajectory.a, trajectory.b], axis=1)
    paper = PaperConstraints(limits, trajectory.offset, trajectory.fundamental_frequency_hz, trajectory.harmonics)
    excess = paper.excess(coefficients)
    rest = [float(np.max(np.abs(value))) for value in (q[0] - trajectory.offset, dq[0], ddq[0])]
    report = {
        "samples": len(q),
        "position": position.tolist(),
        "velocity": velocity.tolist(),
        "acceleration": acceleration.tolist(),
        "rest_at_start": rest,
        "paper": excess.tolist(),
        "within_limits": bool(max(position.max(), velocity.max(), acceleration.max()) <= 1.0 + 1e-9),
        "within_paper_limits": bool(excess.max() <= 1.0 and max(rest) < 1e-9),
    }
    if torque_of is not None:
        torque = np.max(np.abs(torque_of(q, dq, ddq)), axis=0) / limits.torque_nm
        report["torque"] = torque.tolist()
        report["within_limits"] = bool(report["within_limits"] and torque.max() <= 1.0)
    return report
