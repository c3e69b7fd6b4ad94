"""A gentle motion beside the pose in which the fake robot begins: for tests of which the motion is not the subject."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from identification.excitation import FourierTrajectory, default_trajectory

NEAR_THE_ROBOT = (0.1, 0.4, -0.1, -1.2, 0.1, 0.9, 0.1)
"""rad; so near to where the fake robot begins that the start ramp is short."""


def short_trajectory(
    file: Path,
    *,
    period_s: float = 2.0,
    scale: float = 0.05,
    offset: tuple[float, ...] | None = NEAR_THE_ROBOT,
) -> Path:
    """The file with so much of the shipped motion, about `offset` (None: about its own), in a period of its own.

    Its preflight looks at that many rows instead of ten thousand, and a run at that many messages.
    """
    shipped = default_trajectory()
    middle = shipped.offset if offset is None else np.array(offset)
    short = FourierTrajectory(1.0 / period_s, scale * shipped.a, scale * shipped.b, middle, shipped.robot)
    file.write_text(json.dumps(short.to_json()))
    return file
