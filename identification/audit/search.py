"""The fewest things that are different: greedy over hypotheses by evidence, each accepted on rows that were not fitted.

Pure. Called by the audit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from identification.audit.basis import Basis, basis_of, fitted_on, left_on, root_of
from identification.audit.columns import PARAMETERS, Geometry, SetUp
from identification.audit.comparison import (
    ACCEPT,
    ALL,
    FIT,
    REPORT,
    Comparison,
    Noise,
    compare,
    noise_of,
    torque_as_read,
    turned,
)
from identification.audit.directions import Directions
from identification.audit.evidence import gain, marginal
from identification.audit.given import GivenModel, Sizes
from identification.audit.hypotheses import Hypothesis, Layout, hypotheses

__all__ = ["USED", "Audited", "Step", "search"]

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

USED = (*FIT, *ACCEPT)
LEAST_GAIN = 6.0
"""Nats, odds of 400 : 1 in rows that count."""
FIRST_SHARE, LATER_SHARE = 0.15, 0.04
LEAST_SIGMAS = 5.0
REPORTED = 0.5
"""Of the least share: what is named has to explain something on rows that neither fitted nor accepted it."""
MOST_STEPS = 5
ALIKE = 0.03
AS_LIKELY = 3.0
"""Nats within which two hypotheses cannot be told apart."""
TURNS = 4
TRIED = 4
WEIGHS = 3.0
"""σ that a load's mass must be from zero: a first moment alone is no load."""
FARTHEST = 3.0
"""Of the longest link's radius of inertia: a load's centre is no farther from its link's frame."""
SLOWEST = 0.3
"""Ratio of clocks: slower, friction and gravity alone stay, which any weak model fits."""
SIGN_BELOW = -0.3
"""A scale below this is a sensor read with the wrong sign, not a weak one."""


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """One difference. gain: nats. share, explained: of the difference of torque that it takes away on the rows that
    accept it, and on those that were not used for that either. alternatives: what is as likely on these rows.
    """

    hypothesis: Hypothesis
    gain: float
    share: float
    explained: float
    alternatives: tuple[Hypothesis, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Audited:
    """What was found. comparison: at the last set-up; noise: there."""

    steps: tuple[Step, ...]
    signs: FloatArray
    comparison: Comparison
    noise: Noise
    first: Comparison
    first_noise: Noise


def search(geometry: Geometry, robot_set_up: SetUp, model: GivenModel, sizes: Sizes) -> Audited:
    """The differences between a model and the rows of a recording, the largest evidence first."""
    layout = Layout(geometry.robot.n)
    noise = noise_of(geometry, robot_set_up, sizes, model)
    if _all_turned(geometry, robot_set_up, noise, model, sizes):
        turned_round = replace(robot_set_up, signs=-robot_set_up.signs)
        again = search(geometry, turned_round, model, sizes)
        return replace(again, signs=-again.signs, first=compare(geometry, robot_set_up, model), first_noise=noise)
    now = compare(geometry, robot_set_up, model)
    first, first_noise = now, noise
    rms = np.sqrt(np.einsum("pjaa->a", now.products.gram) / max(1.0, float(now.products.count.sum() / layout.n)))
    candidates = hypotheses(layout, sizes, rms, model.own, geometry.robot.kinematics.revolute)
    steps: list[Step] = []
    while len(steps) < MOST_STEPS:
        taken = _next(now, noise, model, sizes, candidates, steps, first)
        if taken is None:
            break
        step, after = taken
        if step.hypothesis.effect == "torque_sensor_gain":
            signs = _signs(after, step, layout, noise, model, sizes, [item.hypothesis for item in steps])
            if signs is not None:
                again = search(geometry, replace(robot_set_up, signs=robot_set_up.signs * signs), model, sizes)
                return replace(again, signs=again.signs * signs, first=first, first_noise=first_noise)
        steps = [*_still_needed(after, [*steps, step], noise, model, sizes)]
        now = after
        if step.hypothesis.bends:
            noise = noise_of(now.geometry, now.set_up, sizes, model)
    return Audited(tuple(steps), np.ones(layout.n), now, noise, first, first_noise)


def _still_needed(now: Comparison, steps: list[Step], noise: Noise, model: GivenModel, sizes: Sizes) -> list[Step]:
    """The steps without those that the last one makes needless: its evidence beside all others is gone."""
    layout = Layout(now.geometry.robot.n)
    kept = list(steps)
    for step in steps[:-1]:
        if step.hypothesis.bends:
            continue
        others = [item.hypothesis for item in kept if item is not step]
        basis = basis_of(layout, model, sizes, others)
        gram, right = marginal(*now.products.summed(FIT, noise.weight), basis.columns, basis.factor)
        own = step.hypothesis
        if gain(gram, right, own.columns, own.width) + own.log_odds < LEAST_GAIN:
            kept = [item for item in kept if item is not step]
    return kept


def _signs(after: Comparison, step: Step, layout: Layout, noise: Noise, model: GivenModel, sizes: Sizes,
           before: list[Hypothesis]) -> FloatArray | None:  # fmt: skip
    """(n,) −1 where a scale says that the sensor is read with the wrong sign; None where it is a mere scale."""
    basis = basis_of(layout, model, sizes, [*before, step.hypothesis])
    scale = 1.0 + float(fitted_on(after, basis, noise.weight, ALL).values[-1])
    if scale > SIGN_BELOW:
        return None
    joint = step.hypothesis.joint
    return np.where(np.arange(layout.n) == joint, -1.0, 1.0) if joint is not None else -np.ones(layout.n)


def _next(now: Comparison, noise: Noise, model: GivenModel, sizes: Sizes, candidates: list[Hypothesis],
          steps: list[Step], first: Comparison) -> tuple[Step, Comparison] | None:  # fmt: skip
    layout = Layout(now.geometry.robot.n)
    before = [step.hypothesis for step in steps]
    basis = basis_of(layout, model, sizes, before)
    gram, right = now.products.summed(FIT, noise.weight)
    gram, right = marginal(gram, right, basis.columns, basis.factor)
    known = {item.place for item in before}
    scored = [
        (gain(gram, right, item.columns, item.width) + item.log_odds, item)
        for item in candidates
        if item.place not in known
    ]
    if not scored:
        return None
    scored.sort(key=lambda pair: -pair[0])
    weight = 1.0 / noise.std**2
    pinned = basis_of(layout, model, sizes, before)
    whole = float(weight @ left_on(first, basis_of(layout, model, sizes, []), noise.weight, FIT, ACCEPT, model))
    left = float(weight @ left_on(now, pinned, noise.weight, FIT, ACCEPT, model))
    turn = _turned_base(now, noise, model, sizes) if "base_tilt" not in {p[0] for p in known} else None
    if turn is not None:
        tilt = next(item for item in candidates if item.effect == "base_tilt")
        if turn[1] + tilt.log_odds > scored[0][0]:
            scored = [(turn[1] + tilt.log_odds, tilt), *[pair for pair in scored if pair[1] is not tilt]]
    for score, item in _fewest_columns_first(scored, model.own)[:TRIED]:
        if score < LEAST_GAIN:
            return None
        after = now
        if item.bends:
            start = now
            if item.effect == "base_tilt" and turn is not None and turn[1] + item.log_odds >= score:
                start = compare(now.geometry, replace(now.set_up, gravity=turn[0]), model)
            after = _bent(start, item, noise, model, sizes, before)
        trial = basis_of(layout, model, sizes, [*before, item])
        share = (left - float(weight @ left_on(after, trial, noise.weight, FIT, ACCEPT, model))) / whole
        sigmas = _sigmas(after, basis.plus(item), noise, item, now)
        least = LATER_SHARE if steps else FIRST_SHARE
        if share < least or sigmas < LEAST_SIGMAS:
            continue
        explained = _share(now, after, before, item, first, noise, model, sizes)
        if explained >= REPORTED * least and _plausible(after, basis.plus(item), noise, item, sizes):
            return Step(item, score, share, explained, _alike(item, score, scored)), after
    return None


def _share(now: Comparison, after: Comparison, before: list[Hypothesis], item: Hypothesis, first: Comparison,
           noise: Noise, model: GivenModel, sizes: Sizes) -> float:  # fmt: skip
    """Of the first difference, what a step takes away on the rows that report."""
    layout = Layout(now.geometry.robot.n)
    weight = 1.0 / noise.std**2
    whole, left, stays = (
        float(weight @ left_on(each, basis_of(layout, model, sizes, steps), noise.weight, USED, REPORT, model))
        for each, steps in ((first, []), (now, before), (after, [*before, item]))
    )
    return (left - stays) / whole if whole > 0.0 else 0.0


def _plausible(after: Comparison, basis: Basis, noise: Noise, item: Hypothesis, sizes: Sizes) -> bool:
    """Whether the numbers can be those of the thing: a load weighs and is in reach, a clock no tenth of another."""
    found = fitted_on(after, basis, noise.weight, ALL)
    own = slice(len(basis.columns) - len(item.columns), None)
    values, std = found.values[own], np.sqrt(np.diag(found.covariance)[own])
    if item.effect == "payload":
        if int(item.columns[0]) % PARAMETERS != 0 or abs(values[0]) < WEIGHS * std[0]:
            return False
        moments = [k for k, column in enumerate(item.columns) if 1 <= int(column) % PARAMETERS <= 3]
        return float(np.linalg.norm(values[moments])) < FARTHEST * float(sizes.length.max()) * abs(float(values[0]))
    if item.effect == "wrong_time_base":
        return SLOWEST < after.set_up.ratio * float(np.exp(values[0])) < 1.0 / SLOWEST
    return True


def _sigmas(after: Comparison, basis: Basis, noise: Noise, item: Hypothesis, now: Comparison) -> float:
    """How many standard deviations a difference is from none."""
    found = fitted_on(after, basis, noise.weight, ALL)
    own = slice(len(basis.columns) - len(item.columns), None)
    values = found.values[own] + _already(now.set_up, after.set_up, item, Layout(now.geometry.robot.n))
    spread = found.covariance[own, own]
    square = float(values @ np.linalg.pinv(spread, rcond=1e-12, hermitian=True) @ values)
    return float(np.sqrt(max(0.0, square)))


def _already(old: SetUp, new: SetUp, item: Hypothesis, layout: Layout) -> FloatArray:
    """What of a difference stands in the set-up already, in units of its columns (a rough size for the tilt)."""
    match item.effect:
        case "base_tilt":
            angle = np.arccos(np.clip(old.gravity @ new.gravity / (old.gravity @ old.gravity), -1.0, 1.0))
            return np.full(len(item.columns), angle / np.sqrt(len(item.columns)))
        case "torque_delay":
            return np.array([new.delay_s - old.delay_s])
        case "wrong_time_base":
            return np.array([np.log(new.ratio / old.ratio)])
        case "joint_zero_offset":
            place = int(item.columns[0]) - layout.zero
            return np.array([new.zeros[place] - old.zeros[place]])
    return np.zeros(len(item.columns))


def _bent(now: Comparison, item: Hypothesis, noise: Noise, model: GivenModel, sizes: Sizes,
          before: list[Hypothesis]) -> Comparison:  # fmt: skip
    """The comparison with a difference turned into the data, linearised again until it does not move."""
    layout = Layout(now.geometry.robot.n)
    basis = basis_of(layout, model, sizes, [*before, item])
    for _ in range(TURNS):
        found = fitted_on(now, basis, noise.weight, FIT).values[-len(item.columns) :]
        step = np.clip(found, -2.0 * item.width, 2.0 * item.width)
        set_up = turned(now.set_up, layout, int(item.columns[0]), step)
        now = compare(now.geometry, set_up, model)
        if np.all(np.abs(step) < 1e-3 * item.width):
            break
    return now


def _all_turned(geometry: Geometry, set_up: SetUp, noise: Noise, model: GivenModel, sizes: Sizes) -> bool:
    """Whether every torque has the wrong sign: better so than as it is, and than with gravity from anywhere else."""
    torque = torque_as_read(geometry, set_up)
    factor = root_of(model.covariance, sizes.each)
    there, turned_round = (Directions.of(geometry, sign * torque) for sign in (1.0, -1.0))
    weight = noise.weight
    best = turned_round.evidence(set_up.gravity, weight, model.values, factor)
    if best < there.evidence(set_up.gravity, weight, model.values, factor) + LEAST_GAIN:
        return False
    size = float(np.linalg.norm(set_up.gravity))
    return size == 0.0 or best > there.best(weight, model.values, factor, size)[1] + LEAST_GAIN


def _turned_base(now: Comparison, noise: Noise, model: GivenModel, sizes: Sizes) -> tuple[
    FloatArray, float
] | None:  # fmt: skip
    """Gravity of the best direction on the whole sphere, and its log odds against the present one."""
    size = float(np.linalg.norm(now.set_up.gravity))
    if size == 0.0:
        return None
    everything = Directions.of(now.geometry, torque_as_read(now.geometry, now.set_up))
    weight = noise.weight * now.products.counts(FIT) / np.maximum(now.products.counts(ALL), 1.0)
    factor = root_of(model.covariance, sizes.each)
    present = everything.evidence(now.set_up.gravity, weight, model.values, factor, now.set_up.ratio)
    gravity, best = everything.best(weight, model.values, factor, size)
    return gravity, best - present


def _alike(item: Hypothesis, score: float, scored: list[tuple[float, Hypothesis]]) -> tuple[Hypothesis, ...]:
    """Other places or things with the same evidence, one of each; none for what was turned into the data."""
    if item.bends:
        return ()
    found: dict[tuple[str, int | None, int | None], Hypothesis] = {}
    for other_score, other in scored:
        if other.place != item.place and abs(other_score - score) < AS_LIKELY:
            found.setdefault(other.place, other)
    return tuple(found.values())


def _fewest_columns_first(scored: list[tuple[float, Hypothesis]], own: bool) -> list[tuple[float, Hypothesis]]:
    """Bodies that explain the same within a few per cent: that with the fewest numbers is tried first.

    own: of a fit of this arm, where a link does not change but what hangs on it does.
    """
    best = scored[0][0]
    alike = [pair for pair in scored if pair[1].is_body and pair[0] > best - ALIKE * abs(best)]
    if not scored[0][1].is_body or len(alike) < 2:
        return scored
    alike.sort(key=lambda pair: (own and pair[1].effect == "link_parameters", len(pair[1].columns), -pair[0]))
    chosen = {id(pair[1]) for pair in alike}
    return [*alike, *[pair for pair in scored if id(pair[1]) not in chosen]]
