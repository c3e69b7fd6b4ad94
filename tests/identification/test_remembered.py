"""Claims about what is computed once. Truth: a count of the calls, and whether the object is still there."""

from __future__ import annotations

import gc
import weakref

from identification.remembered import once_per_object


class Thing:
    """Something that is told from others by identity."""


def test_each_object_is_asked_once_for_each_question_and_kept_no_longer_than_it_lives() -> None:
    asked: list[tuple[Thing, int]] = []

    @once_per_object
    def answer(thing: Thing, number: int) -> list[int]:
        asked.append((thing, number))
        return [number]

    first, second = Thing(), Thing()
    assert answer(first, 1) is answer(first, 1)
    assert answer(first, 2) == [2]
    assert answer(second, 1) is not answer(first, 1)
    assert asked == [(first, 1), (first, 2), (second, 1)]
    asked.clear()
    alive = weakref.ref(first)
    del first
    gc.collect()
    assert alive() is None
