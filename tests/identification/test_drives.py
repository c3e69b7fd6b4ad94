"""Which rows are held out when the data choose rotor inertias and offsets. Truth: torques written down here."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from identification.base_parameters import BaseRegressor, RegressorOptions
from identification.fitting.drives import choose_drive_parameters
from identification.robots import RobotModel
from tests.identification.synthetic import fourier_motion


@pytest.mark.parametrize(("offsets", "wanted"), [((1.0, -0.3), False), ((1.0, 0.9), True)])
def test_an_offset_has_to_hold_on_the_recording_that_was_not_fitted(
    iiwa14: RobotModel, offsets: tuple[float, float], wanted: bool
) -> None:
    """1.0 Nm on one day and -0.3 Nm on another: each predicts the other worse than none does."""
    regressor = BaseRegressor(iiwa14, RegressorOptions(offset=True))
    generator = np.random.default_rng(2)
    blocks: list[Any] = []
    for number, offset in enumerate(offsets):
        columns = regressor.matrix(*fourier_motion(7, period_s=10.0, samples=400, seed=number))
        torque = offset + 0.02 * generator.normal(size=columns.shape[:2])
        signals = SimpleNamespace(row_time=np.arange(400) * 0.025)
        fitted = np.ones(torque.shape, dtype=bool)
        blocks.append(SimpleNamespace(columns=columns, torque=torque, fitted=fitted, signals=signals, recording=number))
    assert choose_drive_parameters(blocks, regressor, rotor_inertia=False, offset=None).offset is wanted
