"""Classes that predict rows which were not fitted; the others go one at a time, and the rest is estimated anew.

What two classes share is missed only once one of them is gone, and one in the wrong place spoils the prediction of its
joint and, through the base parameters, of others.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from identification.mismatch.unknown.selection import FEW_ROUNDS, Selection

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

Error = Callable[[Selection], FloatArray]
"""(n,) logarithm of the held-out RMS of each joint over the one that is to be beaten."""
Dropped = tuple[int, int]
"""Joint (from 0) and number of a class in CLASSES."""

LEAST_CHANGE = 0.01
"""Change of a held-out RMS, as a share of it, that base parameters may cause as well."""


def useful(selection: Selection, error: Error) -> tuple[Selection, tuple[Dropped, ...]]:
    """Only the classes that lower the error of their joint and that of all joints together, by LEAST_CHANGE at least.

    The sum of logarithms is the likelihood of rows of unknown noise. On a joint that is no better than without any no
    class stays. The least useful one goes first; dropped are those that raised an error.
    """
    dropped: list[Dropped] = []
    while True:
        now, options = error(selection), []
        for (joint, number), option in _shorter(selection, held(selection)):
            change = error(option) - now
            worth = float(min(change[joint], change.sum()))
            if worth < np.log1p(LEAST_CHANGE) or now[joint] >= 0.0:
                options.append((worth, (joint, number), option))
        if not options:
            return selection, tuple(dropped)
        worth, place, option = min(options, key=lambda item: item[0])
        selection = _settled(option)
        if worth < 0.0:
            dropped.append(place)


def harmless(selection: Selection, error: Error) -> tuple[Selection, tuple[Dropped, ...]]:
    """The classes that raise the error of no joint, and what was dropped, in that order.

    A joint with classes has to be better with them, one without any may be LEAST_CHANGE worse. Each time a class of the
    joints that are worse goes, of any joint where these hold none: the one without which they are worse by least.
    """
    dropped: list[Dropped] = []
    while (own := held(selection)).any() and (worse := _worse(selection, error(selection))).any():
        asked = worse & own if (worse & own).any() else own
        options = []
        for place, option in _shorter(selection, asked):
            now = error(option)
            options.append((float(now[_worse(option, now)].sum()), float(now.sum()), place, option))
        *_, place, option = min(options, key=lambda item: item[:2])
        selection = _settled(option)
        dropped.append(place)
    return selection, tuple(dropped)


def held(selection: Selection) -> BoolArray:
    """(n,) joints with classes."""
    return np.array([bool(state.groups) for state in selection.states])


def _worse(selection: Selection, error: FloatArray) -> BoolArray:
    """(n,) joints that classes of their own do not predict better, or that those of others predict worse."""
    return np.asarray(error >= np.where(held(selection), 0.0, np.log1p(LEAST_CHANGE)))


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
