"""The rows of a fit: every processed stretch of every recording, its regressor columns through the torque's operator.

Here: projected columns, held-out rows, whitening by joint and frequency, and the sums from which RMS values follow. Not
here: choosing pipelines or solving.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import lapack

from identification.arrays import BoolArray, FloatArray, IntArray
from identification.base_parameters import BaseRegressor, direction_of
from identification.estimators.observation import CompressedObservation, compress_joints, merge
from identification.fitting.settings import Split
from identification.signals.periods import smooth_over_lines
from identification.signals.processed import ProcessedSignals

MISFIT_OVER_NOISE = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class RowsOverTime:
    """The rows of one stretch as they are, for RMS values: compressing them would take longer than asking them.

    joints: per joint its columns (m, rows), their positions (m,) among the base parameters, and its torque (rows,) Nm.
    """

    joints: tuple[tuple[FloatArray, IntArray, FloatArray], ...]

    @property
    def counts(self) -> IntArray:
        """(n,) rows per joint."""
        return np.array([len(torque) for _, _, torque in self.joints], dtype=np.int64)

    def residual_squares(self, base_values: FloatArray) -> FloatArray:
        """(n,) sum of squared residuals of each joint, Nm², for base parameters (p,)."""
        residuals = [torque - base_values[used] @ columns for columns, used, torque in self.joints]
        return np.array([residual @ residual for residual in residuals])

    def torque_squares(self) -> FloatArray:
        """(n,) sum of squared torques of each joint, Nm²."""
        return np.array([torque @ torque for _, _, torque in self.joints])


Evaluation = CompressedObservation | RowsOverTime


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """One processed stretch in the space of the fit.

    columns: (R, n, p) and torque: (R, n), both projected. fitted, held_out: (R, n) which rows enter which table.
    scale: (R, n) 1/Nm, factor on each row of the fit (1 where unweighted). evaluation: the same stretch over time in
    Nm for RMS values, fitted rows; evaluation_held_out: held-out rows, None when there are none. recording: its number
    among those fitted.
    """

    signals: ProcessedSignals
    columns: FloatArray
    torque: FloatArray
    fitted: BoolArray
    held_out: BoolArray
    scale: FloatArray
    evaluation: Evaluation
    evaluation_held_out: CompressedObservation | None
    recording: int = 0

    def with_regressor(self, old: BaseRegressor, new: BaseRegressor) -> Block | None:
        """The same rows with the columns of another model, of which only Coulomb friction may differ and others be left
        out; None where the new model has columns that this one has not.
        """
        place = {old.full_names[position]: index for index, position in enumerate(old.kept)}
        wanted = [new.full_names[position] for position in new.kept]
        if not set(wanted) <= set(place):
            return None
        chosen = np.array([place[name] for name in wanted], dtype=np.int64)
        columns, over_time = self.columns[:, :, chosen], None
        if isinstance(self.evaluation, RowsOverTime):
            number = np.full(old.size, -1)
            number[chosen] = np.arange(new.size)
            over_time = [
                (packed[number[used] >= 0], number[used][number[used] >= 0], torque)
                for packed, used, torque in self.evaluation.joints
            ]
        if new.options.coulomb_velocity != old.options.coulomb_velocity:
            turning = direction_of(self.signals.velocity, new.options.coulomb_velocity)
            projected, evaluated = self.signals.project(turning), self.signals.evaluate(turning)
            for joint in range(new.robot.n):
                if f"FS_{joint + 1}" not in wanted:
                    continue
                index = wanted.index(f"FS_{joint + 1}")
                columns[:, joint, index] = projected[:, joint]
                if over_time is not None:
                    packed, used, _ = over_time[joint]
                    packed[used == index] = evaluated[self.signals.evaluated[:, joint], joint]
        names, held_out = new.names, self.evaluation_held_out
        return replace(
            self,
            columns=columns,
            scale=np.ones(self.torque.shape),
            evaluation=_compressed(columns, self.torque, self.fitted, names)
            if over_time is None
            else RowsOverTime(tuple(over_time)),
            evaluation_held_out=None if held_out is None else _compressed(columns, self.torque, self.held_out, names),
        )


def build_block(
    signals: ProcessedSignals, regressor: BaseRegressor, split: Split | None, start_s: float, duration_s: float
) -> Block | None:
    """Project the regressor columns like the torque and sort the rows; None if no row is left to fit or to hold out."""
    over_time = regressor.joint_columns(signals.position, signals.velocity, signals.acceleration)
    torque = signals.project(signals.torque)
    columns = np.zeros((*torque.shape, regressor.size))
    for joint, (packed, used) in enumerate(over_time):
        columns[:, joint, used] = signals.project(packed.T)
    # A joint that follows another has no torque of its own that could be measured.
    alone = np.isin(np.arange(regressor.robot.n), regressor.robot.driven)
    fitted = signals.used & alone
    held_out = np.zeros_like(fitted)
    if split is not None and signals.row_time is not None:
        outside = split.held_out(signals.row_time, start_s, duration_s)
        # The low-pass smears each row over about one period of its cutoff; rows nearer than that to the boundary
        # would carry fitted data into the held-out score.
        guard = 0.5 / float(signals.facts.get("low_pass_hz", np.inf))
        clear = split.boundary_distance(signals.row_time, start_s, duration_s) >= guard
        held_out = signals.used & alone & (outside & clear)[:, None]
        fitted = signals.used & alone & ~outside[:, None]
    if not fitted.any() and not held_out.any():
        return None
    if signals.evaluate is signals.project:
        evaluation: Evaluation = _compressed(columns, torque, fitted, regressor.names)
    else:
        measured = signals.evaluate(signals.torque)
        joints = []
        for joint, (packed, used) in enumerate(over_time):
            inside = signals.evaluated[:, joint] & alone[joint]
            evaluated = signals.evaluate(packed.T).T
            joints.append((evaluated if inside.all() else evaluated[:, inside], used, measured[inside, joint]))
        evaluation = RowsOverTime(tuple(joints))
    return Block(
        signals=signals,
        columns=columns,
        torque=torque,
        fitted=fitted,
        held_out=held_out,
        scale=np.ones(torque.shape),
        evaluation=evaluation,
        evaluation_held_out=_compressed(columns, torque, held_out, regressor.names) if held_out.any() else None,
    )


def _compressed(
    columns: FloatArray, torque: FloatArray, rows: BoolArray, names: tuple[str, ...], scale: FloatArray | None = None
) -> CompressedObservation:
    """Chosen rows as one triangular factor per joint, each row times its scale."""
    joints = []
    for joint in range(torque.shape[1]):
        chosen = rows[:, joint]
        weight = 1.0 if scale is None else scale[chosen, joint]
        matrix = columns[chosen, joint].T
        # Joint j feels the links j … n only: most columns of a distal joint are zero.
        used = np.flatnonzero(matrix.any(axis=1))
        joints.append((matrix[used] * weight, used, torque[chosen, joint] * weight))
    return compress_joints(joints, names)


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
    """Scale each spectral row by one over the deviation expected there (`line_variances`), from a first fit's values.

    Blocks whose noise was not measured (rows are times, or one period only) are returned as they are, with the scale
    they have: where the motion is, the fit takes up a good part of the residual, and these lines would look quiet.
    """
    return [
        block
        if block.signals.row_noise is None
        else replace(block, scale=1.0 / np.sqrt(variances_of(block, block.torque - block.columns @ values)))
        for block in blocks
    ]


def line_variances(residual: FloatArray, noise: FloatArray | None, floor: FloatArray) -> FloatArray:
    """(R, n) Nm² variance expected on each spectral row, from the residual (R, n) and the noise between periods (R, n).

    Where the noise is known it is the answer, except on lines on which the residual's power, averaged over neighbouring
    lines, is more than three times the noise (chance of that in noise alone: below 1 in 1000): there the model, not
    the noise, is the limit, and the residual's power stands in. Without known noise it always does. floor: (n,) Nm².
    """
    power = smooth_over_lines(to_line_power(residual))
    # One residual says nothing about the variance of its own line: take the neighbourhood's.
    power[0] = power[min(1, len(power) - 1)]
    if noise is not None:
        known = to_line_power(noise)
        power = np.where(power > MISFIT_OVER_NOISE * smooth_over_lines(known), np.maximum(power, known), known)
    return to_rows(np.maximum(power, floor))


def variances_of(block: Block, residual: FloatArray) -> FloatArray:
    """`line_variances` of the spectral rows of a block."""
    floor = np.maximum(1e-18 * np.mean(block.torque**2, axis=0), 1e-30)
    return line_variances(residual, block.signals.row_noise, floor)


def to_line_power(rows: FloatArray) -> FloatArray:
    """Mean square per line of orthonormal real Fourier rows: (2 L + 1, n) → (L + 1, n)."""
    power = rows**2
    return np.concatenate([power[:1], 0.5 * (power[1::2] + power[2::2])])


def to_rows(lines: FloatArray) -> FloatArray:
    """One value per line as one value per row, for the cosine and the sine alike: (L + 1, …) → (2 L + 1, …)."""
    return np.concatenate([lines[:1], np.repeat(lines[1:], 2, axis=0)])


def rms_over(parts: Sequence[Evaluation], values: FloatArray | None) -> FloatArray:
    """(n,) RMS of the residual of base parameters (p,), or of the torque for None; nan for a joint without rows."""
    squares = sum(
        (part.torque_squares() if values is None else part.residual_squares(values) for part in parts),
        start=np.zeros(len(parts[0].counts)),
    )
    counts = np.sum([part.counts for part in parts], axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.sqrt(squares / np.where(counts > 0, counts, np.nan)), dtype=np.float64)


def shortest_solution(gram: FloatArray, right: FloatArray, tolerance: float) -> FloatArray:
    """(p,) least squares from normal equations, columns scaled to one; 0 along what they do not tell."""
    norms = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    scaled = gram / np.outer(norms, norms)
    # A factor tells that all directions are told in a tenth of the time that it takes to find them: none of the values
    # is more than their sum.
    if lapack.dpotrf(scaled - tolerance * np.trace(scaled) * np.eye(len(scaled)))[1] == 0:
        return np.asarray(lapack.dposv(scaled, right / norms)[1] / norms, dtype=np.float64)
    values, vectors = np.linalg.eigh(scaled)
    inverse = np.where(values > tolerance * values[-1], 1.0 / np.maximum(values, 1e-300), 0.0)
    return np.asarray(vectors @ (inverse * (vectors.T @ (right / norms))) / norms, dtype=np.float64)
