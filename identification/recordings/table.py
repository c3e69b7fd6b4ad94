"""The rows of a file before anything was judged: what every reader hands to `cleaning.build_recording`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from identification.arrays import BoolArray, FloatArray, IntArray
from identification.recordings.recording import Finding
from identification.robots.installation import ON_THE_FLOOR, Installation


@dataclass(slots=True)
class RawTable:
    """Arrays as they stand in the file; signs as in Recording (the reader has already turned them).

    units: of t, q, dq and tau where the file states them; `units.in_si` turns all to those of Recording.

    time (N,), position (N, n), torque (N, n); optional: (N, n) arrays by their name in Recording.
    period_s: None where none is stated, 0 where it is said that nothing repeats.
    period_index, sample_in_period: labels written by the run itself, if any. findings: what the reader saw.
    named: (N, n) whether the row's message names the joint, None where rows are not messages; not the same as a value
    that is not finite. topic: where the rows stand in a bag that has several.
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
    installation: Installation = ON_THE_FLOOR
    units: dict[str, str] = field(default_factory=dict)
    torque_unit: str = "Nm"
    named: BoolArray | None = None
    topic: str = ""
    metadata: dict[str, str] = field(default_factory=dict)
    findings: list[Finding] = field(default_factory=list)
