"""The fewest things that are different: greedy over hypotheses by evidence, each accepted on rows that were not fitted.

Pure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from identification.arrays import FloatArray
from identification.audit.basis import DAYS, Explanation, root_of
from identification.audit.columns import PARAMETERS, Geometry, SetUp
from identification.audit.comparison import ALL, LEAST_SIGMAS, USED, Comparison, torque_as_read, turned
from identification.audit.directions import Directions
from identification.audit.given import WEIGHS, GivenModel, Sizes
from identification.audit.hypotheses import Hypothesis, Layout, hypotheses

LEAST_GAIN = 6.0
"""Nats, odds of 400 : 1 in rows that count."""
FIRST_SHARE, LATER_SHARE = 0.1, 0.04
"""Of what neither the model's own uncertainty nor noise accounts for, on rows that were not fitted."""
EXPLAINS, LEAST_EXPLAINED = 1.0, 0.005
"""Deviations by which what a difference takes away is above nothing, and the least share: less is printed as 0 %."""
LEAST_TORQUE = 0.5
"""Of what the best model leaves of a joint: where a difference makes less it does not act."""
MOST_STEPS = 5
ALIKE = 0.03
AS_LIKELY = 3.0
"""Nats within which two hypotheses cannot be told apart."""
READINGS = 3
"""How many other readings of the data are asked what noise they leave."""
TURNS = 4
TRIED = 8
FARTHEST = 3.0
"""Of the longest link's radius of inertia: a load's centre is no farther from its link's frame."""
SLOWEST = 0.3
"""Ratio of clocks: slower, friction and gravity alone stay, which any weak model fits."""
SIGN_BELOW = -0.3
"""A scale below this is a sensor read with the wrong sign, not a weak one."""

Place = tuple[str, int | None, int | None]


class Scored(NamedTuple):
    """What a difference gains, on the likeliest day, and the reading of the data from where it gains it."""

    nats: float
    day: float
    item: Hypothesis
    start: Explanation


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """One difference. gain: nats. explained: of the difference of torque, what it takes away on rows that its numbers
    are not from.
    alternatives: what is as likely on these rows.
    """

    hypothesis: Hypothesis
    gain: float
    explained: float
    alternatives: tuple[Hypothesis, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Audited:
    """What was found. signs: (n,) by which the torque was turned. now, first: with all differences, and with none.
    whole: as now, with the inertia that every load has and that needs more numbers than tell a load.
    """

    steps: tuple[Step, ...]
    signs: FloatArray
    now: Explanation
    first: Explanation
    whole: Explanation


def search(geometry: Geometry, set_up: SetUp, model: GivenModel, sizes: Sizes) -> Audited:
    """The differences between a model and the rows of a recording, the largest evidence first."""
    return _search(geometry, set_up, model, sizes, ())


def search_turned(geometry: Geometry, set_up: SetUp, model: GivenModel, sizes: Sizes, signs: FloatArray) -> Audited:
    """As `search`, with torques turned (n,) before anything else is asked, as the recording by itself shows them."""
    found = _search(geometry, replace(set_up, signs=set_up.signs * signs), model, sizes, (set_up.signs,))
    first = Explanation.of(geometry, set_up, model, sizes)
    return replace(found, signs=found.signs * signs, first=first)


def _search(
    geometry: Geometry, set_up: SetUp, model: GivenModel, sizes: Sizes, seen: tuple[FloatArray, ...]
) -> Audited:
    """seen: the signs that were asked about already. None is asked about again, so that the search ends."""
    first = Explanation.of(geometry, set_up, model, sizes)
    n, seen = first.layout.n, (*seen, set_up.signs)

    def new(signs: FloatArray) -> bool:
        return not any(np.array_equal(set_up.signs * signs, each) for each in seen)

    def again(signs: FloatArray) -> Audited:
        found = _search(geometry, replace(set_up, signs=set_up.signs * signs), model, sizes, seen)
        return replace(found, signs=found.signs * signs, first=first)

    if new(-np.ones(n)) and _all_turned(first):
        return again(-np.ones(n))
    candidates = possible(first)
    now, steps, likely = first, tuple[Step, ...](), candidates
    while len(steps) < MOST_STEPS:
        taken = _next(now, likely, first)
        if taken is None:
            break
        step, after = taken
        signs = _signs(after, step.hypothesis)
        if signs is not None and new(signs):
            return again(signs)
        needless = _needless(after)
        # The noise differs with the steps: two that make each other needless would take turns for ever.
        likely = [each for each in likely if each not in needless]
        steps = tuple(each for each in (*steps, step) if each.hypothesis not in needless)
        now = after.without(needless)
        if step.hypothesis.bends:
            now = replace(now, noise=now.noise_with())
    return Audited(steps, np.ones(n), now, first, _with_inertia(now, candidates))


def possible(first: Explanation) -> list[Hypothesis]:
    """Every difference that these rows can show."""
    products, n = first.comparison.products, first.layout.n
    rms = np.sqrt(np.einsum("pjaa->a", products.gram) / max(1.0, float(products.count.sum() / n)))
    geometry = first.comparison.geometry
    revolute, clock_known = geometry.robot.kinematics.revolute, geometry.rows.clock_known
    return hypotheses(first.layout, first.sizes, rms, first.model, revolute, clock_known=clock_known)


def gain_of(now: Explanation, item: Hypothesis) -> float:
    """Log odds of one difference against none, read from wherever it is likeliest."""
    score, day, _ = now.gains([item])[0]
    starts = [_bent(now.plus(item, day)).without([item])] if item.bends else []
    return _likeliest(Scored(score, day, item, now), [*starts, *_anywhere(now, item)]).nats


def _with_inertia(now: Explanation, candidates: list[Hypothesis]) -> Explanation:
    """With all numbers of each body that was told by its mass and centre."""
    for step in now.steps:
        for larger in candidates:
            if step.is_body and larger.place == step.place and len(larger.columns) > len(step.columns):
                now = now.without([step]).plus(larger, now.day)
    return now


def _needless(now: Explanation) -> list[Hypothesis]:
    """The steps that the last one makes needless: their evidence beside all others is gone."""
    gone: list[Hypothesis] = []
    for step in now.steps[:-1]:
        if not step.bends and now.without([*gone, step]).gains([step])[0][0] < LEAST_GAIN:
            gone.append(step)
    return gone


def _signs(after: Explanation, step: Hypothesis) -> FloatArray | None:
    """(n,) −1 where a scale says that the sensor is read with the wrong sign; None where it is a mere scale."""
    if step.effect != "torque_sensor_gain" or 1.0 + float(after.fitted(ALL).values[-1]) > SIGN_BELOW:
        return None
    n = after.layout.n
    return -np.ones(n) if step.joint is None else np.where(np.arange(n) == step.joint, -1.0, 1.0)


def _next(now: Explanation, candidates: list[Hypothesis], first: Explanation) -> tuple[Step, Explanation] | None:
    """The next difference and all with it; None where none is likely and seen on rows that were not fitted."""
    known = {item.place for item in now.steps}
    candidates = [item for item in candidates if item.place not in known]
    now, starts = _read_otherwise(now, candidates)
    here = (Scored(*gained, now) for gained in now.gains(candidates))
    scored = sorted((_likeliest(one, starts[one.item.place]) for one in here), key=lambda one: -one.nats)
    for one in _fewest_columns_first(scored, now.model.own)[:TRIED]:
        if one.nats < LEAST_GAIN:
            return None
        after = one.start.plus(one.item, one.day)
        after = _bent(after) if one.item.bends else after
        least = LATER_SHARE if now.steps else FIRST_SHARE
        if _share(now, after, first) < least or _sigmas(now, after) < LEAST_SIGMAS or not _plausible(after):
            continue
        explained = _explained(now, after, first)
        if explained > 0.0:
            return Step(one.item, one.nats, explained, _alike(one, scored)), after
    return None


def _read_otherwise(
    now: Explanation, candidates: list[Hypothesis]
) -> tuple[Explanation, dict[Place, list[Explanation]]]:
    """With the noise of that reading of the data, among the likeliest, which leaves least; and those readings.

    A fault that parameters cannot take looks like noise in the torque as it is read, and would hide itself. One that
    bends is seen where the data are read as it says: from afar its torque is not linear in its numbers.
    """
    noises, starts = [now.noise], dict[Place, Explanation]()
    readings = [one for one in now.gains(candidates) if one[2].bends or one[2].effect == "torque_sensor_gain"]
    for _, day, item in readings[:READINGS]:
        if item.bends:
            starts[item.place] = _bent(now.plus(item, day)).without([item])
            noises.append(starts[item.place].noise_with())
        else:
            noises.append(now.noise_with(item))
    now = replace(now, noise=min(noises, key=lambda noise: noise.loudness))
    near = {place: [replace(start, noise=now.noise)] for place, start in starts.items()}
    return now, {item.place: [*near.get(item.place, []), *_anywhere(now, item)] for item in candidates}


def _likeliest(here: Scored, starts: Sequence[Explanation]) -> Scored:
    """What a difference gains where it gains most: here, or where the data are read otherwise from the start."""
    found = here
    for start in starts:
        score, day, item = start.gains([here.item])[0]
        there = Scored(score + start.evidence() - here.start.evidence(), day, item, start)
        found = max(found, there, key=lambda one: one.nats)
    return found


def _share(now: Explanation, after: Explanation, first: Explanation) -> float:
    """Of the first difference beyond noise, what the last step takes away on rows that were not fitted, where it acts.

    Beside the parameters, which are free in all, on the quietest day: which day it is was weighed by the evidence.
    """
    noise, counts = now.noise, first.comparison.products.counts(USED)
    whole, before, left = (
        replace(each, day=DAYS[0], noise=noise).holding(after.steps[-1:]).foretold().sum(axis=0)
        for each in (first, now, after)
    )
    heard = _heard(now, after) >= LEAST_TORQUE
    if not heard.any():
        return 0.0
    # One that comes besides has to matter to the whole; else the misfit of the first one's model gets a name.
    acts = heard | bool(now.steps)
    taken = (noise.weight * (before - left))[acts].sum()
    beyond = (noise.weight * np.maximum(whole - counts * noise.std**2, 0.0))[acts].sum()
    return float(taken / max(beyond, 1e-300))


def _explained(now: Explanation, after: Explanation, first: Explanation) -> float:
    """Of the first difference, what a step takes away on each part of the recording by what the other parts say of it.

    The step by itself, with the parameters at the model's values; of what there was before it where that is more, as
    one cause may have hidden the other. Zero where that is not beyond its own uncertainty, the scatter of the parts,
    where it would be printed as 0 %, or where the step takes nothing away beside parameters that are free: then it is
    not seen.
    """
    weight = 1.0 / now.noise.std**2
    same_day, after, first = (each.holding(after.steps[-1:]) for each in (replace(now, day=after.day), after, first))
    alone, beside = (
        (same_day.foretold(ALL, by_itself) - after.foretold(ALL, by_itself)) @ weight for by_itself in (True, False)
    )
    whole = max(float(each.foretold(ALL, True).sum(axis=0) @ weight) for each in (first, same_day))
    if min(alone.sum(), beside.sum()) <= 0.0 or max(_deviations(alone), _deviations(beside)) < EXPLAINS or whole <= 0.0:
        return 0.0
    share = float(alone.sum()) / whole
    return share if share >= LEAST_EXPLAINED else 0.0


def _deviations(values: FloatArray) -> float:
    """By how many of its standard deviations a sum over parts is above zero."""
    return float(values.sum()) / max(float(values.std(ddof=1) * np.sqrt(len(values))), 1e-300)


def _heard(now: Explanation, after: Explanation) -> FloatArray:
    """(n,) RMS of the last difference's torque over what the best model leaves of each joint."""
    values, _ = after.deviation_of_last()
    columns = after.steps[-1].columns
    old, new = now.comparison, after.comparison
    rows = new.geometry.rows.used
    gram = new.products.gram.sum(axis=0)[:, columns][..., columns]
    counts = np.maximum(new.products.counts(ALL), 1.0)
    moved = (np.where(rows, old.target - new.target, 0.0) ** 2).sum(axis=0)
    power = (np.einsum("jab,a,b->j", gram, values, values) + moved) / counts
    return np.asarray(np.sqrt(power) / now.noise.std)


def _plausible(after: Explanation) -> bool:
    """Whether the numbers can be those of the thing: a load weighs and is in reach, a clock is no tenth of another, and
    rotors that a file lacks have no inertia below zero.
    """
    item = after.steps[-1]
    values, covariance = after.deviation_of_last()
    if item.effect == "payload":
        if int(item.columns[0]) % PARAMETERS != 0 or abs(values[0]) < WEIGHS * np.sqrt(covariance[0, 0]):
            return False
        moments = [k for k, column in enumerate(item.columns) if 1 <= int(column) % PARAMETERS <= 3]
        reach = FARTHEST * float(after.sizes.length.max())
        return float(np.linalg.norm(values[moments])) < reach * abs(float(values[0]))
    if item.effect == "rotor_inertia" and item.joint is None:
        return bool(np.all(values > -WEIGHS * np.sqrt(np.diag(covariance))))
    if item.effect == "wrong_time_base":
        return SLOWEST < after.comparison.set_up.ratio * float(np.exp(values[0])) < 1.0 / SLOWEST
    return True


def _sigmas(now: Explanation, after: Explanation) -> float:
    """How many standard deviations a difference is from none."""
    item = after.steps[-1]
    values, covariance = after.deviation_of_last()
    values = values + _already(now.comparison.set_up, after.comparison.set_up, item, now.layout)
    square = float(values @ np.linalg.pinv(covariance, rcond=1e-12, hermitian=True) @ values)
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


def _bent(after: Explanation) -> Explanation:
    """With the last difference turned into the data, linearised again until it does not move."""
    item = after.steps[-1]
    for _ in range(TURNS):
        found = after.fitted(USED).values[-len(item.columns) :]
        step = np.clip(found, -2.0 * item.width, 2.0 * item.width)
        after = after.read(turned(after.comparison.set_up, after.layout, int(item.columns[0]), step))
        if np.all(np.abs(step) < 1e-3 * item.width):
            break
    return after


def _all_turned(first: Explanation) -> bool:
    """Whether every torque has the wrong sign: better so than as it is, and than with gravity from anywhere else."""
    now, weight = first.comparison, first.noise.weight
    torque = torque_as_read(now.geometry, now.set_up)
    prior = first.model.values, root_of(first.model.covariance_on(1.0), first.sizes.each)
    there, turned_round = (Directions.of(now.geometry, sign * torque) for sign in (1.0, -1.0))
    best = turned_round.evidence(now.set_up.gravity, weight, *prior)
    if best < there.evidence(now.set_up.gravity, weight, *prior) + LEAST_GAIN:
        return False
    size = float(np.linalg.norm(now.set_up.gravity))
    return size == 0.0 or best > there.best(weight, *prior, size)[1] + LEAST_GAIN


def _anywhere(now: Explanation, item: Hypothesis) -> list[Explanation]:
    """For a base that is turned: to where gravity is likeliest on the whole sphere, which no tangent reaches."""
    read: Comparison = now.comparison
    size = float(np.linalg.norm(read.set_up.gravity))
    if item.effect != "base_tilt" or size == 0.0:
        return []
    everything = Directions.of(read.geometry, torque_as_read(read.geometry, read.set_up))
    weight = now.noise.weight * read.products.counts(USED) / np.maximum(read.products.counts(ALL), 1.0)
    prior = now.model.values, root_of(now.model.covariance_on(now.day), now.sizes.each)
    gravity, _ = everything.best(weight, *prior, size)
    return [now.read(replace(read.set_up, gravity=gravity))]


def _alike(one: Scored, scored: list[Scored]) -> tuple[Hypothesis, ...]:
    """Other places or things with the same evidence, one of each; none for what was turned into the data."""
    item = one.item
    if item.bends:
        return ()
    # A link that is another and a load on it are one body to the torque: each is held against its like on that link.
    like = {each.item.effect: each.nats for each in reversed(scored) if item.is_body and each.item.link == item.link}

    def near(other: Scored) -> bool:
        share = ALIKE if item.is_body and other.item.is_body else 0.0
        rivals = one.nats, like.get(other.item.effect, one.nats)
        return any(abs(other.nats - nats) < max(AS_LIKELY, share * nats) for nats in rivals)

    links = {each.item.link for each in (one, *filter(near, scored)) if each.item.is_body}
    others = {each.item.place: each.item for each in scored if near(each) or each.item.link in links}
    return tuple(other for place, other in others.items() if place != item.place)


def _fewest_columns_first(scored: list[Scored], own: bool) -> list[Scored]:
    """Bodies that explain the same within a few per cent: the fewest numbers are tried first, then the commonest thing.

    On the last joint's axis a load does to the torque what it does on the link before: most loads hang at the flange.
    own: of a fit of this arm, where a link does not change but what hangs on it does.
    """
    if not scored or not scored[0].item.is_body:
        return scored
    best = scored[0].nats

    def alike(one: Scored) -> bool:
        return one.item.is_body and one.nats > best - ALIKE * abs(best)

    def order(one: Scored) -> tuple[bool, int, float, float]:
        item = one.item
        return own and item.effect == "link_parameters", len(item.columns), -item.log_odds, -one.nats

    return [*sorted(filter(alike, scored), key=order), *(one for one in scored if not alike(one))]
