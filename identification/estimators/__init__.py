"""Estimators: from an observation (8) to base parameters with σ, and to physical parameters that can exist.

`observation` reads the tall matrix once; `least_squares` solves (9); `semidefinite` finds the best physically
consistent parameters with a certificate; `constrained` solves the paper's program (10); `prior` settles what the data
leave open. The fit ties them together.
"""

from __future__ import annotations

from identification.estimators.constrained import solve_constrained
from identification.estimators.feasibility import FeasibilityRules, rules_for, violations
from identification.estimators.least_squares import LeastSquaresResult, solve_least_squares
from identification.estimators.nearest import impossible_parameters, nearest_physical
from identification.estimators.observation import Observation, compress, merge
from identification.estimators.semidefinite import solve_semidefinite

__all__ = [
    "FeasibilityRules",
    "LeastSquaresResult",
    "Observation",
    "compress",
    "impossible_parameters",
    "merge",
    "nearest_physical",
    "rules_for",
    "solve_constrained",
    "solve_least_squares",
    "solve_semidefinite",
    "violations",
]
