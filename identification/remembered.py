"""What is computed once for an object and kept for as long as the object lives."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import TypeVar, TypeVarTuple
from weakref import WeakKeyDictionary

Of = TypeVar("Of")
Result = TypeVar("Result")
Rest = TypeVarTuple("Rest")


def once_per_object(compute: Callable[[Of, *Rest], Result]) -> Callable[[Of, *Rest], Result]:
    """Remember a result, one for each joint or whatever else is asked for beside the object.

    The object never changes, is compared by identity and can be referred to weakly; nobody writes into the result.
    """
    known: WeakKeyDictionary[Of, dict[object, Result]] = WeakKeyDictionary()

    @wraps(compute)
    def remembered(of: Of, *rest: *Rest) -> Result:
        own = known.setdefault(of, {})
        if rest not in own:
            own[rest] = compute(of, *rest)
        return own[rest]

    return remembered
