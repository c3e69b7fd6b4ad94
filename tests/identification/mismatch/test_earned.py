"""Which names have to stand against classes. Truth: errors written down here."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from identification.mismatch.names import earned
from identification.mismatch.names.earned import AgainstClasses


@pytest.mark.parametrize(
    ("measured", "with_name", "by_classes", "asked"),
    [
        (False, 1.0, 1.0, []),
        # A quarter of the mean square taken, by classes three quarters.
        (False, np.sqrt(3.0), 1.0, [0]),
        # A quarter each.
        (False, np.sqrt(3.0), np.sqrt(3.0), []),
        (True, 1.0, 1.0, [0]),
    ],
)
def test_without_a_measured_noise_a_name_that_takes_half_of_what_classes_take_is_not_asked_for_odds(
    monkeypatch: pytest.MonkeyPatch, measured: bool, with_name: float, by_classes: float, asked: list[int]
) -> None:
    """Joint 1 of two, 2 Nm RMS left of it without anything."""

    def settled(members: Any) -> Any:
        rms = np.array([with_name if members else 2.0, 5.0])
        return SimpleNamespace(heldout_after=SimpleNamespace(rms_nm=rms))

    exam = SimpleNamespace(problem=SimpleNamespace(noise_is_measured=measured), check=lambda _: None)
    dependence = SimpleNamespace(every=None, chosen=(), after=(None, np.array([by_classes, 5.0])))
    seen: list[list[int]] = []
    monkeypatch.setattr(AgainstClasses, "_named", lambda *_: [SimpleNamespace(joints=(0,))])
    monkeypatch.setattr(earned, "standings", lambda _every, _names, chosen, *_: seen.append(list(chosen)) or {})
    classes = AgainstClasses(cast(Any, exam), cast(Any, dependence), settled)
    assert classes.unearned(cast(Any, SimpleNamespace(members=("a name",)))) == []
    assert seen == [asked]
