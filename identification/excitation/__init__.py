"""Excitation: motions that make a robot's parameters visible, how they are designed, checked, stored and loaded.

`design_excitation` solves (13)/(14); `default_trajectory` is the shipped result; `load_trajectory` reads any
trajectory file; `reference_trajectory` makes the motions models are scored on. No robot is moved from here.
"""

from __future__ import annotations

from identification.excitation.constraints import verify
from identification.excitation.design import (
    DesignProgress,
    DesignResult,
    design_excitation,
)
from identification.excitation.fourier import FORMAT, FourierTrajectory, Trajectory
from identification.excitation.limits import ExcitationLimits, iiwa_limits, limits_of_robot
from identification.excitation.local_search import DesignSettings, Stage
from identification.excitation.objective import CRITERIA, achieved_figures
from identification.excitation.polynomials import PolynomialTrajectory, SineSeriesTrajectory
from identification.excitation.prediction import PredictedDeviations, predict_deviations
from identification.excitation.reference import REFERENCE_KINDS, reference_trajectory
from identification.excitation.trajectory_files import (
    TableTrajectory,
    default_trajectory,
    load_trajectory,
    trajectory_from_json,
    validation_trajectory,
)

__all__ = [
    "CRITERIA",
    "FORMAT",
    "REFERENCE_KINDS",
    "DesignProgress",
    "DesignResult",
    "DesignSettings",
    "ExcitationLimits",
    "FourierTrajectory",
    "PolynomialTrajectory",
    "PredictedDeviations",
    "SineSeriesTrajectory",
    "Stage",
    "TableTrajectory",
    "Trajectory",
    "achieved_figures",
    "default_trajectory",
    "design_excitation",
    "iiwa_limits",
    "limits_of_robot",
    "load_trajectory",
    "predict_deviations",
    "reference_trajectory",
    "trajectory_from_json",
    "validation_trajectory",
    "verify",
]
