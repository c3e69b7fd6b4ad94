"""Do the recorded velocities go with the recorded positions, each with its own? No model is asked. Pure.

Nothing is ever computed from a recorded velocity but what the clock and the units say: here it is a witness.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identification.arrays import BoolArray, FloatArray
from identification.recordings.recording import Finding, Recording

WINDOW_S = 0.02
"""Over which both are averaged: noise and steps of an encoder count less."""
MOVES = 0.1
"""Of the quickest joint's spread of speed, what a joint needs at least to be judged."""
LEAST_CORRELATION = 0.8
"""Of a velocity with the change of its own position, where the two are one motion."""


@dataclass(frozen=True, slots=True, eq=False)
class WindowedRates:
    """derived, recorded: (W, n) mean rate of change of the position and mean recorded velocity over the same windows,
    nan in `recorded` where a joint has no velocity.
    """

    derived: FloatArray
    recorded: FloatArray

    @property
    def moving(self) -> BoolArray:
        """(n,) joints that move enough to be judged, compared with the quickest."""
        spread = self.derived.std(axis=0)
        return np.asarray(spread > MOVES * spread.max())

    @classmethod
    def of(cls, recording: Recording) -> WindowedRates | None:
        """None where nothing was recorded, or too few rows without a gap."""
        if recording.velocity is None:
            return None
        even = np.diff(recording.time) < 1.5 * recording.sampling_period_s
        width = max(1, round(WINDOW_S / recording.sampling_period_s))
        first = np.flatnonzero(np.convolve(even, np.ones(2 * width), "valid") == 2 * width)
        if first.size < 10 * width:
            return None
        last = first + 2 * width
        duration = (recording.time[last] - recording.time[first])[:, None]
        total = np.concatenate([np.zeros((1, recording.n)), np.cumsum(recording.velocity, axis=0)])
        derived = (recording.position[last] - recording.position[first]) / duration
        return cls(derived, (total[last] - total[first]) / (2 * width))


def unlike_velocities(recording: Recording) -> tuple[Finding, ...]:
    """What the velocities of moving joints say against the order of the columns; a wrong unit or sign is not asked."""
    rates = WindowedRates.of(recording)
    if rates is None:
        return ()
    known = rates.moving & np.isfinite(rates.recorded).all(axis=0)
    alike = _correlation(rates.recorded, rates.derived)
    rows, findings, alone = recording.report.rows_read, [], []
    for joint in np.flatnonzero(known & (np.diag(alike) < LEAST_CORRELATION)).tolist():
        other = int(np.where(rates.moving, alike[joint], 0.0).argmax())
        if alike[joint, other] < LEAST_CORRELATION:
            alone.append(str(joint + 1))
            continue
        sentence = (
            f"joint {joint + 1}: the recorded velocity is the derivative of joint {other + 1}'s position; one of the "
            "two stands under another joint"
        )
        findings.append(Finding.of_all("wrong_joint_order", rows, sentence, joint + 1))
    if alone:
        sentence = f"joint {', '.join(alone)}: the recorded velocity is the derivative of no position; it is not used"
        findings.append(Finding.of_all("unlikely_value", rows, sentence))
    return tuple(findings)


def _correlation(recorded: FloatArray, derived: FloatArray) -> FloatArray:
    """(n, n) size of the correlation of each recorded velocity with the change of each position; 0 of one at rest."""
    a, b = (values - values.mean(axis=0) for values in (np.nan_to_num(recorded), derived))
    sizes = np.outer(np.linalg.norm(a, axis=0), np.linalg.norm(b, axis=0))
    return np.asarray(np.divide(np.abs(a.T @ b), sizes, out=np.zeros_like(sizes), where=sizes > 0.0))
