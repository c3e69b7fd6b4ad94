"""Functions of one other joint each, and narrow ones of its own position, on joints that all other classes leave more
than noise.

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
from identification.mismatch.unknown.classes import CLASSES
from identification.mismatch.unknown.rows import Found
from identification.mismatch.unknown.selection import FEW_ROUNDS, FULL_ROUNDS, JointState, Selection

MEAN = next(number for number, kind in enumerate(CLASSES) if kind.name == "constant")
"""Number of the class that any other one has a part in."""


def left_more_than_noise(selection: Selection) -> list[int]:
    """Joints (from 0) whose classes leave more than the measured noise below some frequency, beyond the odds against a
    class; none where the noise is not measured.
    """
    rows = selection.rows
    if not rows.problem.noise_is_measured:
        return []
    found = []
    for joint in np.flatnonzero(rows.asked).tolist():
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
        grown = _grown(selection, joint, candidates)
        best = max((selection, grown), key=lambda option: option.score(joint, option.states[joint]))
        best.held = [item for item in selection.held if item.joint != joint]
        exchange(best, [joint])
        selection = best
    return selection


def _grown(selection: Selection, joint: int, candidates: Found) -> Selection:
    """With the classes and further groups that gain most, put in one by one while each is worth what a class costs."""
    score, untried = selection.score(joint, selection.states[joint]), list(candidates)
    while True:
        # Noise that was estimated has taken for noise what is to be put in.
        state = selection.states[joint]
        state = selection.state(joint, state.groups, replace(state.hyper, noise=np.ones_like(state.hyper.noise)))
        quiet = selection.with_state(joint, state)
        classes = {number: gain for number, gain in quiet.gains(joint, state).items() if not CLASSES[number].within}
        groups, options = _gains(quiet, joint, untried), []
        if max(classes.values(), default=0.0) >= PRIOR_COST:
            number = max(classes, key=lambda item: classes[item])
            options.append((selection, selection.with_class(joint, state, number)))
        if max(groups.values(), default=0.0) >= PRIOR_COST:
            place = max(groups, key=lambda item: groups[item])
            wider = selection.with_group(joint, *untried[place])
            options.append((wider, wider.with_added(joint, state, [len(wider.rows.joints[joint].bases) - 1])))
        # Functions are centred: with one that is put in comes its mean, which goes again where it is not missed.
        options = [(option, option.with_class(joint, new, MEAN)) for option, new in options]
        grown = [
            option.with_state(joint, _pruned(option, joint, option.settled(joint, new, FULL_ROUNDS, quiet=FULL_ROUNDS)))
            for option, new in options
        ]
        best = max([selection, *grown], key=lambda option: option.score(joint, option.states[joint]))
        worth = best.score(joint, best.states[joint])
        if worth <= score + PRIOR_COST:
            return selection
        if best.rows is not selection.rows:
            untried.pop(place)
        selection, score = best, worth


def _gains(selection: Selection, joint: int, candidates: Found) -> dict[int, float]:
    """Nats that each candidate alone would gain, by its place among them."""
    if not candidates:
        return {}
    state, rows = selection.states[joint], selection.rows.joints[joint]
    noise = state.hyper.noise[selection.rows.band][:, None]
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
