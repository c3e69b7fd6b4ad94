"""Effects that differ from period to period: repeatable torque columns times an envelope over the whole recording.

Here: the shape that torque sensor drift, thermal friction, a change of payload and an external contact share.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.effects.base import Columns, Effect, Place, Stage
from identification.mismatch.motion import Motion


class EnvelopedEffect(Effect):
    """Torque = envelope(t) · Σ coefficient · column(motion), t counted from the first sample of the recording."""

    stage: ClassVar[Stage] = "between_periods"

    @abstractmethod
    def repeated_columns(
        self, motion: Motion, place: Place, shape: Mapping[str, float]
    ) -> tuple[tuple[int, ...], FloatArray] | None:
        """Joints (from 0) and columns (S, joints, m) under an envelope of 1; None where the effect cannot act."""

    @abstractmethod
    def envelope(self, motion: Motion, shape: Mapping[str, float]) -> FloatArray:
        """(K, S) factor on the columns in each period, at each time of the period."""

    def columns(self, motion: Motion, place: Place, shape: Mapping[str, float]) -> Columns | None:
        """The columns of every period, and their mean over the periods."""
        repeated = self.repeated_columns(motion, place, shape)
        if repeated is None:
            return None
        joints, values = repeated
        by_period = self.envelope(motion, shape)[:, :, None, None] * values
        return Columns(joints, by_period.mean(axis=0), values_by_period=by_period)


def record_time(motion: Motion) -> FloatArray:
    """(K, S) s, time from the first sample of the recording at every sample of every period."""
    return np.asarray(motion.start_s[:, None] + motion.time[None, :], dtype=np.float64)
