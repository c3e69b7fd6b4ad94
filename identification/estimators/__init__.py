"""Estimators: from an observation (8) to base parameters with σ, and to physical parameters that can exist.

`observation` reads the tall matrix once; `least_squares` solves (9); `semidefinite` finds the best physically
consistent parameters with a certificate; `constrained` solves the paper's program (10). The fit ties them together.
"""

from __future__ import annotations

from identification.estimators.constrained import Certificate, ConstrainedResult, solve_constrained
from identification.estimators.feasibility import FeasibilityRules, Violation, rules_for, rules_of_matter, violations
from identification.estimators.least_squares import LeastSquaresResult, solve_least_squares
from identification.estimators.nearest import (
    FeasibilityAnswer,
    ImpossibleParameter,
    impossible_parameters,
    nearest_physical,
)
from identification.estimators.observation import (
    CompressedObservation,
    Observation,
    ReducedProblem,
    compress,
    merge,
)
from identification.estimators.physical import PhysicalParameters
from identification.estimators.semidefinite import SemidefiniteResult, solve_semidefinite

__all__ = [
    "Certificate",
    "CompressedObservation",
    "ConstrainedResult",
    "FeasibilityAnswer",
    "FeasibilityRules",
    "ImpossibleParameter",
    "LeastSquaresResult",
    "Observation",
    "PhysicalParameters",
    "ReducedProblem",
    "SemidefiniteResult",
    "Violation",
    "compress",
    "impossible_parameters",
    "merge",
    "nearest_physical",
    "rules_for",
    "rules_of_matter",
    "solve_constrained",
    "solve_least_squares",
    "solve_semidefinite",
    "violations",
]
