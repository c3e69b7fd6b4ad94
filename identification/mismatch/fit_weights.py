"""Rows weighted as `fit` weighs them, beside names or without, so that models are compared and not estimators.

Here: which weights. Not here: what is fitted with them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from identification.arrays import FloatArray
from identification.estimators.least_squares import solve_least_squares
from identification.estimators.observation import CompressedObservation
from identification.fitting.blocks import line_variances
from identification.mismatch.aperiodic_evidence import weighted_by_joint
from identification.mismatch.prepared import Prepared
from identification.mismatch.problem import Problem, reweighted
from identification.mismatch.search.refinement import Member, columns_of


def without_periods(problem: Problem, fitted: Prepared, members: Sequence[Member]) -> Problem:
    """Each joint counts by what base parameters and members leave of it, all bands alike."""
    level = _levels(problem, np.ones_like(problem.noise), members)
    return replace(fitted, evidences=weighted_by_joint(fitted.evidences, level)).problem()


def with_periods(problem: Problem) -> Problem:
    """Each joint and line counts by its noise, or by what is left there where that is more (`line_variances`).

    As the fit by maximum likelihood has it: each joint by what is left of it, then each line, then each joint again.
    """
    level = np.tile(_levels(problem, np.ones_like(problem.noise))[:, None], problem.rows)
    left = _in_nm(problem, reweighted(problem, level / problem.noise))
    deviation = np.empty_like(left)
    for index in np.unique(problem.evidence):
        own = problem.evidence == index
        variance = line_variances(left[:, own].T, problem.noise[:, own].T, np.zeros(problem.n))
        deviation[:, own] = np.sqrt(variance).T
    level = _levels(problem, deviation)
    return reweighted(problem, level[:, None] * deviation / problem.noise)


def _in_nm(plain: Problem, problem: Problem) -> FloatArray:
    """(n, R) Nm that the base parameters of a problem leave, zero where rows do not count."""
    used = plain.weight > 0.0
    return np.where(used, problem.residual.reshape(used.shape) / np.where(used, problem.weight, 1.0), 0.0)


def _levels(problem: Problem, deviation: FloatArray, members: Sequence[Member] = ()) -> FloatArray:
    """(n,) deviation of each joint's rows, in units of `deviation` (n, R), where each joint counts by its own.

    members: fitted along.
    """
    used = problem.weight > 0.0
    columns = np.column_stack([problem.basis, columns_of(problem, members), problem.torque])
    rows = columns.reshape(*used.shape, -1) / np.where(used, problem.weight * deviation, np.inf)[..., None]
    names = tuple(map(str, range(rows.shape[2] - 1)))
    factors = np.asarray(np.linalg.qr(rows, mode="r"), dtype=np.float64)
    observation = CompressedObservation(factors, used.sum(axis=1), names)
    return np.asarray(1.0 / np.sqrt(solve_least_squares(observation).weights), dtype=np.float64)
