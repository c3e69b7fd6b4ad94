"""The value object between signal processing and estimation: motion, torque, and the operator both sides go through.

What is filtered on one side of τ = Y π must be filtered alike on the other, or the parameters are biased by several
standard deviations. So a pipeline does not hand over filtered torque alone: it hands over a linear operator, and every
regressor column goes through the same one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from identification.arrays import BoolArray, FloatArray

LinearOperator = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, slots=True)
class ProcessedSignals:
    """One stretch of motion on a uniform time grid, with the torque, ready for a regressor.

    time: (S,) s. position, velocity, acceleration: (S, n) rad, rad/s, rad/s². torque: (S, n) Nm, before `project`.
    project: linear, along axis 0: (S, …) → (R, …); for torque and for every regressor column. used: (R, n) which rows
    of which joint may enter a fit. row_time: (R,) s, time of each row, None where rows are spectral lines.
    row_noise: (R, n) Nm, standard deviation of the projected torque's noise, None where it is unknown.
    evaluate: linear, along axis 0, for comparing model and measurement in Nm over time (S, …) → (E, …), with
    `evaluated` (E, n) the samples that count and `evaluation_time` (E,) s. noise_floor_nm: (n,) standard deviation of
    the noise in `evaluate(torque)`, nan where unknown. noise_freedom: degrees of freedom of the variance that row_noise
    gives for a line, inf where it is unknown. outliers_bounded: whether outliers were bounded before the average.
    pipeline: "periodic", "paper" or "aperiodic".
    """

    pipeline: str
    time: FloatArray
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    torque: FloatArray
    project: LinearOperator
    used: BoolArray
    row_time: FloatArray | None
    row_noise: FloatArray | None
    evaluate: LinearOperator
    evaluated: BoolArray
    evaluation_time: FloatArray
    noise_floor_nm: FloatArray
    facts: dict[str, Any] = field(default_factory=dict)
    noise_freedom: float = float("inf")
    outliers_bounded: bool = False

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.position.shape[1])


def unchanged(values: FloatArray) -> FloatArray:
    """The identity, for pipelines that leave a side as it is."""
    return values
