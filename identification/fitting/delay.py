"""Is the torque late against the position? One delay for all joints and one per joint, with σ, and the correction.

A torque that is δ late obeys τ(t) = τ_model(t − δ) ≈ τ_model − δ · dτ_model/dt: one more column per delay, estimated
together with the base parameters by the same estimator. Half a millisecond already moves parameters by a σ. Friction
that the model does not know looks like a delay too, so it is reported by default and corrected only when asked for.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from identification.arrays import FloatArray
from identification.base_parameters import BaseRegressor
from identification.estimators.least_squares import LeastSquaresResult
from identification.fitting.blocks import Block, RowsOverTime
from identification.fitting.estimate import estimate_parameters
from identification.json_values import json_list
from identification.signals.processed import ProcessedSignals

SMALL_DELAY_S = 1e-3
"""A delay up to this is a small change of the torque, which one column describes."""
_MILLISECOND = 1e-3
_SMALLEST_SHARE = 1e-6
_MOST_ROUNDS = 20


@dataclass(frozen=True, slots=True, eq=False)
class TorqueDelay:
    """How much later the torque is than the position, s; negative: earlier.

    common, common_std: one for all joints, which are taken to agree. per_joint, per_joint_std: (n,), nan for a joint
    without varying torque. first, first_std: of one column beside parameters that were fitted without a delay and took
    part of it: what a model of these parameters leaves. With periods as common.
    spread_common, spread_per_joint: (p, p) covariance that the base parameters have from not knowing them better.
    """

    common: float
    common_std: float
    per_joint: FloatArray
    per_joint_std: FloatArray
    first: float
    first_std: float
    spread_common: FloatArray
    spread_per_joint: FloatArray

    def of(self, correction: str) -> FloatArray:
        """(n,) s to shift the torque by: "common", "per_joint" (zero where unknown) or "no"."""
        if correction == "common":
            return np.full(len(self.per_joint), self.common)
        return np.nan_to_num(self.per_joint) if correction == "per_joint" else np.zeros(len(self.per_joint))

    def spread(self, correction: str) -> FloatArray:
        """(p, p) covariance that goes with `of`: what a torque moved by them says less surely of base parameters."""
        if correction == "common":
            return self.spread_common
        return self.spread_per_joint if correction == "per_joint" else np.zeros_like(self.spread_common)

    @property
    def std_between_joints(self) -> float:
        """σ of the common delay, s, where joints may differ: friction beyond the model makes each late by its own.

        Their variance is DerSimonian and Laird's; each joint counts with its weight in the common delay.
        """
        known = np.isfinite(self.per_joint)
        if not known.any():
            return float("nan")
        weight, late = 1.0 / self.per_joint_std[known] ** 2, self.per_joint[known]
        total = float(weight.sum())
        beyond = float(weight @ (late - weight @ late / total) ** 2) - (len(late) - 1)
        free = total - float((weight**2).sum()) / total
        variance = max(0.0, beyond) / free if free > 0.0 else 0.0
        return float(np.sqrt(self.common_std**2 + variance * float((weight**2).sum()) / total**2))

    def to_json(self) -> dict[str, Any]:
        """The delays as plain JSON types, seconds."""
        return {
            "common_s": self.common,
            "common_std_s": self.common_std,
            "std_between_joints_s": self.std_between_joints,
            "first_s": self.first,
            "first_std_s": self.first_std,
            "per_joint_s": json_list(self.per_joint),
            "per_joint_std_s": json_list(self.per_joint_std),
        }

    def sentence(self) -> str:
        """What an operator should know."""
        joints = ", ".join(
            f"{1e3 * value:+.2f} ± {1e3 * std:.2f}" if np.isfinite(value) else "–"
            for value, std in zip(self.per_joint, self.per_joint_std, strict=True)
        )
        return (
            f"The torque comes {1e3 * self.common:+.2f} ± {1e3 * self.std_between_joints:.2f} ms after the position, "
            f"all joints together; by joint {joints} ms (friction beyond the model looks like a delay too)."
        )


def estimate_delay(blocks: list[Block], values: FloatArray, regressor: BaseRegressor, estimator: str) -> TorqueDelay:
    """Delays of the recordings together. blocks: of the fit, unweighted. values: (p,) base parameters of the fit.

    estimator: ols, weighted or maximum_likelihood. The column is linear in δ to (2π f δ)², useless for the 60 Hz to
    which periods are compared, and its torque is that of parameters which took part of the delay. So a delay is taken
    off and the rest measured, until it is small.
    """
    blocks = [block for block in blocks if block.fitted.any()]
    rates = _rates(blocks, regressor, values)
    joints = rates[0].shape[1]
    size = np.array([sum(float((rate[:, j] ** 2).sum()) for rate in rates) for j in range(joints)])
    moving = np.flatnonzero(size > _SMALLEST_SHARE * size.max(initial=0.0))
    per_joint, per_joint_std = np.full(joints, np.nan), np.full(joints, np.nan)
    nothing, unknown = np.zeros((regressor.size, regressor.size)), float("nan")
    if moving.size == 0:
        return TorqueDelay(unknown, unknown, per_joint, per_joint_std, unknown, unknown, nothing, nothing)

    def taken_off(where: FloatArray, start: FloatArray) -> list[_Round]:
        return _taken_off(blocks, rates, where, start, regressor, estimator)

    every, at_once = np.ones((joints, 1)), np.zeros(1)
    rounds = taken_off(every, at_once)
    (common,), (common_std,), spread = rounds[-1]
    periods = any(block.signals.row_time is None for block in blocks)
    (first,), (first_std,), _ = rounds[-1 if periods else 0]
    # From far away a joint of its own may come to rest a turn of the highest line off.
    own = taken_off(np.eye(joints)[:, moving], np.full(moving.size, common))[-1]
    per_joint[moving], per_joint_std[moving], spread_per_joint = own
    return TorqueDelay(
        float(common), float(common_std), per_joint, per_joint_std, float(first), float(first_std), spread,
        spread_per_joint,
    )  # fmt: skip


_Round = tuple[FloatArray, FloatArray, FloatArray]
"""(k,) delays and their σ, s, and the (p, p) covariance that base parameters have from them."""


def _taken_off(
    blocks: list[Block],
    rates: list[FloatArray],
    joints: FloatArray,
    start: FloatArray,
    regressor: BaseRegressor,
    estimator: str,
) -> list[_Round]:
    """What each round finds, until what is left to be taken off is small.

    rates: of each block by the base parameters to start with (`_rates`). joints: (n, k), ones where a delay acts.
    start: (k,) s, near the delays.
    """
    total, rounds = np.where(np.abs(start) > SMALL_DELAY_S, start, 0.0), list[_Round]()
    while True:
        signals = [earlier(block.signals, joints @ total) if total.any() else block.signals for block in blocks]
        moved = [
            replace(block, torque=block.signals.project(item.torque))
            for block, item in zip(blocks, signals, strict=True)
        ]
        found = _solve(moved, [rate[:, :, None] * joints for rate in rates], regressor, estimator)
        values, late = found.values[: regressor.size], _MILLISECOND * found.values[regressor.size :]
        total = total + late
        beside = found.covariance[: regressor.size, regressor.size :]
        own = found.covariance[regressor.size :, regressor.size :]
        spread = beside @ np.linalg.solve(own, beside.T)
        rounds.append((total, _MILLISECOND * found.std[regressor.size :], 0.5 * (spread + spread.T)))
        if np.abs(late).max() <= SMALL_DELAY_S or len(rounds) == _MOST_ROUNDS:
            return rounds
        rates = _rates(blocks, regressor, values)


def _rates(blocks: list[Block], regressor: BaseRegressor, values: FloatArray) -> list[FloatArray]:
    """(R, n) `torque_rate` of each block, projected as its torque."""
    return [block.signals.project(torque_rate(block, regressor, values)) for block in blocks]


def earlier(signals: ProcessedSignals, delay: FloatArray) -> ProcessedSignals:
    """The stretch with each joint's torque moved earlier by its delay (n,) s; a periodic one wraps."""
    if signals.row_time is None:
        spectrum = np.fft.rfft(signals.torque, axis=0)
        cycles = np.fft.rfftfreq(len(signals.torque), _step(signals))[:, None]
        moved = np.fft.irfft(spectrum * np.exp(2j * np.pi * cycles * delay), n=len(signals.torque), axis=0)
        return replace(signals, torque=moved)
    from scipy.interpolate import CubicSpline  # slow to load, and periodic recordings do without

    splines = CubicSpline(signals.time, signals.torque)
    times = np.clip(signals.time[:, None] + delay, signals.time[0], signals.time[-1])
    moved = np.column_stack([splines(times[:, joint])[:, joint] for joint in range(signals.n)])
    return replace(signals, torque=moved)


def _solve(
    blocks: list[Block], columns: list[FloatArray], regressor: BaseRegressor, estimator: str
) -> LeastSquaresResult:
    """Base parameters and behind them delays in ms, one per column (R, n, k) added to the blocks."""
    count = columns[0].shape[2]
    names = (*regressor.names, *(f"DELAY_{number}" for number in range(count)))
    augmented = [
        replace(
            block,
            columns=np.concatenate([block.columns, -_MILLISECOND * column], axis=2),
            evaluation=RowsOverTime(()),  # RMS values are not asked for here
        )
        for block, column in zip(blocks, columns, strict=True)
    ]
    return estimate_parameters(augmented, names, estimator).least_squares


def torque_rate(block: Block, regressor: BaseRegressor, values: FloatArray) -> FloatArray:
    """(S, n) Nm/s, time derivative of the modelled torque; of the measured one in the paper's chain, whose filter has
    taken the steps of friction out of that alone.
    """
    signals = block.signals
    if signals.pipeline == "paper":
        return _line_by_line(signals.torque, _step(signals))
    if isinstance(block.evaluation, RowsOverTime) and all(block.evaluation.counts == len(signals.time)):
        torque = np.column_stack([values[used] @ packed for packed, used, _ in block.evaluation.joints])
    else:
        torque = regressor.torque(values, signals.position, signals.velocity, signals.acceleration)
    if signals.pipeline == "aperiodic":
        return np.asarray(np.gradient(torque, _step(signals), axis=0), dtype=np.float64)
    # A central difference would make 60 Hz at 250 Hz of sampling a third too small.
    return _line_by_line(torque, _step(signals))


def _line_by_line(values: FloatArray, step_s: float) -> FloatArray:
    """(S, n) time derivative of one period, as `earlier` moves it."""
    cycles = np.fft.rfftfreq(len(values), step_s)[:, None]
    spectrum = np.fft.rfft(values, axis=0) * 2j * np.pi * cycles
    return np.asarray(np.fft.irfft(spectrum, n=len(values), axis=0), dtype=np.float64)


def _step(signals: ProcessedSignals) -> float:
    return float(signals.time[-1] - signals.time[0]) / (len(signals.time) - 1)
