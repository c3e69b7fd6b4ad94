"""Whether what stays beside a named effect is another form of the same torque.

A weak effect of unknown form and a library effect of nearly that form leave a rest that drowns in the power of a band:
many rows, little misfit. Here the rest is asked along a few smooth functions of the joint's own state, where such a
rest gathers. Called by the rule of abstention; names nothing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy.stats import chi2

from identification.mismatch.effects.own_joint import friction_sign
from identification.mismatch.evidence import Evidence
from identification.mismatch.motion import Motion
from identification.mismatch.problem import Problem
from identification.mismatch.refinement import gram_of_rows
from identification.mismatch.screening import group_gain

FloatArray = npt.NDArray[np.float64]

KNOTS = 10
"""Hat functions per coordinate, at quantiles of the joint's motion."""


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
