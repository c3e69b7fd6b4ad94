"""When the arm counts as standing still: decided from fresh samples alone, never from what was commanded.

The numbers of this decision stand here and nowhere else.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

STANDSTILL_SPREAD_RAD = 5e-4
"""Largest spread (maximum minus minimum) of any joint's position within the window: at most 2.5 mrad/s on average.

Far above encoder noise (the iiwa resolves some 1e-5 rad), far below what any moving joint covers in 0.2 s."""

STANDSTILL_WINDOW_S = 0.2
STANDSTILL_MINIMUM_SAMPLES = 20
STANDSTILL_TIMEOUT_S = 5.0


class Standstill:
    """Confirms from fresh samples that the arm stands: `samples` in a row within STANDSTILL_SPREAD_RAD per joint."""

    def __init__(self, sample_period_s: float) -> None:
        self.samples = max(STANDSTILL_MINIMUM_SAMPLES, round(STANDSTILL_WINDOW_S / sample_period_s))
        self.limit = max(2 * self.samples, round(STANDSTILL_TIMEOUT_S / sample_period_s))
        self.threshold_rad = STANDSTILL_SPREAD_RAD
        self.reset()

    def reset(self) -> None:
        """Start over."""
        self._low: list[float] = []
        self._high: list[float] = []
        self._in_window = 0
        self.observed = 0
        self.spread = math.nan
        self.confirmed = False
        self.gave_up = False

    def observe(self, position: Sequence[float]) -> None:
        """Take one fresh sample, rad; sets `confirmed`, or `gave_up` after STANDSTILL_TIMEOUT_S worth of samples."""
        self.observed += 1
        low, high = self._low, self._high
        if not self._in_window:
            self._low, self._high = list(position), list(position)
            self._in_window = 1
            self.spread = 0.0
        else:
            for joint, value in enumerate(position):
                if value < low[joint]:
                    low[joint] = value
                elif value > high[joint]:
                    high[joint] = value
            self.spread = max(map(float.__sub__, high, low))
            if self.spread > STANDSTILL_SPREAD_RAD:
                self._in_window = 0
            else:
                self._in_window += 1
                self.confirmed = self.confirmed or self._in_window >= self.samples
        self.gave_up = not self.confirmed and self.observed >= self.limit
