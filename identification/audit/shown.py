"""Whether a difference that is likely is also shown: what it takes away on rows that were not fitted; and differences
that show only together. Pure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.arrays import FloatArray
from identification.audit.basis import DAYS, Explanation
from identification.audit.columns import PARAMETERS, SetUp
from identification.audit.comparison import ALL, LEAST_SIGMAS, USED
from identification.audit.hypotheses import Hypothesis, Layout
from identification.fitting.drives import CLEAR
from identification.mismatch.settings import MOST

LEAST_GAIN = 6.0
"""Nats, odds of 400 : 1 in rows that count."""
MOST_STEPS = 5
FIRST_SHARE, LATER_SHARE = 0.1, 0.04
"""Of what neither the model's own uncertainty nor noise accounts for, on rows that were not fitted."""
EXPLAINS, LEAST_EXPLAINED = 1.0, 0.005
"""Deviations by which what a difference takes away is above nothing, and the least share: less is printed as 0 %."""
FARTHEST = 3.0
"""Of the longest link's radius of inertia: a load's centre is no farther from its link's frame."""
SLOWEST = 0.3
"""Ratio of clocks: slower, friction and gravity alone stay, which any weak model fits."""


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


def several_at_once(
    now: Explanation, candidates: Sequence[Hypothesis], first: Explanation, most: int
) -> tuple[tuple[Step, ...], Explanation]:
    """Friction that changed on several joints (most: how many at most), and all with it; nothing where one day on which
    all friction differs is as likely, or one of them is not shown beside the others.

    One by one none is seen: beside what the others changed by, it is as likely such a day.
    """
    known, quiet = {item.place for item in now.steps}, DAYS[0]
    friction = [item for item in candidates if item.effect == "friction_change" and item.place not in known]
    likely: dict[int | None, Hypothesis] = {}
    for nats, _, item in now.gains(friction, (quiet,)):
        if nats >= LEAST_GAIN:
            likely.setdefault(item.joint, item)
    items = list(likely.values())[:most]
    while len(items) > 1:
        whole = replace(now, steps=(*now.steps, *items), day=quiet)
        steps = []
        for item in items:
            others = whole.without([item])
            after, nats = others.plus(item, quiet), whole.evidence() - others.evidence() + item.log_odds
            if nats >= LEAST_GAIN and (explained := share_shown(others, after, first)) > 0.0:
                steps.append(Step(item, nats, explained))
        if len(steps) == len(items):
            gain = whole.evidence() - now.evidence() + sum(item.log_odds for item in items)
            return (tuple(steps), whole) if gain >= LEAST_GAIN else ((), now)
        items = [step.hypothesis for step in steps]
    return (), now


def share_shown(now: Explanation, after: Explanation, first: Explanation) -> float:
    """Of the first difference of torque, what the last step of `after` takes away on rows that its numbers are not
    from; zero where it is not shown: too small a share, too near to none, or numbers that no such thing has.
    """
    least = LATER_SHARE if now.steps else FIRST_SHARE
    if _share(now, after, first) < least or _sigmas(now, after) < LEAST_SIGMAS or not _plausible(after):
        return 0.0
    return _explained(now, after, first)


def _share(now: Explanation, after: Explanation, first: Explanation) -> float:
    """Of the first difference beyond noise, what the last step takes away on rows that were not fitted, where it acts.

    Beside the parameters, which are free in all, on the quietest day: which day it is was weighed by the evidence.
    """
    noise, counts = now.noise, first.comparison.products.counts(USED)
    whole, before, left = (
        replace(each, day=DAYS[0], noise=noise).holding(after.steps[-1:]).foretold().sum(axis=0)
        for each in (first, now, after)
    )
    heard = _heard(now, after) >= MOST  # else it does not act on that joint
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
    power = ((gram @ values) @ values + moved) / counts
    return np.asarray(np.sqrt(power) / now.noise.std)


def _plausible(after: Explanation) -> bool:
    """Whether the numbers can be those of the thing: a load weighs and is in reach, a clock is no tenth of another, and
    rotors that a file lacks have no inertia below zero.
    """
    item = after.steps[-1]
    values, covariance = after.deviation_of_last()
    if item.effect == "payload":
        if int(item.columns[0]) % PARAMETERS != 0 or abs(values[0]) < CLEAR * np.sqrt(covariance[0, 0]):
            return False
        moments = [k for k, column in enumerate(item.columns) if 1 <= int(column) % PARAMETERS <= 3]
        reach = FARTHEST * float(after.sizes.length.max())
        return float(np.linalg.norm(values[moments])) < reach * abs(float(values[0]))
    if item.effect == "rotor_inertia" and item.joint is None:
        return bool(np.all(values > -CLEAR * np.sqrt(np.diag(covariance))))
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
