"""How sharply the friction of the whole arm turns over, where the nominal model's sign(q̇) is too sharp.

Dry friction changes its sign over a small velocity, on a real arm and in most simulators (tanh(q̇/v) there). Where that
is wide enough to show, the nominal model misfits at every reversal of every joint, and effects of friction would be
named on all of them. That is one property of the nominal friction law and no missing physics of a joint. Called by the
diagnosis, which searches again with the wider transition and keeps it where that explains more.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from identification.base_parameters import BaseRegressor, direction_of
from identification.mismatch.evidence import Evidence
from identification.mismatch.prepared import Prepared
from identification.mismatch.problem import Problem, build_problem
from identification.mismatch.search import SearchResult
from identification.mismatch.settings import DiagnosisSettings
from identification.mismatch.trial import fitted as with_members

FloatArray = npt.NDArray[np.float64]

GRID = (1e-3, 2e-3, 5e-3, 1e-2, 2e-2, 5e-2)
"""Velocities of the transition that are tried, rad/s (m/s): narrower ones lie within what standstills leave out."""
STEPS = 9
SAME = 0.02
"""Share of a width by which another one is the same."""
AT_REVERSALS = ("stribeck_friction", "presliding_hysteresis")
"""Effects whose torque gathers where friction turns over: fitted along, they would hide its width."""
GOLDEN = (np.sqrt(5.0) - 1.0) / 2.0


def transition_velocity(
    problem: Problem, fitted: Prepared, regressor: BaseRegressor, result: SearchResult, settings: DiagnosisSettings
) -> float | None:
    """Velocity v (rad/s) with which tanh(q̇/v) fits all joints better; None where the regressor's own transition stands.

    The nominal model with the one is compared with the nominal model with the other: as many parameters, but for v.
    The joint that gains most has no say: what one joint alone asks for is an effect of that joint. The others must gain
    what an effect must (`complete_score`) against sign(q̇). Once there is a width, it is measured again beside the
    effects found with it. A single effect that explains everything, and more than the width does, stands. Not asked
    where nothing is left to explain, nor where the noise is not measured.
    """
    known = regressor.options.coulomb_velocity
    clean = result.trial.complete and not result.trial.members
    if (clean and known == 0.0) or not problem.noise_is_measured or not regressor.options.coulomb:
        return None
    beside = [item for item in result.trial.members if known > 0.0 and item.effect.name not in AT_REVERSALS]

    def squares(velocity: float) -> FloatArray:
        seen = [_with_transition(item, regressor, velocity) for item in fitted.evidences]
        left = with_members(build_problem(seen, fitted.torque, fitted.nuisance), beside, settings).problem.residual
        return np.asarray((left.reshape(problem.n, -1) ** 2).sum(axis=1))

    now = squares(known)

    def gained(velocity: float) -> float:
        gain = 0.5 * (now - squares(velocity))
        return float(gain.sum() - gain.max())

    gains = [gained(velocity) for velocity in GRID]
    best = int(np.argmax(gains))
    if known == 0.0 and gains[best] < settings.complete_score:
        return None
    low, high = np.log(GRID[max(best - 1, 0)]), np.log(GRID[min(best + 1, len(GRID) - 1)])
    for _ in range(STEPS):
        inner, outer = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
        low, high = (low, outer) if gained(np.exp(inner)) > gained(np.exp(outer)) else (inner, high)
    velocity = float(np.exp(0.5 * (low + high)))
    alone = result.trial.complete and len(result.trial.members) == 1 and known == 0.0
    if alone and float(squares(velocity).sum()) >= result.trial.penalised:
        return None  # a common lag blunts friction as well, and explains more
    return velocity if abs(velocity - known) > SAME * velocity else None


def explains_better(other: SearchResult, result: SearchResult, settings: DiagnosisSettings, *, first: bool) -> bool:
    """Whether a search with another transition is to be kept: it is complete with less, or leaves much less.

    Every effect costs `complete_score`, and so does the width itself where it is new (`first`).
    """
    if other.trial.complete != result.trial.complete:
        return other.trial.complete
    if other.trial.complete:
        name = 2.0 * settings.complete_score
        with_it, without_it = (item.trial.penalised + name * len(item.trial.members) for item in (other, result))
        return with_it + (name if first else 0.0) < without_it
    gained = (other.trial.likelihood - other.trial.cost) - (result.trial.likelihood - result.trial.cost)
    return gained > settings.background_score


def transition_sentence(velocity: float) -> str:
    """What the reader is told of it."""
    return (
        f"The friction of the whole arm turns over between about ±{1000.0 * velocity:.1f} mrad/s (tanh(q̇/v)), which "
        "sign(q̇) is too sharp for; the nominal model was given that width, and nothing of it is called missing physics"
    )


def _with_transition(evidence: Evidence, regressor: BaseRegressor, velocity: float) -> Evidence:
    """The evidence with the Coulomb columns of another transition; 0: sign(q̇)."""
    nominal = evidence.nominal.copy()
    for joint in range(evidence.n):
        name = f"FS_{joint + 1}"
        if name in regressor.names:
            turning = direction_of(evidence.motion.velocity[:, joint], velocity)
            nominal[:, joint, regressor.position_of(name)] = evidence.project(turning[:, None])[:, 0]
    return replace(evidence, nominal=nominal)
