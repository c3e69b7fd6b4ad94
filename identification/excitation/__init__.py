"""Excitation: motions that make a robot's parameters visible, how they are designed, checked, stored and loaded.

`default_trajectory` is the shipped result; `load_trajectory` reads any trajectory file. `design`, `reference`,
`prediction` and the rest are imported by their own names, so that a check of a motion does not load the search for one.
No robot is moved from here.
"""

from __future__ import annotations

from identification.excitation.fourier import FORMAT, FourierTrajectory, Trajectory
from identification.excitation.limits import ExcitationLimits, iiwa_limits, limits_of_robot
from identification.excitation.polynomials import PolynomialTrajectory, SineSeriesTrajectory
from identification.excitation.trajectory_files import (
    TableTrajectory,
    default_trajectory,
    load_trajectory,
    trajectory_from_json,
    validation_trajectory,
)

__all__ = [
    "FORMAT",
    "ExcitationLimits",
    "FourierTrajectory",
    "PolynomialTrajectory",
    "SineSeriesTrajectory",
    "TableTrajectory",
    "Trajectory",
    "default_trajectory",
    "iiwa_limits",
    "limits_of_robot",
    "load_trajectory",
    "trajectory_from_json",
    "validation_trajectory",
]
