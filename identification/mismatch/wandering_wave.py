"""A wave over the angle whose order is any number and drifts: what a wave of a named order must explain more than.

Gears, bearings and sensors repeat a whole number of times per turn, or with the gear's ratio, over the whole range.
Nothing of the library drifts, and this is never named. Called by `local_torque`, which compares.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize

from identification.mismatch.effects.base import Estimate, Parameter
from identification.mismatch.effects.own_joint import OwnJointEffect
from identification.mismatch.effects.position_dependent_torque import PositionDependentTorque
from identification.mismatch.effects.torque_ripple import TorqueRipple
from identification.mismatch.library import Library
from identification.mismatch.motion import Motion
from identification.mismatch.problem import Problem
from identification.mismatch.refinement import Member, score_of
from identification.mismatch.settings import DiagnosisSettings

FloatArray = npt.NDArray[np.float64]

PHASES = (-0.5, -0.2, 0.0, 0.2, 0.5)
"""Turns of phase at the ends of the range, by order and by drift, from which the refinement starts."""
EVALUATIONS = 60


class WanderingWave(OwnJointEffect):
    """A named wave at the angle q + d (q − p)²/N, N any number. Never named: it has no words for itself."""

    code = "wandering"
    equation = "τ_j = a sin(N q_j + d (q_j − p)²) + b cos(N q_j + d (q_j − p)²)"
    source = "a form, no physics"
    units = ("Nm", "Nm")
    plausible = "any"
    separating_experiment = "Repeat the motion about another centre."
    wave: ClassVar[OwnJointEffect]

    def own_torque(self, motion: Motion, joint: int, shape: Mapping[str, float]) -> FloatArray:
        """Sine and cosine, as the named wave has them."""
        position = motion.position.copy()
        position[:, joint] += shape["drift"] / shape["order"] * (position[:, joint] - shape["place"]) ** 2
        return self.wave.own_torque(replace(motion, position=position), joint, shape)

    def parameters(self, estimate: Estimate) -> tuple[Parameter, ...]:
        """None."""
        del estimate
        return ()

    def sentence(self, estimate: Estimate) -> str:
        """None."""
        del estimate
        return ""


class WanderingTorque(WanderingWave):
    """Of a low order."""

    name = "wandering_torque"
    wave = PositionDependentTorque()


class WanderingRipple(WanderingWave):
    """Of a gear's order."""

    name = "wandering_ripple"
    wave = TorqueRipple()


WAVES: Mapping[str, WanderingWave] = {form.wave.name: form for form in (WanderingTorque(), WanderingRipple())}


def wandering(
    problem: Problem, library: Library, wave: Member, settings: DiagnosisSettings
) -> tuple[float, Member] | None:
    """Score and torque of a wave's best wandering form, which costs what the named one does and what a form that holds
    it as a special case must bring; None for what is no wave. problem: with everything fitted but the wave.
    """
    form = WAVES.get(wave.effect.name)
    if form is None or wave.place.joint is None:
        return None
    position = np.concatenate([evidence.motion.position[:, wave.place.joint - 1] for evidence in library.evidences])
    middle, half = float(position.mean()), max(0.5 * float(np.ptp(position)), 1e-3)

    def at(turns: FloatArray) -> Member | None:
        order = wave.shape["order"] + float(turns[0]) * 2.0 * math.pi / half
        if order < 1.0:
            return None
        drift = float(turns[1]) * 2.0 * math.pi / half**2
        shape = {**wave.shape, "order": order, "drift": drift, "place": middle}
        rows = library.rows(form, wave.place, tuple(shape.items()))
        return None if rows is None else Member(rows, wave.selection)

    def loss(turns: FloatArray) -> float:
        member = at(turns)
        return 1e300 if member is None else -score_of(problem, member)

    starts = [np.array([first, second]) for first in PHASES for second in PHASES]
    start = min(starts, key=loss)
    simplex = start + np.array([[0.0, 0.0], [0.1, 0.0], [0.0, 0.1]])
    best = minimize(
        loss,
        start,
        method="Nelder-Mead",
        options={"maxfev": EVALUATIONS, "initial_simplex": simplex, "xatol": 1e-3, "fatol": 0.05},
    )
    found = at(best.x)
    if found is None:
        return None
    return score_of(problem, found) - wave.rows.cost - settings.margin_of_simplicity, found
