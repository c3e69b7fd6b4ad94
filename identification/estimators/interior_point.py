"""A primal-dual interior-point method for a smooth function of some hundred variables under linear inequalities.

Every iterate is strictly inside the inequalities, so the answer meets them exactly. Used by `constrained` for program
(10); knows nothing of robots.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.sparse
from scipy.linalg import lapack

from identification.arrays import FloatArray
from identification.errors import SolverError

Function = Callable[[FloatArray], float]
Derivatives = Callable[[FloatArray], tuple[FloatArray, FloatArray]]

_FRACTION_TO_BOUNDARY = 0.99
_ARMIJO = 1e-4
# Iterations over which a value that stands still ends the search (flat valleys: what moves there costs nothing)
_WINDOW = 15
_TOLERANCE = 1e-9
_MOST_ITERATIONS = 300


@dataclass(frozen=True, slots=True, eq=False)
class InteriorPointResult:
    """Where the method ended: point and value.

    converged: the Lagrangian's gradient in the scale of the variables and the mean of slack times multiplier (what the
    value could still fall by per inequality) are below the tolerance, or the latter is and the value has stood still
    for 15 iterations.
    """

    point: FloatArray
    value: float
    converged: bool


def minimise_inside(
    function: Function,
    derivatives: Derivatives,
    matrix: scipy.sparse.csr_array,
    bound: FloatArray,
    start: FloatArray,
    *,
    initial_barrier: float = 1e-2,
) -> InteriorPointResult:
    """A local minimum of function(y) over matrix · y < bound (matrix sparse), from a start strictly inside.

    function: value of order one (scale it: tolerances are absolute). derivatives: gradient (k,) and symmetric Hessian
    (k, k). The Hessian need not be positive definite. initial_barrier: first weight of the logarithmic barrier; the
    smaller, the nearer the result is to the start. Source: Nocedal and Wright, Numerical Optimization, ch. 19.
    Raises ValueError when the start is not strictly inside, SolverError where the derivatives are no numbers.
    """
    rows = matrix.toarray()  # some hundred by a hundred: bookkeeping of sparse products costs more than the zeros
    point = start.copy()
    slack = bound - rows @ point
    if not np.all(slack > 0.0):
        raise ValueError("the start of an interior-point method must lie strictly inside the inequalities")
    barrier = initial_barrier
    multiplier = np.minimum(barrier / slack, 1e6)
    value = function(point)
    converged = False
    values: list[float] = []
    for _ in range(_MOST_ITERATIONS):
        gradient, hessian = derivatives(point)
        lagrangian = gradient + multiplier @ rows
        scale = np.maximum(np.abs(point), 1e-3)
        stationarity = float(np.abs(lagrangian * scale).max())
        complementarity = float(slack @ multiplier) / len(slack)
        values.append(value)
        standing = len(values) > _WINDOW and abs(values[-1 - _WINDOW] - value) < 100.0 * _TOLERANCE
        if (stationarity < _TOLERANCE * 100 and complementarity < _TOLERANCE) or (
            standing and complementarity < 10.0 * _TOLERANCE
        ):
            converged = True
            break
        if stationarity < 10.0 * barrier and np.abs(slack * multiplier - barrier).max() < 10.0 * barrier:
            barrier = max(min(0.2 * barrier, barrier**1.5), 0.1 * _TOLERANCE)
        weight = multiplier / slack
        system = hessian + (rows.T * weight) @ rows
        pull = gradient + (barrier / slack) @ rows
        step = -_solve_positive(system, pull)
        slack_step = -(rows @ step)
        multiplier_step = barrier / slack - multiplier - weight * slack_step
        length = _longest_step(slack, slack_step)
        slope = float(pull @ step)
        merit = value - barrier * float(np.log(slack).sum())
        for _ in range(40):
            trial = point + length * step
            trial_slack = bound - rows @ trial
            if np.all(trial_slack > 0.0):
                trial_value = function(trial)
                trial_merit = trial_value - barrier * float(np.log(trial_slack).sum())
                if trial_merit <= merit + _ARMIJO * length * slope + 1e-13 * abs(merit):
                    break
            length *= 0.5
        else:
            if barrier <= 0.1 * _TOLERANCE:
                break
            barrier = max(0.1 * barrier, 0.1 * _TOLERANCE)
            multiplier = barrier / slack
            continue
        point, slack, value = trial, trial_slack, trial_value
        multiplier = multiplier + _longest_step(multiplier, multiplier_step) * multiplier_step
        # keep slack · multiplier within a corridor around the barrier parameter, or Newton steps lose their meaning
        multiplier = np.clip(multiplier, barrier / (1e10 * slack), 1e10 * barrier / slack)
    return InteriorPointResult(point, value, converged)


def _longest_step(values: FloatArray, steps: FloatArray) -> float:
    falling = steps < 0.0
    if not np.any(falling):
        return 1.0
    return min(1.0, _FRACTION_TO_BOUNDARY * float(np.min(-values[falling] / steps[falling])))


def _solve_positive(system: FloatArray, right: FloatArray) -> FloatArray:
    """Solve with the matrix made positive definite by the smallest tried multiple of its diagonal."""
    if not np.isfinite(system).all():
        raise SolverError(
            "The derivatives of the program are not finite numbers.", solver="interior point", status="not finite"
        )
    scale = 1.0 / np.sqrt(np.maximum(np.abs(np.diag(system)), 1e-300))
    scaled = system * scale[:, None] * scale[None, :]
    shift = 0.0
    while True:
        shifted = scaled.copy()
        np.einsum("ii->i", shifted)[:] += shift
        # Thousands of times in a program: what SciPy asks about its arguments takes as long as the root.
        factor, failed = lapack.dpotrf(shifted, clean=0)
        if not failed:
            return np.asarray(scale * lapack.dpotrs(factor, scale * right)[0], dtype=np.float64)
        shift = max(10.0 * shift, 1e-10)
