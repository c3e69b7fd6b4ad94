"""A torque that acts in one part of a joint's range only, a bump or a stop: what a name must explain more than.

Nothing of the library holds it and it is never named; where it is likelier than a name, on the fitted and on the
held-out recordings together, the name is not given. Called by the rule of abstention.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from identification.mismatch.effects.base import Estimate, Parameter, Place
from identification.mismatch.effects.describe import joint_name, linear
from identification.mismatch.effects.own_joint import OwnJointEffect
from identification.mismatch.library import Library, Shape
from identification.mismatch.motion import Motion
from identification.mismatch.problem import Problem
from identification.mismatch.refinement import Member, score_of

FloatArray = npt.NDArray[np.float64]

PLACES = 12
"""Quantiles of the position at which a local torque is tried."""
WIDTHS = (0.07, 0.14, 0.28)
"""Widths of bumps, rad (m)."""
STOP_POWERS = (1.0, 2.0, 3.0)
WIDEST_STOP = 0.7
"""Share of the samples beyond which a torque that begins at one place is no stop."""


class LocalTorque(OwnJointEffect):
    """A Gaussian bump at a place, or a power of how far a stop at a place is run into from one side."""

    name = "local_torque"
    code = "local"
    equation = "τ_j = a exp(−((q_j − p)/w)²), or a max(± (q_j − p), 0)ⁿ"
    source = "a form, no physics"
    units = ("Nm",)
    plausible = "any"
    separating_experiment = "Repeat the motion about another centre."

    def own_torque(self, motion: Motion, joint: int, shape: Mapping[str, float]) -> FloatArray:
        """Per unit of the size."""
        beyond = motion.position[:, joint, None] - shape["place"]
        if "width" in shape:
            return np.asarray(np.exp(-((beyond / shape["width"]) ** 2)))
        return np.asarray(np.maximum(shape["side"] * beyond, 0.0) ** shape["power"])

    def parameters(self, estimate: Estimate) -> tuple[Parameter, ...]:
        """The size."""
        return (linear("size", estimate, "Nm"),)

    def sentence(self, estimate: Estimate) -> str:
        """Where it acts."""
        return f"{joint_name(estimate)} has a torque in one part of its range (a curve, not physics)."


LOCAL_TORQUE = LocalTorque()


def best_local(problem: Problem, library: Library, joint: int) -> tuple[float, Member | None]:
    """Score of the best local torque of a joint (from 0), and the torque; (0, None) where nothing acts.

    problem: with everything fitted but what is asked. The choice among places and widths costs what a grid costs.
    """
    shapes = _shapes(np.concatenate([evidence.motion.position[:, joint] for evidence in library.evidences]))
    found = [library.rows(LOCAL_TORQUE, Place(joint=joint + 1), shape) for shape in shapes]
    members = [Member(rows, (0,)) for rows in found if rows is not None]
    if not members:
        return 0.0, None
    best = max(members, key=lambda member: score_of(problem, member))
    return score_of(problem, best) - math.log(len(members)), best


def _shapes(position: FloatArray) -> list[Shape]:
    places = np.quantile(position, np.linspace(0.0, 1.0, PLACES + 2)[1:-1]).tolist()
    shapes: list[Shape] = [(("place", place), ("width", width)) for place in places for width in WIDTHS]
    for side in (1.0, -1.0):
        stops = [place for place in places if float((side * (position - place) > 0.0).mean()) < WIDEST_STOP]
        shapes += [(("place", at), ("side", side), ("power", power)) for at in stops for power in STOP_POWERS]
    return shapes
