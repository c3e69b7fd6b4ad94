"""What share of a difference a cause is said to explain. Truth: squares that are written down here, part by part."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest

from identification.audit.shown import _explained


@dataclass(frozen=True)
class Told:
    """An explanation of which only the squares that it leaves are known, (parts, joints)."""

    squares: np.ndarray
    day: float = 1.0
    steps: tuple[None, ...] = (None,)
    noise: ClassVar[Any] = SimpleNamespace(std=np.ones(1))

    def holding(self, _: object) -> Told:
        return self

    def foretold(self, *_: object) -> np.ndarray:
        return self.squares


@pytest.mark.parametrize(
    ("first", "share"),
    [
        (60.0, 0.95),  # nothing but this cause
        (120.0, 0.475),  # another one took half before
        (15.0, 0.95),  # the two hid each other: 380 % of the first difference was said
        (10000.0, 0.0057),
        (20000.0, 0.0),  # "0 % of the difference" was said
    ],
)
def test_no_cause_explains_more_than_there_is(first: float, share: float) -> None:
    whole, before, after = (Told(np.array([[v], [1.1 * v], [0.9 * v]])) for v in (first / 3.0, 20.0, 1.0))
    assert np.isclose(_explained(before, after, whole), share)
