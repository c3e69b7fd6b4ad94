"""Instrumental variables: an estimate that noise in the measured position does not pull towards zero.

Least squares with noisy columns Y is biased, because the noise of Y correlates with itself in YᵀY. Instruments Z, the
same columns from another measurement of the same motion, have independent noise: Σ w Zᵀ (τ − Y π) = 0 is free of that
bias. Z comes from the commanded position where a recording holds one, else from the other half of the periods (even
against odd, both ways round). Free to first order only: sign(q̇) is not linear in the noise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from identification.arrays import FloatArray
from identification.base_parameters import BaseRegressor
from identification.errors import EstimationError
from identification.estimators.observation import ReducedProblem
from identification.fitting.blocks import Block
from identification.fitting.covariance import coloured_covariance
from identification.fitting.estimate import Estimate, estimate_parameters
from identification.recordings.recording import Recording
from identification.signals.processed import ProcessedSignals

Process = Callable[[Recording], tuple[ProcessedSignals, ...]]


@dataclass(frozen=True, slots=True, eq=False)
class InstrumentPair:
    """Columns (R, n, p) of one stretch from two measurements of its motion with independent noise.

    both_ways: whether either may serve as the other's instrument (halves), or only the second for the first.
    """

    columns: FloatArray
    instruments: FloatArray
    both_ways: bool


def instrument_pairs(
    recording: Recording, stretches: tuple[ProcessedSignals, ...], regressor: BaseRegressor, process: Process
) -> list[InstrumentPair]:
    """One pair per stretch. process: the pipeline that the recording itself went through.

    Raises EstimationError for a recording with neither a commanded position nor two periods.
    """
    commanded = recording.command_position
    if commanded is not None and np.all(np.isfinite(commanded)):
        others = process(replace(recording, position=commanded))
        if len(others) == len(stretches):
            return [
                InstrumentPair(_columns(own, own, regressor), _columns(own, other, regressor), False)
                for own, other in zip(stretches, others, strict=True)
            ]
    if stretches[0].row_time is not None or recording.period_index is None:
        raise EstimationError(
            f"{recording.source.path}: instrumental variables need a commanded position or at least two periods"
        )
    numbers = np.unique(recording.period_index[recording.period_index >= 0])
    if len(numbers) < 2:
        raise EstimationError(f"{recording.source.path}: instrumental variables need at least two periods, it has one")
    halves = []
    for half in (numbers[::2], numbers[1::2]):
        inside = np.isin(recording.period_index, half)
        (signals,) = process(replace(recording, period_index=np.where(inside, recording.period_index, -1)))
        halves.append(_columns(stretches[0], signals, regressor))
    return [InstrumentPair(halves[0], halves[1], True)]


def estimate_with_instruments(blocks: list[Block], pairs: list[InstrumentPair], names: tuple[str, ...]) -> Estimate:
    """The instrumental estimate with the weights of a first maximum-likelihood fit, and its covariance.

    The covariance takes the noise as measured for that fit. The reduced problem is the distance from the estimate in
    its own covariance: programs with constraints then find the nearest set in units of the uncertainty.
    """
    first = estimate_parameters(blocks, names, "maximum_likelihood")
    weights = first.least_squares.weights
    size, rows = len(names), 0
    system, right = np.zeros((size, size)), np.zeros(size)
    for block, pair in zip(first.blocks, pairs, strict=True):
        factor = block.fitted * block.scale * np.sqrt(weights)
        torque = (block.torque * factor).ravel()
        columns = (pair.columns * factor[..., None]).reshape(-1, size)
        instruments = (pair.instruments * factor[..., None]).reshape(-1, size)
        system += instruments.T @ columns
        right += instruments.T @ torque
        if pair.both_ways:
            system += columns.T @ instruments
            right += columns.T @ torque
        rows += int(block.fitted.sum())
    values = np.asarray(np.linalg.solve(system, right), dtype=np.float64)
    spread = coloured_covariance(first.blocks, values, first.least_squares.reduced, weights)
    # Covariance of the first fit, taken through the sensitivity of the instrumental equations to the torque.
    doubled = sum(2.0 if pair.both_ways else 1.0 for pair in pairs) / len(pairs)
    triangle = first.least_squares.reduced.triangular
    turn = np.linalg.solve(system / doubled, triangle.T @ triangle)
    covariance = np.asarray(turn @ spread @ turn.T, dtype=np.float64)
    cost = first.least_squares.reduced.cost(values)
    root = scipy.linalg.cholesky(np.linalg.inv(0.5 * (covariance + covariance.T)))
    solution = replace(
        first.least_squares,
        values=values,
        covariance=covariance,
        std=np.sqrt(np.diag(covariance)),
        cost=cost,
        reduced=ReducedProblem(root, root @ values, cost, rows),
    )
    return replace(first, least_squares=solution)


def _columns(own: ProcessedSignals, motion: ProcessedSignals, regressor: BaseRegressor) -> FloatArray:
    """(R, n, p) columns of another measurement of the motion, through the stretch's own projection."""
    over_time = regressor.matrix(motion.position, motion.velocity, motion.acceleration)
    if over_time.shape[0] != own.time.size:
        raise EstimationError("The instruments cover another stretch of time than the measured motion")
    return np.stack([own.project(over_time[:, joint]) for joint in range(own.n)], axis=1)
