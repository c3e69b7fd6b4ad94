"""Classes that predict rows which were not fitted; the others go one at a time, and the rest is estimated anew.

What two classes share is missed only once one of them is gone, and one in the wrong place spoils the prediction of its
joint and, through the base parameters, of others.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from identification.arrays import BoolArray, FloatArray
from identification.mismatch.unknown.selection import FEW_ROUNDS, Selection

Left = Callable[[Selection], FloatArray]
"""RMS (n,) Nm that a selection leaves of rows that were not fitted."""
Dropped = tuple[int, int]
"""Joint (from 0) and number of a class in CLASSES."""

LEAST_CHANGE = 0.01
"""Change of a held-out RMS, as a share of it, that base parameters may cause as well."""


def useful(selection: Selection, left: Left, beaten: FloatArray) -> tuple[Selection, tuple[Dropped, ...]]:
    """Only the classes that lower the error of their joint and that of all joints together, by LEAST_CHANGE at least.

    The sum of logarithms is the likelihood of rows of unknown noise. On a joint that is left no less than `beaten` (n,)
    Nm no class stays. The least useful one goes first; dropped are those that raised an error.
    """
    dropped: list[Dropped] = []
    while True:
        now, options = left(selection), []
        for (joint, number), option in _shorter(selection, held(selection)):
            change = np.log(left(option) / now)
            worth = float(min(change[joint], change.sum()))
            if worth < np.log1p(LEAST_CHANGE) or now[joint] >= beaten[joint]:
                options.append((worth, (joint, number), option))
        if not options:
            return selection, tuple(dropped)
        worth, place, option = min(options, key=lambda item: item[0])
        selection = _settled(option)
        if worth < 0.0:
            dropped.append(place)


def harmless(
    selection: Selection, left: Left, beaten: FloatArray, allowed: FloatArray
) -> tuple[Selection, tuple[Dropped, ...]]:
    """The classes that raise the error of no joint, and what was dropped, in that order.

    A joint with classes has to be left less than `beaten` (n,) Nm, one without any may be LEAST_CHANGE worse than
    `allowed`. Each time a class of the joints that are worse goes, of any joint where these hold none: the one without
    which they are worse by least.
    """

    def excess(item: Selection) -> tuple[FloatArray, BoolArray]:
        """Logarithm (n,) of what each joint has too much, and whether that counts."""
        own = held(item)
        most = np.where(own, beaten, allowed)
        change = np.log(left(item) / most)
        return change, np.asarray(change >= np.where(own, 0.0, np.log1p(LEAST_CHANGE)))

    dropped: list[Dropped] = []
    while (own := held(selection)).any() and (worse := excess(selection)[1]).any():
        options = []
        for place, option in _shorter(selection, worse & own if (worse & own).any() else own):
            change, still = excess(option)
            options.append((float(change[still].sum()), float(change.sum()), place, option))
        *_, place, option = min(options, key=lambda item: item[:2])
        selection = _settled(option)
        dropped.append(place)
    return selection, tuple(dropped)


def held(selection: Selection) -> BoolArray:
    """(n,) joints with classes."""
    return np.array([bool(state.groups) for state in selection.states])


def _shorter(selection: Selection, asked: BoolArray) -> Iterator[tuple[Dropped, Selection]]:
    """Each class of some joints (n,) with the selection without it, its joint estimated anew."""
    for joint in np.flatnonzero(asked).tolist():
        state = selection.states[joint]
        for number, family in selection.families(joint, state).items():
            rest = selection.settled(joint, selection.without(joint, state, family), FEW_ROUNDS)
            yield (joint, number), selection.with_state(joint, rest)


def _settled(selection: Selection) -> Selection:
    """A copy with all joints estimated anew."""
    result = replace(selection, states=list(selection.states), held=[])
    for joint, state in enumerate(selection.states):
        result.states[joint] = result.settled(joint, state, FEW_ROUNDS)
    return result
