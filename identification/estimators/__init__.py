"""Estimators: from an observation (8) to base parameters with σ, and to physical parameters that can exist.

`observation` reads the tall matrix once; `least_squares` solves (9); `semidefinite` finds the best physically consistent
parameters with a certificate; `constrained` solves the paper's program (10). `fit` ties them together.
"""

from __future__ import annotations

from identification.estimators.least_squares import LeastSquaresResult, solve_least_squares
from identification.estimators.observation import (
    CompressedObservation,
    Observation,
    ReducedProblem,
    compress,
    merge,
)
from identification.estimators.physical import PhysicalParameters

__all__ = [
    "CompressedObservation",
    "LeastSquaresResult",
    "Observation",
    "PhysicalParameters",
    "ReducedProblem",
    "compress",
    "merge",
    "solve_least_squares",
]
