"""The rows of a file before anything was judged: what every reader hands to `cleaning.build_recording`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from identification.recordings.recording import Finding, FloatArray, IntArray


@dataclass(slots=True)
class RawTable:
    """Arrays as they stand in the file; units and signs as in Recording (the reader has already turned the sign).

    time (N,), position (N, n), torque (N, n); optional: (N, n) arrays by their name in Recording.
    period_index, sample_in_period: labels written by the run itself, if any. findings: what the reader saw.
    """

    path: Path
    kind: str
    time: FloatArray
    position: FloatArray
    torque: FloatArray
    optional: dict[str, FloatArray] = field(default_factory=dict)
    period_s: float | None = None
    samples_per_period: int | None = None
    period_index: IntArray | None = None
    sample_in_period: IntArray | None = None
    robot: str | None = None
    joint_names: tuple[str, ...] | None = None
    torque_unit: str = "Nm"
    metadata: dict[str, str] = field(default_factory=dict)
    findings: list[Finding] = field(default_factory=list)
