"""One search per effect that changes between periods: a scan over contrasts, then a refinement of time and shape.

Each function returns the best candidate of its family on the contrasts as they are, with the chance that noise alone
makes it. What to claim, to subtract and to merge is decided in `between_periods`.
"""

from __future__ import annotations

from collections.abc import Collection
from itertools import pairwise

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.changes.candidates import (
    Candidate,
    best_moment,
    dispersion_of,
    fit_of,
    hopeless,
    inflated,
    refined_shape,
    spread_of,
)
from identification.mismatch.changes.contrasts import Contrasts, Fit, solve
from identification.mismatch.effects.base import Place
from identification.mismatch.effects.own_joint import joint_index
from identification.mismatch.effects.payload_change import PayloadChange
from identification.mismatch.effects.thermal_friction import ThermalFriction
from identification.mismatch.effects.torque_sensor_drift import EXPONENTIAL, LINEAR, STEP, TorqueSensorDrift
from identification.mismatch.settings import PRIOR_COST

LONGEST_TIME = 5.0
"""Recordings' lengths beyond which a fading course is a straight line, to a fortieth: no time constant is told."""
PAYLOAD_SCAN = slice(0, 4)
"""Mass and first moments; the inertia about the joint adds little to the detection."""
PAYLOAD_PROVEN = -6.0
"""log10 of the chance of all ten parameters below which all are fitted; else the inertia is left at zero."""
MOMENTS_PER_PERIOD = 3.0
"""How many moments of a change the best of all is worth: with these, noise alone comes below a chance of p in a share p
of recordings (280 of white and slow noise on three motions; 4 % below 0.1, 1 % below 0.01)."""


def find_drift(contrasts: Contrasts, effect: TorqueSensorDrift, closed: Collection[int]) -> Candidate | None:
    """The joint (not in `closed`, from 0) and course whose constant torque differs most between the periods."""
    starts = contrasts.motion.start_s
    last = float(starts[-1] + contrasts.motion.time[-1])
    times = np.geomspace(0.5 * (starts[1] - starts[0]), last, 5)
    courses = [(LINEAR, 0.0, starts)]
    courses += [(EXPONENTIAL, float(t), np.exp(-starts / t)) for t in times]
    courses += [(STEP, float(t), (starts >= t).astype(float)) for t in starts[1:]]
    weights = np.array([weight - weight.mean() for _, _, weight in courses])
    weights /= np.linalg.norm(weights, axis=1, keepdims=True)
    gains = (weights @ contrasts.z[:, 0]) ** 2
    gains[:, list(closed)] = 0.0
    joint = int(np.unravel_index(np.argmax(gains), gains.shape)[1])
    if hopeless(float(gains[:, joint].max()), 1, gains.size):
        return None
    place = Place(joint=joint + 1)
    best: dict[int, tuple[dict[str, float], Fit]] = {}
    for course, first, last_bound in ((LINEAR, 0.0, 0.0), (EXPONENTIAL, times[0], 3.0 * last), (STEP, 0.0, last)):
        choices = [index for index, (kind, _, _) in enumerate(courses) if kind == course]
        index = max(choices, key=lambda choice: float(gains[choice, joint]))
        shape = {"course": float(course), "time_s": courses[index][1]}
        if course == EXPONENTIAL:
            shape = refined_shape(contrasts, effect, place, shape, "time_s", (float(first), float(last_bound)))
        elif course == STEP:
            period = float(starts[1] - starts[0])
            for width in (period, 0.1 * period, 0.01 * period):
                moment = best_moment(
                    lambda time: fit_of(contrasts, effect, place, {"course": float(STEP), "time_s": time}).gain,
                    shape["time_s"], width, last,
                )  # fmt: skip
                shape = {"course": float(STEP), "time_s": moment}
        best[course] = (shape, fit_of(contrasts, effect, place, shape))
    # A course with a time of its own costs what a hypothesis does.
    chosen = max(best, key=lambda course: best[course][1].gain - (2.0 * PRIOR_COST if course != LINEAR else 0.0))
    shape, fit = best[chosen]
    if chosen == LINEAR:
        shape = {"course": float(LINEAR)}
    rest = contrasts.z[:, 0, joint] @ contrasts.z[:, 0, joint] - gains[:, joint].max()
    dispersion = dispersion_of(rest, contrasts.periods - 2)
    # The linear course has half of the chance of a false alarm to itself; the others share the other half.
    tests = 2.0 * contrasts.evidence.n * (1 if chosen == LINEAR else len(courses) - 1)
    chance = fit.log10_chance(tests, int(chosen != LINEAR), dispersion)
    std = {} if chosen == LINEAR else spread_of(contrasts, effect, place, shape, "time_s", fit.gain)
    return Candidate(effect, place, shape, inflated(fit, dispersion), chance, tests, std, dispersion)


def find_thermal(contrasts: Contrasts, effect: ThermalFriction, closed: Collection[int]) -> Candidate | None:
    """The joint whose friction fades most over the periods."""
    motion, starts = contrasts.motion, contrasts.motion.start_s
    best: tuple[float, Place, float] | None = None
    rests: dict[Place, float] = {}
    parameter = effect.shape_parameters(motion, Place())[0]
    longest = min(parameter.upper, LONGEST_TIME * float(starts[-1] + motion.time[-1]))
    grid = [time for time in parameter.grid if time < longest] or [longest]
    places = [place for place in effect.places(motion) if joint_index(place) not in closed]
    for place in places:
        found = contrasts.repeated(effect, place, {})
        if found is None:
            continue
        white = contrasts.whiten_repeated(found[2], found[0])[:, 0]
        basis = np.linalg.qr(white)[0]
        seen = contrasts.z[:, :, joint_index(place)] @ basis
        for time in grid:
            weight = np.exp(-starts / time)
            weight = (weight - weight.mean()) / np.linalg.norm(weight - weight.mean())
            gain = float(np.sum((weight @ seen) ** 2))
            if best is None or gain > best[0]:
                best = (gain, place, time)
                rests[place] = float(np.sum(seen**2)) - gain
    if best is None or hopeless(best[0], 2, len(places) * len(grid)):
        return None
    _, place, time = best
    bounds = (parameter.lower, longest)
    shape = refined_shape(contrasts, effect, place, {parameter.name: time}, parameter.name, bounds, 9)
    fit = fit_of(contrasts, effect, place, shape)
    dispersion = dispersion_of(rests[place], 2 * (contrasts.periods - 2))
    tests = float(len(places) * len(grid))
    chance = fit.log10_chance(tests, 1, dispersion)
    std = spread_of(contrasts, effect, place, shape, parameter.name, fit.gain)
    return Candidate(effect, place, shape, inflated(fit, dispersion), chance, tests, std, dispersion)


def find_payload(contrasts: Contrasts, effect: PayloadChange) -> Candidate | None:
    """The moment at which the last link's parameters change, to a sample."""
    motion, starts = contrasts.motion, contrasts.motion.start_s
    place = effect.places(motion)[0]
    found = contrasts.repeated(effect, place, {})
    assert found is not None
    joints, values, constant = found
    white = contrasts.whiten_repeated(constant, joints).transpose(1, 0, 2).reshape(-1, constant.shape[-1])
    target = contrasts.z[:, :, list(joints)].transpose(0, 2, 1).reshape(contrasts.periods, -1)
    gram, seen = (white.T @ white)[PAYLOAD_SCAN, PAYLOAD_SCAN], target @ white[:, PAYLOAD_SCAN]
    best_gain, best_step = -np.inf, 1
    for step in range(1, contrasts.periods):
        weight = (np.arange(contrasts.periods) >= step).astype(float)
        weight = (weight - weight.mean()) / np.linalg.norm(weight - weight.mean())
        right = weight @ seen
        gain = float(right @ solve(gram, right)[0])
        if gain > best_gain:
            best_gain, best_step = gain, step
    dispersion = _dispersion_beside_step(target @ np.linalg.qr(white)[0], best_step)
    tests = MOMENTS_PER_PERIOD * contrasts.periods
    if hopeless(best_gain / dispersion, 4, tests):
        return None
    shape = {"time_s": float(starts[best_step])}
    period = float(starts[1] - starts[0])
    last = float(starts[-1] + motion.time[-1])
    for width in (period, 0.1 * period, 0.02 * period):
        # With the change's own torque known, each moment costs one projection.
        coefficients = fit_of(contrasts, effect, place, shape, PAYLOAD_SCAN).coefficients
        torque = (values[..., PAYLOAD_SCAN] @ coefficients)[..., None]
        rows = (constant[..., PAYLOAD_SCAN] @ coefficients)[..., None]

        def gain_at(time: float, torque: FloatArray = torque, rows: FloatArray = rows) -> float:
            factors = effect.envelope(motion, {"time_s": time})
            return contrasts.fit_pieces(joints, *contrasts.patterns(factors, joints, torque, rows)).gain

        shape = {"time_s": best_moment(gain_at, shape["time_s"], width, last)}
    columns = slice(None)
    fit = fit_of(contrasts, effect, place, shape)
    if fit.log10_chance(tests, 1, dispersion) > PAYLOAD_PROVEN:
        columns, fit = PAYLOAD_SCAN, fit_of(contrasts, effect, place, shape, PAYLOAD_SCAN)
    chance = fit.log10_chance(tests, 1, dispersion)
    std = spread_of(contrasts, effect, place, shape, "time_s", fit.gain, motion.sampling_period_s, columns)
    fit = inflated(fit, dispersion)
    return Candidate(effect, place, shape, fit, chance, tests, std, dispersion, columns=columns)


def _dispersion_beside_step(seen: FloatArray, step: int) -> float:
    """How noisy the periods are beside a step, each stretch about its own mean; one further step is allowed for.

    seen: (K, m) components of each period along orthonormal directions. step: first period after the change; it and
    the one before may hold the change itself and do not count. The larger of the mean over all directions and of the
    direction of the change.
    """
    along = seen[step:].mean(axis=0) - seen[:step].mean(axis=0)
    along /= max(float(np.linalg.norm(along)), 1e-300)
    found = []
    for other in range(1, len(seen)):
        ends = [-1, *sorted({step, other}), len(seen) + 1]
        stretches = [seen[first + 1 : last - 1] for first, last in pairwise(ends) if last - first > 3]
        freedom = sum(len(stretch) - 1 for stretch in stretches)
        if freedom > 0:
            rest = np.concatenate([stretch - stretch.mean(axis=0) for stretch in stretches])
            everywhere = dispersion_of(float((rest**2).sum()), freedom * seen.shape[1])
            found.append(max(everywhere, dispersion_of(float(((rest @ along) ** 2).sum()), freedom)))
    return min(found, default=1.0)
