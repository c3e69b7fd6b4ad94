"""A recording reduced for diagnosis: rows of the mean, rows of each period, and the noise that both carry.

Noise comes from differences of successive periods, misfit from the mean of the periods, changes from contrasts between
them; the three are never mixed. Rows are spectral lines, so that coloured noise is a matter of one variance per line.
Called by every stage of the diagnosis.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from identification.mismatch.motion import Motion
from identification.recordings.recording import Recording
from identification.signals.processed import LinearOperator

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """One stretch of a recording in the space of the diagnosis.

    recording: where it comes from. motion: what effects see. project: linear along axis 0, (S, …) → (R, …), for every
    torque column. frequency: (R,) Hz of each row (line 0, then cosine and sine of each line). torque: (R, n) rows of
    the measured mean. period_torque: (K, R, n) rows of each period, None without periods. nominal: (R, n, p) rows of
    the base regressor's columns. noise: (R, n) Nm, standard deviation of the noise in `torque`'s rows.
    noise_freedom: (R,) real degrees of freedom behind each entry of `noise`. used: (R, n) rows that count.
    noise_is_measured: whether the noise comes from period differences; False where it had to be taken from the high
    band, which is weaker evidence.
    """

    recording: Recording
    motion: Motion
    project: LinearOperator
    frequency: FloatArray
    torque: FloatArray
    period_torque: FloatArray | None
    nominal: FloatArray
    noise: FloatArray
    noise_freedom: FloatArray
    used: BoolArray
    noise_is_measured: bool

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.torque.shape[1])

    @property
    def periods(self) -> int:
        """Number K of periods, 1 for a stretch without periods."""
        return 1 if self.period_torque is None else int(self.period_torque.shape[0])
