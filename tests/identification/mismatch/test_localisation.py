"""Claims about the curves of findings: a wave is drawn over its phase, where it does not alias. Truth: a sine."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from identification.mismatch.effects.base import Place
from identification.mismatch.effects.cable_spring import CableSpring
from identification.mismatch.effects.torque_ripple import TorqueRipple
from identification.mismatch.names.localisation import best_curve, where_of

ORDER, AMPLITUDE = 160.0, 0.5


@pytest.fixture(scope="module")
def evidence() -> Any:
    """A joint that swings by 1 rad: 51 waves of a ripple of order 160 over 40 bins of position."""
    time = np.arange(4000) * 0.0025
    position = np.sin(2.0 * np.pi * 0.1 * time)[:, None]
    velocity = np.gradient(position, time, axis=0)
    motion = SimpleNamespace(
        time=time, position=position, velocity=velocity, torque=10.0 * position, sampling_period_s=0.0025
    )
    return SimpleNamespace(motion=motion, frequency=np.array([0.0, 40.0]))


def test_a_ripple_is_a_sine_over_its_phase(evidence: Any) -> None:
    phase = TorqueRipple().phase(evidence.motion, Place(joint=1), {"order": ORDER, "load_share": 0.0})
    assert phase == pytest.approx(ORDER * evidence.motion.position[:, 0])
    torque = AMPLITUDE * np.sin(phase + 0.3)
    _, share = best_curve(evidence, 0, torque, 0.0 * torque, 0.01, torque)
    assert share < 0.5  # bins of any state hold more than a wave each
    curve, share = best_curve(evidence, 0, torque, 0.0 * torque, 0.01, torque, phase=phase)
    assert (curve.coordinate, curve.unit) == ("phase", "rad")
    assert curve.centre.min() >= -np.pi
    assert curve.centre.max() <= np.pi
    assert curve.before == pytest.approx(AMPLITUDE * np.sin(curve.centre + 0.3), abs=0.02 * AMPLITUDE)
    assert share > 0.99
    power = SimpleNamespace(probability=np.ones((1, 1)))
    state = where_of(evidence, cast(Any, power), 0, torque, curve, share)["state"]
    assert (state["from"], state["to"]) == (None, None)


def test_what_does_not_repeat_has_no_phase(evidence: Any) -> None:
    assert CableSpring().phase(evidence.motion, Place(joint=1), {}) is None
