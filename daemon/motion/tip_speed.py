"""How fast the end-effector goes along a table, and what the test mode T1 allows."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from safety.geometry import RobotGeometry

T1_SPEED_M_S = 0.25
"""Of the tool in the test mode T1 (ISO 10218-1: reduced speed)."""


def tip_speed(geometry: RobotGeometry, table: NDArray[np.float64], table_period_s: float) -> float:
    """Largest speed of the end of the tool, m/s, along one period, (N, n) rad, that is repeated without a break."""
    return path_speed(geometry, np.vstack([table, table[:1]]), table_period_s)


def path_speed(geometry: RobotGeometry, path: NDArray[np.float64], period_s: float) -> float:
    """The same along a path, (N, n) rad, that ends."""
    return float(np.linalg.norm(np.diff(geometry.tip_path(path), axis=0), axis=1).max(initial=0.0)) / period_s


def rounded_up(speed_m_s: float) -> float:
    """m/s, up to a whole mm/s: beside a limit the nearest number could deny what was found of it."""
    return 1e-3 * math.ceil(1e3 * speed_m_s)
