"""Which classes a joint holds: all of them first, taken away one by one; then each against others in its place.

Here: the search. Not here: what a set of classes is worth (`selection`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from identification.mismatch.settings import ALTERNATIVE, PRIOR_COST, SPEAK
from identification.mismatch.unknown.classes import CLASSES
from identification.mismatch.unknown.selection import FEW_ROUNDS, FULL_ROUNDS, Held, JointState, Selection

EXCHANGES = 3
"""Classes of one joint that another may take the place of."""
WEAK = 0.1
"""Nats below which several classes are dropped at once."""


def choose_classes(selection: Selection) -> Selection:
    """Put classes on every joint that asks for one, the worst joint first; twice, as joints share base columns."""
    order = np.argsort(-selection.rows.misfit * np.median(selection.rows.problem.weight, axis=1) ** 2)
    for _ in range(2):
        for joint in map(int, order):
            if selection.rows.asked[joint] and selection.asks(joint):
                selection.states[joint] = eliminated(selection, joint)
            elif selection.states[joint].groups:
                selection.states[joint] = selection.settled(joint, selection.states[joint], FEW_ROUNDS)
    exchange(selection, range(selection.rows.problem.n))
    without_background_of_few(selection)
    return selection


def without_background_of_few(selection: Selection) -> bool:
    """A smooth error of a few joints is no background of the arm: there the particular classes are asked.

    An unknown error of the whole model shows on most joints; one that shows on half of them, on one or on none is not
    there. Where the noise is not measured, slow noise is smooth too: then on one or on none. Whether any joint was
    asked anew.
    """
    smooth = frozenset(number for number, kind in enumerate(CLASSES) if kind.background)
    heard = [item for item in selection.held if item.loss >= SPEAK]
    problem = selection.rows.problem
    few = max(1, problem.n // 2) if problem.noise_is_measured else 1
    if len({item.joint for item in heard if item.number in smooth}) > few:
        return False
    selection.banned = smooth
    found = [item.joint for item in selection.held if smooth & {item.number, *item.alternatives}]
    for joint in dict.fromkeys(found):
        selection.states[joint] = eliminated(selection, joint)
        selection.held = [item for item in selection.held if item.joint != joint]
        exchange(selection, [joint])
    return bool(found)


def eliminated(selection: Selection, joint: int, banned: frozenset[int] = frozenset()) -> JointState:
    """A joint with all classes, taken away one by one, the least missed first, while that costs too little.

    banned: numbers of classes that are left aside.
    """
    banned |= selection.banned
    full = selection.without(joint, selection.full(joint), sorted(banned)) if banned else selection.full(joint)
    state = selection.settled(joint, full, FEW_ROUNDS, quiet=FULL_ROUNDS)
    while state.groups:
        losses = selection.losses(joint, state)
        weak = [number for number, loss in losses.items() if loss < WEAK]
        least = min(losses, key=lambda number: losses[number])
        if losses[least] < PRIOR_COST:
            state = selection.settled(joint, selection.without(joint, state, weak or [least]), FEW_ROUNDS)
            continue
        shorter = _one_less(selection, joint, state, losses)
        if shorter is None:
            break
        state = shorter
    return selection.settled(joint, state, FULL_ROUNDS)


def _one_less(selection: Selection, joint: int, state: JointState, losses: dict[int, float]) -> JointState | None:
    """The state without the class that is missed least once the others are estimated anew, where that is better."""
    state = selection.settled(joint, state, FEW_ROUNDS)
    score = selection.score(joint, state)
    options = [
        selection.settled(joint, selection.without(joint, state, [number]), FEW_ROUNDS)
        for number in sorted(losses, key=lambda number: losses[number])[:4]
    ]
    best = max(options, key=lambda option: selection.score(joint, option))
    return best if selection.score(joint, best) > score else None


def kept(selection: Selection, other: Selection) -> Selection:
    """With the classes that another selection of some of these groups holds, and what each is worth among them."""
    result = replace(selection, states=list(selection.states), held=[])
    for _ in range(2):
        for joint, state in enumerate(other.states):
            numbers = set(result.classes(joint, result.states[joint])) - set(other.classes(joint, state))
            shorter = result.without(joint, result.states[joint], sorted(numbers))
            result.states[joint] = result.settled(joint, shorter, FEW_ROUNDS)
    exchange(result, range(len(result.states)), 0)
    return result


def exchange(selection: Selection, joints: Sequence[int], most: int = EXCHANGES) -> None:
    """Every class against every other one in its place: the better one stands, those as good are its alternatives.

    Classes that lose less than `speak` nats stay in the model but are not held.
    """
    for joint in joints:
        for turn in range(most + 1):
            state, score = selection.states[joint], selection.score(joint, selection.states[joint])
            found: list[Held] = []
            better: JointState | None = None
            best = score + WEAK
            for number, family in selection.families(joint, state).items():
                shorter = selection.settled(joint, selection.without(joint, state, family), FULL_ROUNDS)
                loss = score + PRIOR_COST * len(family) - selection.score(joint, shorter)
                rest = selection.without(joint, state, [number])
                as_good = []
                gains = selection.gains(joint, rest)
                least = gains[number] - ALTERNATIVE - PRIOR_COST
                for other in (other for other, gain in gains.items() if other != number and gain > least):
                    option = selection.with_class(joint, rest, other)
                    option = selection.settled(joint, option, FEW_ROUNDS, quiet=FEW_ROUNDS)
                    value = selection.score(joint, option)
                    if value > best:
                        best, better = value, option
                    if value > score - ALTERNATIVE:
                        as_good.append((value, other))
                names = tuple(other for _, other in sorted(as_good, reverse=True))
                found.append(Held(number, joint, loss, names))
            if better is None or turn == most:
                # What is held is what stands: never the state before the last exchange.
                break
            selection.states[joint] = better
        selection.held += found
