"""The rows of a fit: every processed stretch of every recording, its regressor columns through the torque's operator.

Here: projected columns, held-out rows, whitening by joint and frequency, and the sums from which RMS values follow. Not
here: choosing pipelines or solving.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from identification.base_parameters import BaseRegressor
from identification.estimators.observation import CompressedObservation, merge
from identification.fitting.settings import Split
from identification.signals.periods import smooth_over_lines
from identification.signals.processed import ProcessedSignals

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """One processed stretch in the space of the fit.

    columns: (R, n, p) and torque: (R, n), both projected. fitted, held_out: (R, n) which rows enter which table.
    scale: (R, n) 1/Nm, factor on each row of the fit (1 where unweighted). evaluation: the same stretch over time in
    Nm for RMS values, fitted rows; evaluation_held_out: held-out rows, None when there are none.
    """

    signals: ProcessedSignals
    columns: FloatArray
    torque: FloatArray
    fitted: BoolArray
    held_out: BoolArray
    scale: FloatArray
    evaluation: CompressedObservation
    evaluation_held_out: CompressedObservation | None


def build_block(
    signals: ProcessedSignals, regressor: BaseRegressor, split: Split | None, start_s: float, duration_s: float
) -> Block | None:
    """Project the regressor columns like the torque and sort the rows; None if no row is left to fit or to hold out."""
    time_columns = regressor.matrix(signals.position, signals.velocity, signals.acceleration)
    torque = signals.project(signals.torque)
    columns = np.empty((*torque.shape, regressor.size))
    for joint in range(signals.n):  # joint by joint: the tall array is never copied whole
        columns[:, joint] = signals.project(time_columns[:, joint])
    fitted = signals.used.copy()
    held_out = np.zeros_like(fitted)
    if split is not None and signals.row_time is not None:
        outside = split.held_out(signals.row_time, start_s, duration_s)
        # The low-pass smears each row over about one period of its cutoff; rows nearer than that to the boundary
        # would carry fitted data into the held-out score.
        guard = 0.5 / float(signals.facts.get("low_pass_hz", np.inf))
        clear = split.boundary_distance(signals.row_time, start_s, duration_s) >= guard
        held_out = signals.used & (outside & clear)[:, None]
        fitted = signals.used & ~outside[:, None]
    if not fitted.any() and not held_out.any():
        return None
    if signals.evaluate is signals.project:
        evaluated, measured, inside = columns, torque, fitted
    else:
        measured = signals.evaluate(signals.torque)
        evaluated, inside = time_columns, signals.evaluated
    return Block(
        signals=signals,
        columns=columns,
        torque=torque,
        fitted=fitted,
        held_out=held_out,
        scale=np.ones(torque.shape),
        evaluation=_compressed(evaluated, measured, inside, regressor.names),
        evaluation_held_out=_compressed(columns, torque, held_out, regressor.names) if held_out.any() else None,
    )


def _compressed(
    columns: FloatArray, torque: FloatArray, rows: BoolArray, names: tuple[str, ...], scale: FloatArray | None = None
) -> CompressedObservation:
    """Chosen rows as one triangular factor per joint; any number of rows will do, a joint without rows has zeros."""
    joints = torque.shape[1]
    size = len(names)
    factors = np.zeros((joints, size + 1, size + 1))
    for joint in range(joints):
        chosen = rows[:, joint]
        matrix = columns[chosen, joint]
        # Joint j feels the links j … n only: most columns of a distal joint are zero.
        used = np.flatnonzero((matrix != 0.0).any(axis=0))
        augmented = np.column_stack([matrix[:, used], torque[chosen, joint]])
        if scale is not None:
            augmented *= scale[chosen, joint][:, None]
        triangle = np.linalg.qr(augmented, mode="r")
        factors[joint][: len(triangle), np.append(used, size)] = triangle
    return CompressedObservation(factors, True, rows.sum(axis=0).astype(np.int64), names)


def observation(blocks: list[Block], names: tuple[str, ...], *, weighted: bool = True) -> CompressedObservation:
    """All fitted rows of all blocks as one compressed observation, each row times its scale if weighted."""
    return merge(
        [
            _compressed(block.columns, block.torque, block.fitted, names, block.scale if weighted else None)
            for block in blocks
            if block.fitted.any()
        ]
    )


def whiten(blocks: list[Block], values: FloatArray) -> list[Block]:
    """Scale each spectral row by one over the noise expected there, from the residuals of a first fit.

    The variance on a line is the noise between periods where that is known, or the residual's own power smoothed over
    neighbouring lines where that is larger (then the model, not the noise, is the limit). Blocks whose rows are times
    are returned as they are. values: (p,) base parameters of the first fit.
    """
    result = []
    for block in blocks:
        if block.signals.row_time is not None:
            result.append(block)
            continue
        residual = block.torque - block.columns @ values
        power = residual**2
        lines = np.concatenate([power[:1], 0.5 * (power[1::2] + power[2::2])])
        smooth = smooth_over_lines(lines) if lines.shape[0] > 1 else lines
        # One residual says nothing about the variance of its own line: take the neighbourhood's.
        smooth[0] = smooth[min(1, len(smooth) - 1)]
        variance = np.concatenate([smooth[:1], np.repeat(smooth[1:], 2, axis=0)])
        if block.signals.row_noise is not None:
            variance = np.maximum(variance, block.signals.row_noise**2)
        floor = 1e-18 * np.mean(block.torque**2, axis=0)
        result.append(replace(block, scale=1.0 / np.sqrt(np.maximum(variance, np.maximum(floor, 1e-30)))))
    return result


def rms_over(parts: list[CompressedObservation], values: FloatArray | None) -> FloatArray:
    """(n,) RMS of the residual of base parameters (p,), or of the torque for None; nan for a joint without rows."""
    squares = sum(
        (part.torque_squares() if values is None else part.residual_squares(values) for part in parts),
        start=np.zeros(parts[0].blocks.shape[0]),
    )
    counts = np.sum([part.counts for part in parts], axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.sqrt(squares / np.where(counts > 0, counts, np.nan)), dtype=np.float64)
