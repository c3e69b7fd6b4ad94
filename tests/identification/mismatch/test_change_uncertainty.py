"""The size of what changes over the periods, when its time constant is estimated too."""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from identification.mismatch.changes.uncertainty import shape_covariance
from identification.mismatch.effects.base import Place, ShapeParameter

PERIODS = np.arange(16.0) * 10.0


class Bench:
    """One joint, one row a period: c exp(-t/T) in white noise of one."""

    motion = None

    def rows(self, effect: object, place: Place, shape: Mapping[str, float]) -> tuple[tuple[int, ...], Any]:
        del effect, place
        return (0,), np.exp(-PERIODS / shape["time_constant_s"])[:, None, None, None]

    def whiten(self, rows: Any, joints: object) -> Any:
        del joints
        return rows - rows.mean(axis=0)


def test_the_interval_is_that_of_both_parameters_together() -> None:
    """Against the inverse of the information matrix of (c, T), derivatives in closed form."""
    parameter = ShapeParameter("time_constant_s", "s", (60.0,), 10.0, 1200.0)
    effect = SimpleNamespace(shape_parameters=lambda *_: (parameter,))
    size, constant = 40.0, 60.0
    bench: Any = Bench()
    added = shape_covariance(bench, effect, Place(1), {"time_constant_s": constant}, np.array([size]))  # type: ignore[arg-type]
    fade = np.exp(-PERIODS / constant)
    tangents = np.stack([fade, size * fade * PERIODS / constant**2], axis=1)
    tangents -= tangents.mean(axis=0)
    information = tangents.T @ tangents
    together = np.linalg.inv(information)[0, 0]
    assert added[0, 0] == pytest.approx(together - 1.0 / information[0, 0], rel=0.02)
