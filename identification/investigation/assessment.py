"""What may still be missing: forms of the library weighed among classes of dependence, and those that are alive.

Every hypothesis, "none of the library" too, has classes and noise of its own beside it, as large as its own evidence
asks for: a smooth error of the model is then no reason for a form, and a form has to be better than a free function of
the same state. The evidence is that of the diagnosis (`identification.mismatch.unknown`).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from identification.arrays import FloatArray
from identification.investigation.columns import Form, form_rows, stacked
from identification.investigation.discrepancy import Discrepancies, variances_of
from identification.investigation.free_functions import nearest
from identification.investigation.hypotheses import NOTHING, Assessment, Hypothesis
from identification.investigation.screening import Screened, Weighting, screen
from identification.mismatch.effects.base import Place
from identification.mismatch.evidence import Evidence, rows_of_each
from identification.mismatch.prepared import Prepared
from identification.mismatch.settings import PRIOR_COST, SPEAK
from identification.mismatch.unknown.choice import eliminated
from identification.mismatch.unknown.classes import CLASSES
from identification.mismatch.unknown.evidence import ABSENT, FREE
from identification.mismatch.unknown.named import energies, shown_on
from identification.mismatch.unknown.rows import Rows, build_rows
from identification.mismatch.unknown.selection import FULL_ROUNDS, JointState, Selection

NO_FORM = 4.0
"""Prior odds of nothing against all forms of the library together, and against all classes: each kind shares evenly."""
WITHIN = 7.0
"""Nats below the most probable hypothesis up to which one is alive: odds of a thousand to one."""
MOST_ALIVE, MOST_WEIGHED = 8, 6
_DESCRIBED = frozenset(number for number, kind in enumerate(CLASSES) if kind.described)
"""Classes that a name describes completely: alone on a joint the name stands for them."""
_BACKGROUND = frozenset(number for number, kind in enumerate(CLASSES) if kind.background)
_CONSTANT = next(number for number, kind in enumerate(CLASSES) if kind.name == "constant")
_UNNAMED = frozenset(range(len(CLASSES))) - {_CONSTANT}
"""Classes that stand for torque of no known form; a constant alone is an offset."""
_MOST_PASSES = 3


def assess(
    evidences: Sequence[Evidence], known: Sequence[Form] = (), asked: Collection[tuple[str, int | None]] = ()
) -> Assessment:
    """Weigh every form of the library on these evidences together.

    known: settled findings. asked: effects with their joints (from 1) that stay alive whatever their evidence says
    (claimed by the diagnosis, or among its alternatives).
    """
    rows = tuple(_with_known(item, known) for item in evidences)
    named = {joint - 1 for _, joint in asked if joint is not None}
    unknown = build_rows(Prepared(rows, (), tuple(item.torque for item in rows)), None, named)
    plain = Selection.of(unknown, range(unknown.folds))
    unknown = plain.rows  # with products of each band
    nothing = _with_classes(plain)
    beside = any(state.groups for state in nothing.states)
    weightings = [Weighting.of(plain), *([Weighting.of(nothing)] if beside else [])]
    screened, count = screen(rows, weightings, {(form.effect, form.place) for form in known})
    prior = -math.log(NO_FORM * count)
    sizes = [len(joint.bases) for joint in unknown.joints]
    none = replace(NOTHING, log_odds=-_shared_odds(nothing), beside=variances_of(nothing.states, sizes))
    found, noise = [none], [_noise(nothing)]
    free: dict[tuple[str | None, Place], dict[int, tuple[int, ...]]] = {}
    for item in _chosen(screened, asked):
        weighed = _weighed(nothing, unknown, rows, item, prior)
        if weighed is not None:
            found.append(weighed[0])
            noise.append(weighed[1])
            free.setdefault((item.effect.name, item.place), {}).update(weighed[2])
    leader = max(range(len(found)), key=lambda number: found[number].log_odds)
    first = found[leader]
    if first.effect is not None and first.place.joint is not None and not unknown.asked[first.place.joint - 1]:
        # The diagnosis holds a name against the classes of its joint, however little that joint shows.
        return assess(evidences, known, {*asked, (first.effect, first.place.joint)})
    inflated = tuple(
        replace(item, noise=item.noise * np.sqrt(noise[leader].T[unknown.band[own]]))
        for item, own in zip(rows, rows_of_each(rows), strict=True)
    )
    alive = _alive(found, asked)
    there = []
    for joint in range(len(sizes)):
        used = {int(place) for item in alive for place in np.flatnonzero(item.beside[joint])}
        used.update(place for item in alive for place in free.get((item.effect, item.place), {}).get(joint, ()))
        there.append(np.array(sorted(used), dtype=np.int64))
    alive = tuple(
        replace(item, beside=tuple(own[kept] for own, kept in zip(item.beside, there, strict=True))) for item in alive
    )
    bases = tuple(
        tuple(joint.bases[number] for number in kept) for joint, kept in zip(unknown.joints, there, strict=True)
    )
    return Assessment(alive, inflated, Discrepancies(bases, unknown.fitted, unknown.inputs[0].fade_width))


def _with_classes(plain: Selection) -> Selection:
    """Classes on every joint that asks for one, the worst joint first; twice, as joints share base columns."""
    rows = plain.rows
    result = Selection(rows, plain.worlds, plain.signs, list(plain.states))
    order = np.argsort(-rows.misfit * np.median(rows.problem.weight, axis=1) ** 2)
    for _ in range(2):
        for joint in map(int, order):
            if rows.asked[joint] and result.asks(joint):
                # Whatever else the torque depends on has a mean of its own; a constant alone is a name.
                state = eliminated(result, joint, _DESCRIBED - {_CONSTANT})
                only = set(result.classes(joint, state)) == {_CONSTANT}
                result.states[joint] = eliminated(result, joint, _DESCRIBED) if only else state
    if _missed(result, _UNNAMED) >= SPEAK:
        # Beside torque of no known form no constant is a name. Were it left to the forms, a spring that holds it leads.
        for joint in map(int, order):
            if rows.asked[joint] and not result.states[joint].groups and result.asks(joint):
                result.states[joint] = eliminated(result, joint, _DESCRIBED - {_CONSTANT})
    score = result.total()
    for _ in range(_MOST_PASSES):
        for joint in map(int, order):
            result.states[joint] = result.settled(joint, result.states[joint], FULL_ROUNDS)
        before, score = score, result.total()
        if score - before < 0.5:
            break
    return result


def _missed(selection: Selection, only: Collection[int]) -> float:
    """Nats of the class that weighs most on any joint, of these numbers."""
    losses = (selection.losses(joint, state) for joint, state in enumerate(selection.states))
    return max((loss for own in losses for number, loss in own.items() if number in only), default=0.0)


def _fewer(selection: Selection, joint: int) -> JointState:
    """A joint's state without the classes that are not missed, the least missed first, the rest estimated anew."""
    state = selection.settled(joint, selection.states[joint], FULL_ROUNDS)
    while losses := selection.losses(joint, state):
        least = min(losses, key=lambda number: losses[number])
        shorter = selection.settled(joint, selection.without(joint, state, [least]), FULL_ROUNDS)
        if selection.score(joint, shorter) <= selection.score(joint, state):
            break
        state = shorter
    return state


def _chosen(screened: Sequence[Sequence[Screened]], asked: Collection[tuple[str, int | None]]) -> list[Screened]:
    """The best ones of each weighting, and those that are asked for."""
    found: dict[Form, Screened] = {}
    for items in screened:
        seen = [item for item in items if item.gain > 0.0]
        ordered = sorted(seen, key=lambda item: -(item.gain + item.spread - 2.0 * item.best.size))
        wanted = [item for item in ordered[MOST_WEIGHED:] if (item.effect.name, item.place.joint) in asked]
        for item in (*ordered[:MOST_WEIGHED], *wanted):
            found.setdefault(item.best, item)
    return list(found.values())


def _weighed(
    nothing: Selection, unknown: Rows, rows: Sequence[Evidence], item: Screened, prior: float
) -> tuple[Hypothesis, FloatArray, dict[int, tuple[int, ...]]] | None:
    """One form with the classes that it leaves on its joints, the noise beside it (n, bands), and on each of its joints
    (from 0) the free functions that come nearest to it.
    """
    joints, columns = stacked(rows, item.best)
    every = np.zeros((unknown.problem.n, *columns.shape[1:]))
    every[list(joints)] = columns
    among = unknown.with_columns([(every, item.coefficients)])
    parts = (among.of(range(among.folds)),)
    whole = Selection(among, parts, (1.0,))
    whole.states = [whole.state(joint, own.groups, own.hyper) for joint, own in enumerate(nothing.states)]
    touched = set(shown_on(unknown.problem, every @ item.coefficients))
    # Joints share base columns: what a form explains, classes of other joints may have stood for. A smooth error stays.
    others = [] if _missed(nothing, _BACKGROUND) else [joint for joint, own in enumerate(nothing.states) if own.groups]
    for joint in (*touched, *(number for number in others if number not in touched)):
        if unknown.asked[joint]:
            whole.states[joint] = _fewer(whole, joint)
    now = whole.posterior(0, whole.states[0])
    own = np.arange(unknown.prior.size, among.prior.size)
    coefficients = now.base[own]
    if item.effect.is_impossible(coefficients):
        return None
    place = now.covariance.shape[0] - now.base.size + own
    absent = among.prior.copy()
    absent[own] = ABSENT
    rest = Selection(replace(among, prior=absent), parts, (1.0,), whole.states)
    worth = whole.total() - rest.total()
    # An evidence leaves out ½ log FREE of each column beside the base parameters, of which the form has some more.
    gained = whole.total() - nothing.total() + 0.5 * own.size * math.log(FREE)
    log_odds = min(gained, worth) + item.spread + prior - _shared_odds(whole)
    beside, none = _missed(whole, _UNNAMED) >= SPEAK, -_shared_odds(nothing)
    shown, unnamed = energies(whole, touched, own, coefficients)
    described = [number for number, kind in enumerate(CLASSES) if item.effect.name in kind.described]
    if shown < unnamed or (beside and (_CONSTANT in described or log_odds < none + SPEAK)):
        # It may be what functions of no known form fail to describe: the diagnosis gives no such name, so none leads.
        log_odds = min(log_odds, none)
    sizes = [len(joint.bases) for joint in unknown.joints]
    factors = [state.hyper.noise for state in whole.states]
    free = {
        joint: nearest(parts[0], factors, among.joints[joint], joint, coefficients, described)
        for joint in touched
        if among.joints[joint].bases
    }
    return Hypothesis(
        item.effect.name, item.place, item.forms, item.best, coefficients, now.covariance[np.ix_(place, place)],
        log_odds, beside=variances_of(whole.states, sizes), unnamed=beside,
    ), _noise(whole), free  # fmt: skip


def _shared_odds(selection: Selection) -> float:
    """Nats that its classes cost beyond what the evidence takes off: they share their odds as forms do theirs."""
    joints = range(len(selection.states))
    count = sum(len(selection.classes(joint, selection.states[joint])) for joint in joints)
    return count * (math.log(NO_FORM * len(CLASSES) * len(selection.states)) - PRIOR_COST)


def _noise(selection: Selection) -> FloatArray:
    """(n, bands) factor of the measured variance, at least 1."""
    return np.maximum(1.0, np.stack([state.hyper.noise for state in selection.states]))


def _alive(found: Sequence[Hypothesis], asked: Collection[tuple[str, int | None]]) -> tuple[Hypothesis, ...]:
    """The most probable ones, one shape of each effect and place, and those that are asked for."""
    best: dict[tuple[str | None, Place], Hypothesis] = {}
    for item in found:
        key = (item.effect, item.place)
        best[key] = max(best.get(key, item), item, key=lambda each: each.log_odds)
    everything = sorted(best.values(), key=lambda item: -item.log_odds)
    top = everything[0].log_odds
    wanted = [item for item in everything if (item.effect, item.place.joint) in asked or item.effect is None]
    near = [item for item in everything if item.log_odds >= top - WITHIN]
    forms = [item for item in everything if item.effect is not None]
    if forms and all(item.effect is None for item in (*near, *wanted)):
        # A motion is chosen for the forms that come nearest, however far that is.
        near = [item for item in forms if item.log_odds >= forms[0].log_odds - WITHIN]
    kept = sorted(dict.fromkeys([*near[:MOST_ALIVE], *wanted]), key=lambda item: -item.log_odds)
    total = sum(math.exp(item.log_odds - top) for item in kept)
    return tuple(replace(item, probability=math.exp(item.log_odds - top) / total) for item in kept)


def _with_known(evidence: Evidence, known: Sequence[Form]) -> Evidence:
    if not known:
        return evidence
    return replace(
        evidence, nominal=np.concatenate([evidence.nominal, *(form_rows(evidence, form) for form in known)], axis=2)
    )
