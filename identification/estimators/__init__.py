"""Estimators: from an observation (8) to base parameters with σ, and to physical parameters that can exist.

`observation` reads the tall matrix once; `least_squares` solves (9); `semidefinite` finds the best physically
consistent parameters with a certificate; `constrained` solves the paper's program (10); `prior` settles what the data
leave open. The fit ties them together.
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
from identification.estimators.prior import (
    BodyPrior,
    SettledParameters,
    prior_of_bodies,
    settle_open_directions,
    uniform_bodies,
)
from identification.estimators.semidefinite import SemidefiniteResult, solve_semidefinite

__all__ = [
    "BodyPrior",
    "Certificate",
    "CompressedObservation",
    "ConstrainedResult",
    "FeasibilityAnswer",
    "FeasibilityRules",
    "ImpossibleParameter",
    "LeastSquaresResult",
    "Observation",
    "ReducedProblem",
    "SemidefiniteResult",
    "SettledParameters",
    "Violation",
    "compress",
    "impossible_parameters",
    "merge",
    "nearest_physical",
    "prior_of_bodies",
    "rules_for",
    "rules_of_matter",
    "settle_open_directions",
    "solve_constrained",
    "solve_least_squares",
    "solve_semidefinite",
    "uniform_bodies",
    "violations",
]
