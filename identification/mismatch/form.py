"""Whether what stays beside a named effect is another form of the same torque.

A weak effect of unknown form and a library effect of nearly that form leave a rest that drowns in the power of a band:
many rows, little misfit. Here the rest is asked along a few smooth functions of the joint's own state, where such a
rest gathers; and whether a torque that acts in one part of the range only explains more than the name does. Called by
the rule of abstention; names nothing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy.stats import chi2

from identification.mismatch.effects.own_joint import friction_sign
from identification.mismatch.evidence import Evidence
from identification.mismatch.motion import Motion
from identification.mismatch.problem import SWALLOWED, Problem
from identification.mismatch.refinement import gram_of_rows
from identification.mismatch.screening import group_gain

FloatArray = npt.NDArray[np.float64]

KNOTS = 10
"""Hat functions per coordinate, at quantiles of the joint's motion."""
LOCAL_PLACES = 12
"""Quantiles of the position at which a local torque is tried."""
LOCAL_WIDTHS = (0.07, 0.14, 0.28)
"""Widths of bumps, rad (m)."""
STOP_POWERS = (1, 2, 3)
WIDEST_STOP = 0.7
"""Share of the samples beyond which a torque that begins at one place is no stop."""


def left_in_other_form(problem: Problem, evidences: Sequence[Evidence], joint: int, probability: float) -> float:
    """Whitened squares of a joint's residual (from 0) that some smooth function of its state would still remove.

    Functions of the position, of the velocity, and of the position times the direction of motion are each tried as a
    group; only what noise has less than `probability` of making is counted, and of several groups the largest. problem:
    with all that is claimed fitted along, whitened by the noise.
    """
    most = 0.0
    columns = [_state_functions(evidence, joint) for evidence in evidences]
    for group in zip(*columns, strict=True):
        gain, used = group_gain(*gram_of_rows(problem, (joint,), np.concatenate(group)[None]))
        if chi2.sf(gain, used) < probability:
            most = max(most, gain - used)
    return most


def _state_functions(evidence: Evidence, joint: int) -> tuple[FloatArray, ...]:
    """Three groups of columns (R, KNOTS)."""
    motion: Motion = evidence.motion
    position = hats(motion.position[:, joint])
    velocity = hats(motion.velocity[:, joint])
    directed = position * friction_sign(motion, joint)[:, None]
    groups = (evidence.project(values) for values in (position, velocity, directed))
    return tuple(np.asarray(item, dtype=np.float64) for item in groups)


def hats(values: FloatArray, number: int = KNOTS) -> FloatArray:
    """(S, number) piecewise linear functions that sum to one; knots at quantiles, fewer where these coincide."""
    knots = np.unique(np.quantile(values, np.linspace(0.0, 1.0, number)))
    return np.stack([np.interp(values, knots, unit) for unit in np.eye(knots.size)], axis=1)


def best_local_score(problem: Problem, evidences: Sequence[Evidence], joint: int) -> float:
    """Score of the best torque that acts in a part of a joint's (from 0) range only: a bump, or a stop at one end.

    problem: with everything fitted but what is asked. The choice among places and widths costs what a grid costs.
    """
    blocks = [evidence.project(_local(evidence.motion.position[:, joint])) for evidence in evidences]
    columns = (np.concatenate(blocks).T * problem.weight[joint]).T
    basis = problem.basis.reshape(problem.n, problem.rows, -1)[joint]
    residual = problem.residual.reshape(problem.n, problem.rows)[joint]
    length = (columns**2).sum(axis=0)
    left = length - ((basis.T @ columns) ** 2).sum(axis=0)
    seen = left > SWALLOWED * length
    gain = np.where(seen, (columns.T @ residual) ** 2 / np.where(seen, left, 1.0), 0.0)
    return 0.5 * float(gain.max(initial=0.0)) - float(np.log(gain.size))


def _local(position: FloatArray) -> FloatArray:
    """(S, m) bumps over the range, and powers of how far a stop is run into, from either end."""
    places = np.quantile(position, np.linspace(0.0, 1.0, LOCAL_PLACES + 2)[1:-1])
    columns = [np.exp(-(((position - place) / width) ** 2)) for place in places for width in LOCAL_WIDTHS]
    for side in (1.0, -1.0):
        depth = [np.maximum(side * (position - place), 0.0) for place in places]
        columns += [item**power for item in depth if (item > 0.0).mean() < WIDEST_STOP for power in STOP_POWERS]
    return np.stack(columns, axis=1)
