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
from identification.excitation.effect_report import TOOL_STRENGTH, ShownEffect, effects_shown
from identification.excitation.fourier import FORMAT, FourierTrajectory, Trajectory
from identification.excitation.limits import ExcitationLimits, iiwa_limits, limits_of_robot
from identification.excitation.local_search import DesignSettings, Stage
from identification.excitation.nominal import nominal_parameters
from identification.excitation.objective import CRITERIA, DETECTABILITY, achieved_figures, mixture_weights
from identification.excitation.polynomials import PolynomialTrajectory, SineSeriesTrajectory
from identification.excitation.prediction import NoiseColour, PredictedDeviations, predict_deviations, torque_noise
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
    "DETECTABILITY",
    "FORMAT",
    "REFERENCE_KINDS",
    "TOOL_STRENGTH",
    "DesignProgress",
    "DesignResult",
    "DesignSettings",
    "ExcitationLimits",
    "FourierTrajectory",
    "NoiseColour",
    "PolynomialTrajectory",
    "PredictedDeviations",
    "ShownEffect",
    "SineSeriesTrajectory",
    "Stage",
    "TableTrajectory",
    "Trajectory",
    "achieved_figures",
    "default_trajectory",
    "design_excitation",
    "effects_shown",
    "iiwa_limits",
    "limits_of_robot",
    "load_trajectory",
    "mixture_weights",
    "nominal_parameters",
    "predict_deviations",
    "reference_trajectory",
    "torque_noise",
    "trajectory_from_json",
    "validation_trajectory",
    "verify",
]
