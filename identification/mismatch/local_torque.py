"""A torque that acts in one part of a joint's range only, a bump or a stop: what a name must explain more than.

Nothing of the library holds it and it is never named; where it is likelier than a name, on the fitted and on the
held-out recordings together, each with the parameters that the fitted ones give it, the name is not given. Called by
the rule of abstention.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize_scalar

from identification.mismatch.effects.base import Estimate, Parameter, Place
from identification.mismatch.effects.describe import joint_name, linear
from identification.mismatch.effects.own_joint import OwnJointEffect
from identification.mismatch.library import Library
from identification.mismatch.motion import Motion
from identification.mismatch.problem import Problem
from identification.mismatch.refinement import Member, score_of
from identification.mismatch.settings import DiagnosisSettings
from identification.mismatch.trial import Trial, fitted
from identification.mismatch.wandering_wave import wandering

FloatArray = npt.NDArray[np.float64]

PLACES = 12
"""Quantiles of the position at which a local torque is tried."""
WIDTHS = (0.07, 0.14, 0.28)
"""Widths of bumps, rad (m)."""
STOP_POWERS = (1.0, 2.0, 3.0)
WIDEST_STOP = 0.7
"""Share of the samples beyond which a torque that grows in proportion from one place on is a spring, and no stop."""
EVALUATIONS = 10
"""In which a place is refined between its neighbours."""
WORTH_ASKING = 0.5
"""Share of what the names explain on the fitted recordings below which held-out ones are not asked."""


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


def local_is_likelier(
    nominal: Problem,
    library: Library,
    trial: Trial,
    index: int,
    joint: int,
    held_out: Callable[[Sequence[Member]], float],
    settings: DiagnosisSettings,
) -> bool:
    """Whether a local torque, or a wave of no fixed order, is likelier than a member or all members of its joint.

    A stop may be written as a spring and an eccentricity that bend to it in turn. Where the members leave more than
    noise, the likelier one is that which does not. joint: from 0, on which the member shows most. held_out:
    log-likelihood that a set of members gives the held-out recordings; 0 without any.
    """
    if not nominal.noise_is_measured:
        return False
    there = held_out(trial.members) if trial.complete else 0.0
    own = [place for place, item in enumerate(trial.members) if item.rows.joints == (joint,)]
    for replaced in ([index], own) if index in own and len(own) > 1 else ([index],):
        others = [item for place, item in enumerate(trial.members) if place not in replaced]
        rest = fitted(nominal, others, settings, trial)
        known = 0.5 * (rest.penalised - trial.penalised)
        rivals = [*local_torques(rest.problem, library, joint)]
        wave = wandering(rest.problem, library, trial.members[index], settings) if replaced == [index] else None
        rivals = sorted([*rivals, wave] if wave is not None else rivals, key=lambda item: -item[0])
        if not trial.complete:
            if rivals and fitted(nominal, [*others, rivals[0][1]], settings, trial).complete:
                return True
            continue
        for score, rival in rivals:
            if score > WORTH_ASKING * known and score + held_out([*others, rival]) > known + there:
                return True
    return False


def local_torques(problem: Problem, library: Library, joint: int) -> Iterator[tuple[float, Member]]:
    """Scores and torques, the best of each width and of each side and power; the choice costs what a grid costs.

    problem: with everything fitted but what is asked.
    """
    position = np.concatenate([evidence.motion.position[:, joint] for evidence in library.evidences])
    places = np.quantile(position, np.linspace(0.0, 1.0, PLACES + 2)[1:-1]).tolist()
    kinds: list[tuple[dict[str, float], list[float]]] = [({"width": width}, places) for width in WIDTHS]
    for side in (1.0, -1.0):
        stops = [place for place in places if float((side * (position - place) > 0.0).mean()) < WIDEST_STOP]
        kinds += [({"side": side, "power": power}, places if power > 1.0 else stops) for power in STOP_POWERS]
    cost = math.log(sum(len(allowed) for _, allowed in kinds))
    for kind, allowed in kinds:
        found = _at_best_place(problem, library, joint, kind, allowed) if allowed else None
        if found is not None:
            yield score_of(problem, found) - cost, found


def _at_best_place(
    problem: Problem, library: Library, joint: int, kind: Mapping[str, float], places: Sequence[float]
) -> Member | None:
    """The torque of one kind at the place where it explains most; None where it does not act."""

    def at(place: float) -> Member | None:
        rows = library.rows(LOCAL_TORQUE, Place(joint=joint + 1), (("place", float(place)), *kind.items()))
        return None if rows is None else Member(rows, (0,))

    def score(place: float) -> float:
        member = at(place)
        return -math.inf if member is None else score_of(problem, member)

    scores = [score(place) for place in places]
    best = int(np.argmax(scores))
    near = (places[max(best - 1, 0)], places[min(best + 1, len(places) - 1)])
    refined = minimize_scalar(
        lambda place: -score(place), bounds=near, method="bounded", options={"maxiter": EVALUATIONS}
    )
    return at(refined.x if -refined.fun > scores[best] else places[best])
