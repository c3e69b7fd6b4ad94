"""Claims about a motion that hardly determines the arm: 0.74 s led by hand. Truth: Table 3 by Pinocchio's dynamics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from identification.fitting.nominal_model import choose_nominal_model, estimate_nominal, process_all
from identification.recording_fit import FitSettings
from identification.robots import load_robot
from tests.identification.synthetic import inverse_dynamics, recording_of, table_three


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_every_standard_deviation_of_a_very_short_recording_is_a_number(seed: int) -> None:
    """Variances came out below zero in rounding: no σ, no model, and an internal error on what an operator recorded."""
    time = np.arange(739) * 0.001
    rate = 2.0 * np.pi / np.array([4.1, 4.7, 3.7, 3.1, 2.9, 2.3, 1.9])
    phase = np.outer(time, rate)
    start = np.array([0.1, 0.4, -0.1, -1.2, 0.1, 0.9, 0.1])
    position = start + 0.1 * (1.0 - np.cos(phase))
    robot = load_robot("iiwa14")
    torque = inverse_dynamics(robot, table_three(), position, 0.1 * rate * np.sin(phase), 0.1 * rate**2 * np.cos(phase))
    torque += 0.1 * np.random.default_rng(seed).standard_normal(torque.shape)
    recording = replace(
        recording_of(position, torque, period_s=0.739), period_index=None, sample_in_period=None, period_s=None
    )
    settings = FitSettings(physical=False, offset="no")
    processed, band = process_all([recording], robot, settings, lambda *_: None)
    settings = replace(settings, low_pass_hz=band.low_pass_hz if band is not None else None)
    estimate = estimate_nominal(choose_nominal_model(processed, robot, settings), processed, settings)[1].least_squares
    assert np.isfinite(estimate.std).all()
    assert (estimate.std > 0.0).all()
