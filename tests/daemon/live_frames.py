"""Frames of the live view, as tests of it need them."""

from __future__ import annotations

from typing import Any

import numpy as np

from daemon.live.frame import LiveFrame


def frame(**changes: Any) -> LiveFrame:
    known: dict[str, Any] = {
        "run_id": "one", "robot": "iiwa14", "folder": "", "timestamp": 0.0, "position": (0.1,) * 7,
        "torque": (1.0,) * 7, "external_torque": (0.0,) * 7, "phase": "EXCITATION", "period": 0, "periods": 4,
        "rows_per_period": 1000, "rows_per_frame": 10, "sample_in_period": 0,
    }  # fmt: skip
    return LiveFrame(**known | changes)


# ---- motion and model


def sinusoid(amplitude: float, frequency_hz: float, count: int, spacing_s: float = 0.01) -> list[LiveFrame]:
    """Frames of a motion that is known in closed form; each is the mean of ten samples, taken as at their middle."""
    times = np.arange(count) * spacing_s
    return [
        frame(robot_time_s=float(t), position=(amplitude * float(np.sin(2.0 * np.pi * frequency_hz * t)),) * 7)
        for t in times
    ]
