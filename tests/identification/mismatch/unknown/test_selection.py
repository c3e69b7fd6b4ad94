"""What a selection holds is what stands on the joint. No truth from outside: a rule about the program itself."""

from __future__ import annotations

from itertools import count

import numpy as np
import pytest

from identification.base_parameters import BaseRegressor
from identification.mismatch.prepared import prepare
from identification.mismatch.settings import DiagnosisSettings
from identification.mismatch.unknown.rows import build_rows
from identification.mismatch.unknown.selection import Selection
from identification.mismatch.unknown.settings import ClaimSettings
from identification.physical_parameters import PhysicalParameters
from identification.robots import RobotModel
from tests.identification.mismatch.plant import on_joint, record


def bends(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
    del dq, torque
    return on_joint(3, 0.3 * np.tanh(q[:, 2] / 0.2))


def test_what_is_held_stands_also_where_every_exchange_seems_better(
    iiwa14: RobotModel, iiwa14_base: BaseRegressor, table3: PhysicalParameters, monkeypatch: pytest.MonkeyPatch
) -> None:
    fitted = prepare([record(iiwa14, table3, bends)], iiwa14, iiwa14_base, DiagnosisSettings(), None)
    settings = ClaimSettings(alternative=1e9)
    selection = Selection.of(build_rows(fitted, None, settings), [0], settings)
    selection.states[2] = selection.eliminated(2)
    calls = count()
    monkeypatch.setattr(Selection, "score", lambda *_: float(next(calls)))
    selection._exchange([2])
    standing = selection.families(2, selection.states[2])
    assert selection.held
    assert [item.number for item in selection.held] == list(standing)
