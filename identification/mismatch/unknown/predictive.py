"""The classes that may stay because no joint is predicted worse by them: the others are taken away one at a time.

A class in the wrong place spoils its joint's prediction, and through the base parameters another one's; the rest of
what is known of that joint is kept.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from identification.mismatch.unknown.selection import FEW_ROUNDS, Selection

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

Judge = Callable[[Selection], tuple[FloatArray, BoolArray]]
"""Of rows that were not fitted: rise (n,) of the RMS as a share of it, and the joints that refuse the selection."""
Dropped = tuple[int, int]
"""Joint (from 0) and number of a class in CLASSES."""

LEAST_RISE = 0.01
"""Rise of a held-out RMS, as a share of it, that base parameters of another joint's terms may cause."""


def refused(selection: Selection, rise: FloatArray) -> BoolArray:
    """(n,) joints that classes of their own do not predict better, or that those of others predict worse."""
    return np.asarray(rise >= np.where(_held(selection), 0.0, LEAST_RISE))


def predictive(selection: Selection, judge: Judge) -> tuple[Selection, tuple[Dropped, ...]]:
    """The selection with as few classes less as no joint refuses, and what was dropped, in that order.

    Each time the class goes without which the refused joints rise least, of those that hold classes if any does; then
    all joints are estimated anew.
    """
    dropped: list[Dropped] = []
    while any(state.groups for state in selection.states):
        _, bad = judge(selection)
        if not bad.any():
            break
        own = bad & _held(selection)
        options = []
        for joint in np.flatnonzero(own if own.any() else _held(selection)).tolist():
            for number, family in selection.families(joint, selection.states[joint]).items():
                shorter = selection.without(joint, selection.states[joint], family)
                option = selection.with_state(joint, selection.settled(joint, shorter, FEW_ROUNDS))
                rise, still = judge(option)
                options.append((float(rise[still].sum()), float(rise.sum()), (joint, number), option))
        *_, place, best = min(options, key=lambda option: option[:2])
        selection = _settled(best)
        dropped.append(place)
    return selection, tuple(dropped)


def useful(selection: Selection, judge: Judge) -> Selection:
    """Only the classes that lower their joint's RMS on rows that were not fitted, by LEAST_RISE at least.

    The least useful one of a joint goes first, and the others are estimated anew: what two classes share is missed only
    once one of them is gone. None goes whose absence a joint refuses.
    """
    rise = judge(selection)[0]
    for joint in range(len(selection.states)):
        while True:
            state, options = selection.states[joint], []
            for family in selection.families(joint, state).values():
                shorter = selection.settled(joint, selection.without(joint, state, family), FEW_ROUNDS)
                option = selection.with_state(joint, shorter)
                then, bad = judge(option)
                if not bad.any():
                    options.append((float((1.0 + then[joint]) / (1.0 + rise[joint])), option, then))
            least = min(options, default=None, key=lambda option: option[0])
            if least is None or least[0] >= 1.0 + LEAST_RISE:
                break
            _, selection, rise = least
    return _settled(selection)


def _settled(selection: Selection) -> Selection:
    """A copy with all joints estimated anew."""
    result = replace(selection, states=list(selection.states), held=[])
    for joint, state in enumerate(selection.states):
        result.states[joint] = result.settled(joint, state, FEW_ROUNDS)
    return result


def _held(selection: Selection) -> BoolArray:
    return np.array([bool(state.groups) for state in selection.states])
