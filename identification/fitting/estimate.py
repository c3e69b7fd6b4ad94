"""The estimators of base parameters: from the blocks of a fit to values and a covariance that holds on coloured noise.

- ols: eq. (9), every row alike: the paper's.
- weighted: each joint divided by its residual variance (iterated).
- maximum_likelihood: each joint and spectral line divided by the noise measured there from period to period, which is
  the likelihood of Gaussian noise of unknown colour; rows without periods that repeat are weighted per joint.
- huber: maximum_likelihood after outliers have been bounded at two robust standard deviations, per joint, and in
  periodic recordings, where each sample has siblings in the other periods, replaced by what the coloured noise around
  them foretells (`signals.outliers`); in other recordings bounded at the residual, before any filter.
- instrumental: see `fitting.instruments`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from identification.arrays import DEVIATION_FROM_MEDIAN, FloatArray
from identification.base_parameters import BaseRegressor
from identification.estimators.least_squares import LeastSquaresResult, solve_least_squares
from identification.fitting.blocks import Block, observation, whiten
from identification.fitting.covariance import coloured_covariance
from identification.signals.outliers import HUBER_BOUND, unclipped_share

_ROUNDS = 5


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """least_squares: values, covariance and reduced problem of the estimator. ordinary: eq. (9) with eq. (15) on the
    same rows. blocks: with the weights used, and with outliers bounded where the estimator does that.
    """

    least_squares: LeastSquaresResult
    ordinary: LeastSquaresResult
    blocks: list[Block]

    def wider(self, spread: FloatArray) -> Estimate:
        """The same values with a covariance (p, p) more."""
        covariance = self.least_squares.covariance + spread
        solution = replace(self.least_squares, covariance=covariance, std=np.sqrt(np.diag(covariance)))
        return replace(self, least_squares=solution)


def default_estimator(pipelines: set[str]) -> str:
    """What "auto" stands for with recordings that went through these pipelines."""
    if pipelines == {"paper"}:
        return "ols"
    return "maximum_likelihood" if "periodic" in pipelines else "weighted"


def estimate_parameters(blocks: list[Block], names: tuple[str, ...], estimator: str) -> Estimate:
    """ols, weighted or maximum_likelihood on the fitted rows of all blocks.

    Raises UndeterminedParametersError when the motion leaves parameters undetermined.
    """
    plain = observation(blocks, names, weighted=False)
    ordinary = solve_least_squares(plain, weighting="none")
    if estimator == "ols":
        solution, inflation = ordinary, 1.0
    else:
        solution, inflation = solve_least_squares(plain, weighting="per_joint"), 1.0
    if estimator == "maximum_likelihood" and any(block.signals.row_noise is not None for block in blocks):
        scaled = [replace(block, scale=block.scale * np.sqrt(solution.weights)) for block in blocks]
        blocks = whiten(scaled, solution.values)
        solution = solve_least_squares(observation(blocks, names), weighting="per_joint")
        inflation = _inflation(blocks)
    covariance = solution.covariance
    if estimator != "maximum_likelihood" or any(block.signals.row_noise is None for block in blocks):
        covariance = coloured_covariance(blocks, solution.values, solution.reduced, solution.weights)
    covariance = inflation * covariance
    solution = replace(
        solution, covariance=covariance, std=np.sqrt(np.diag(covariance)), condition_number=ordinary.condition_number
    )
    return Estimate(solution, ordinary, blocks)


def _inflation(blocks: list[Block]) -> float:
    """How much the covariance grows because weights come from a finite number of differences, (d − 2)/(d − 4).

    d: degrees of freedom of a line's noise estimate; the smallest of all blocks counts. Weights 1/s² with s² of d
    degrees have E[1/s⁴]/E[1/s²]² = (d − 2)/(d − 4); their common factor is settled by the residuals.
    """
    freedom = [block.signals.noise_freedom for block in blocks if block.signals.row_noise is not None]
    smallest = min(freedom, default=np.inf)
    return (smallest - 2.0) / (smallest - 4.0) if np.isfinite(smallest) else 1.0


def bound_outliers(blocks: list[Block], values: FloatArray, regressor: BaseRegressor) -> list[Block]:
    """Blocks whose torque is the model plus the residual cut at two robust deviations, so that least squares on them
    is Huber's estimate once `values` (p,) no longer change. Blocks whose outliers were bounded by period are kept.
    """
    open_blocks = [block for block in blocks if not block.signals.outliers_bounded]
    if not open_blocks:
        return blocks
    stretches = {id(block): block.signals for block in open_blocks}
    models = {
        key: regressor.torque(values, item.position, item.velocity, item.acceleration)
        for key, item in stretches.items()
    }
    residuals = {key: item.torque - models[key] for key, item in stretches.items()}
    pooled = np.concatenate(list(residuals.values()))
    bound = HUBER_BOUND * DEVIATION_FROM_MEDIAN * np.median(np.abs(pooled), axis=0)
    share = unclipped_share(pooled, bound)
    return [
        block
        if id(block) not in models
        else replace(
            block,
            torque=block.signals.project(models[id(block)] + np.clip(residuals[id(block)], -bound, bound) / share),
        )
        for block in blocks
    ]


def estimate_with_bounded_outliers(blocks: list[Block], regressor: BaseRegressor) -> Estimate:
    """Huber's estimator with a scale per joint, by repeated least squares on bounded residuals."""
    result = estimate_parameters(blocks, regressor.names, "maximum_likelihood")
    if all(block.signals.outliers_bounded for block in blocks):
        return result
    ordinary = result.ordinary
    for _ in range(_ROUNDS):
        bounded = bound_outliers(blocks, result.least_squares.values, regressor)
        result = estimate_parameters(bounded, regressor.names, "maximum_likelihood")
    return replace(result, ordinary=ordinary)
