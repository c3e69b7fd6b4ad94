"""Arrays behind the figures of a diagnosis: residual curves, spectra, recordings over time. No claims.

Filled in by `localisation` and `summary`; drawn by the report.
"""

from __future__ import annotations

from dataclasses import dataclass

from identification.arrays import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """Residual of one joint against one coordinate, for a figure. No claim of physics.

    joint: from 1. coordinate: what runs along the axis ("velocity", "position", "torque", "travel", "time",
    "period", or "phase" of what repeats), in `unit`.
    centre: (B,) middle of each bin. before, after: (B,) Nm, mean residual in each bin without and with the effect.
    std: (B,) Nm, noise of those means. fitted: (B,) Nm, mean of the effect's own torque, None for a mere residual.
    """

    joint: int
    coordinate: str
    unit: str
    centre: FloatArray
    before: FloatArray
    after: FloatArray
    std: FloatArray
    fitted: FloatArray | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """Residual of every joint over frequency, for a figure.

    frequency: (F,) Hz. before, after, noise: (F, n) Nm, RMS amplitude per spectral line.
    """

    frequency: FloatArray
    before: FloatArray
    after: FloatArray
    noise: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class TimeSeries:
    """One recording over time, for a figure. time: (S,) s; measured, before, after: (S, n) Nm, the last two residuals.

    Within the compared bandwidth. position, velocity: (S, n) rad, rad/s.
    """

    time: FloatArray
    position: FloatArray
    velocity: FloatArray
    measured: FloatArray
    before: FloatArray
    after: FloatArray
