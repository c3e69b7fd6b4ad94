"""The fewest things that are different: greedy over hypotheses by evidence, each accepted on rows that were not fitted.

Pure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from identification.arrays import FloatArray
from identification.audit.basis import Explanation, root_of
from identification.audit.columns import Geometry, SetUp
from identification.audit.comparison import ALL, USED, Comparison, torque_as_read, turned
from identification.audit.directions import Directions
from identification.audit.given import GivenModel, Sizes
from identification.audit.hypotheses import Hypothesis, hypotheses
from identification.audit.shown import LEAST_GAIN, MOST_STEPS, Step, several_at_once, share_shown
from identification.mismatch.settings import ALTERNATIVE

ALIKE = 0.03
READINGS = 3
"""How many other readings of the data are asked what noise they leave."""
TURNS = 4
TRIED = 8
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
class Audited:
    """What was found. signs: (n,) by which the torque was turned. now, first: with all differences, and with none.
    whole: as now, with the inertia that every load has and that needs more numbers than tell a load.
    """

    steps: tuple[Step, ...]
    signs: FloatArray
    now: Explanation
    first: Explanation
    whole: Explanation

    def without(self, gone: Sequence[Hypothesis]) -> Audited:
        """With these differences out."""
        places = [item.place for item in gone]
        kept = tuple(step for step in self.steps if step.hypothesis.place not in places)
        now, whole = (
            each.without([item for item in each.steps if item.place in places]) for each in (self.now, self.whole)
        )
        return replace(self, steps=kept, now=now, whole=whole)


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
            together, now = several_at_once(now, likely, first, MOST_STEPS - len(steps))
            steps = (*steps, *together)
            if together:
                continue
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
        explained = share_shown(now, after, first)
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
        return any(abs(other.nats - nats) < max(ALTERNATIVE, share * nats) for nats in rivals)

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
