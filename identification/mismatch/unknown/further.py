"""Functions of one other joint each, on joints that all other classes may leave more than noise.

Here: which joints are asked, and the search, which puts groups in one by one. The usual search (`choice`) begins with
all functions at once: so many would share a torque, and none of them would be missed. Not here: the functions
(`classes`), what a set of them is worth (`selection`).
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import replace

import numpy as np
from scipy.special import chdtrc

from identification.mismatch.settings import PRIOR_COST
from identification.mismatch.unknown.choice import exchange
from identification.mismatch.unknown.rows import Found
from identification.mismatch.unknown.selection import FEW_ROUNDS, FULL_ROUNDS, JointState, Selection


def left_more_than_noise(selection: Selection) -> list[int]:
    """Joints (from 0) whose classes leave more than the measured noise below some frequency, beyond the odds against a
    class. Where the noise is not measured nobody knows what is left: all that are asked.
    """
    rows, found = selection.rows, []
    asked = np.flatnonzero(rows.asked).tolist()
    if not rows.problem.noise_is_measured:
        return asked
    for joint in asked:
        state = selection.states[joint]
        now = selection.posterior(joint, state)
        freedom = np.maximum(state.gram.count - now.spread / state.hyper.noise, 1.0)
        if chdtrc(np.cumsum(freedom), np.cumsum(now.left)).min() < np.exp(-PRIOR_COST):
            found.append(joint)
    return found


def asked_further(selection: Selection, joints: Sequence[int]) -> Selection:
    """A selection of which some joints (from 0) hold further groups where these are worth it.

    Its rows have the groups that were there before, and of the further ones those that were tried.
    """
    known: dict[Hashable, Found] = {}
    for joint in joints:
        candidates = selection.rows.further(joint, known)
        if not candidates:
            continue
        # What a joint holds may stand for what it lacked, so it grows from nothing too.
        empty = selection.settled(joint, selection.unsettled(joint, ()), FULL_ROUNDS)
        grown = [
            _grown(selection.with_state(joint, state), joint, candidates) for state in (selection.states[joint], empty)
        ]
        best = max([selection, *grown], key=lambda option: option.score(joint, option.states[joint]))
        best.held = [item for item in selection.held if item.joint != joint]
        exchange(best, [joint])
        selection = best
    return selection


def _grown(selection: Selection, joint: int, candidates: Found) -> Selection:
    """With the classes and further groups that gain most, put in one by one while each is worth what a class costs."""
    score, untried = selection.score(joint, selection.states[joint]), list(candidates)
    while True:
        state = selection.states[joint]
        classes = selection.gains(joint, state)
        gain, number = max(((gain, number) for number, gain in classes.items()), default=(0.0, 0))
        groups = _gains(selection, joint, untried)
        more, place = max(((gain, place) for place, gain in groups.items()), default=(0.0, 0))
        if max(gain, more) < PRIOR_COST:
            return selection
        if more > gain:
            selection = selection.with_group(joint, *untried.pop(place))
            state = selection.with_added(joint, state, [len(selection.rows.joints[joint].bases) - 1])
        else:
            state = selection.with_class(joint, state, number)
        if selection.rows.noise_rows:
            # Noise that was estimated has taken for noise what is put in.
            state = selection.state(joint, state.groups, replace(state.hyper, noise=np.ones_like(state.hyper.noise)))
        state = _pruned(selection, joint, selection.settled(joint, state, FULL_ROUNDS, quiet=FULL_ROUNDS))
        worth = selection.score(joint, state)
        if worth <= score + PRIOR_COST:
            return selection
        selection, score = selection.with_state(joint, state), worth


def _gains(selection: Selection, joint: int, candidates: Found) -> dict[int, float]:
    """Nats that each candidate alone would gain, by its place among them."""
    if not candidates:
        return {}
    state, rows = selection.states[joint], selection.rows.joints[joint]
    noise = (state.hyper.noise if selection.predicted else state.hyper.noise[selection.rows.band])[:, None]
    weighted = [own / noise for _, own in candidates]
    visible = [own.T @ other for (_, own), other in zip(candidates, weighted, strict=True)]
    every = np.concatenate(weighted, axis=1)
    held = rows.whitened[:, selection.columns(joint, state)]
    gains = selection.gains_of(joint, state, visible, held.T @ every, every.T @ rows.whitened[:, rows.columns :])
    return dict(enumerate(gains))


def _pruned(selection: Selection, joint: int, state: JointState) -> JointState:
    """A state without the classes that are not missed, the least missed first."""
    while losses := selection.losses(joint, state):
        least = min(losses, key=lambda number: losses[number])
        if losses[least] >= PRIOR_COST:
            break
        state = selection.settled(joint, selection.without(joint, state, [least]), FEW_ROUNDS)
    return state
