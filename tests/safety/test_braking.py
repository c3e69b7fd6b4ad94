"""The closed form of the firmest stop against a numerical integration that knows only jerk and acceleration limits."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from safety.braking import stopping_travel

ACCELERATION, JERK = 10.0, 100.0


def _integrated_travel(velocity: float, acceleration: float) -> float:
    """Largest displacement of a bang-bang jerk law in small steps: the switching curve decides each step."""
    step = 2e-5
    v, a, q, highest = velocity, acceleration, 0.0, 0.0
    for _ in range(60_000):
        # The velocity that would remain if the acceleration were driven to 0 from here; brake against it.
        remaining = v + a * abs(a) / (2 * JERK)
        if abs(remaining) < JERK * step**2 * 4 and abs(a) < JERK * step * 2:
            break
        jerk = -np.sign(remaining) * JERK
        a_next = min(max(a + jerk * step, -ACCELERATION), ACCELERATION)
        q += v * step + a * step**2 / 2
        v += (a + a_next) / 2 * step
        a = a_next
        highest = max(highest, q)
    return highest


@settings(max_examples=25, deadline=None)
@given(velocity=st.floats(-2.0, 2.0), acceleration=st.floats(-ACCELERATION, ACCELERATION))
def test_travel_equals_a_numerical_integration(velocity: float, acceleration: float) -> None:
    assert stopping_travel(velocity, acceleration, ACCELERATION, JERK) == pytest.approx(
        _integrated_travel(velocity, acceleration), abs=3e-4
    )


def test_travel_from_constant_velocity_is_the_textbook_trapezoid() -> None:
    assert stopping_travel(1.5, 0.0, ACCELERATION, JERK) == pytest.approx(1.5**2 / 20 + 1.5 * 10 / 200, rel=1e-12)


def test_a_joint_at_rest_travels_nowhere() -> None:
    assert stopping_travel(0.0, 0.0, ACCELERATION, JERK) == 0.0


@given(velocity=st.floats(0.0, 2.0), acceleration=st.floats(-ACCELERATION, ACCELERATION))
def test_stronger_brakes_never_lengthen_the_way(velocity: float, acceleration: float) -> None:
    firm = stopping_travel(velocity, acceleration, ACCELERATION, JERK)
    assert stopping_travel(velocity, acceleration, 2 * ACCELERATION, JERK) <= firm + 1e-12
