"""Joint limits: the published values, contradictions refused with both numbers."""

from __future__ import annotations

import numpy as np
import pytest

from safety.errors import LimitsError
from safety.limits import IIWA7_R800, IIWA14_R820, JointLimits, limits_for


def _limits(**changes: object) -> JointLimits:
    values: dict[str, object] = {
        "position_lower": [-1.0, -1.0],
        "position_upper": [1.0, 1.0],
        "velocity": [1.0, 1.0],
        "acceleration": [5.0, 5.0],
        "jerk": [50.0, 50.0],
        "torque": [100.0, 100.0],
    }
    return JointLimits(**{**values, **changes})  # type: ignore[arg-type]


def test_iiwa14_has_the_published_positions_velocities_and_torques() -> None:
    # Numbers in radians as printed in the protocol sheet's table of joint limits, not converted by the code under test.
    assert IIWA14_R820.position_upper == pytest.approx(
        [2.9671, 2.0944, 2.9671, 2.0944, 2.9671, 2.0944, 3.0543], abs=5e-5
    )
    assert IIWA14_R820.position_lower == pytest.approx(-IIWA14_R820.position_upper)
    assert IIWA14_R820.velocity == pytest.approx([1.4835, 1.4835, 1.7453, 1.3090, 2.2689, 2.3562, 2.3562], abs=5e-5)
    assert IIWA14_R820.torque.tolist() == [320, 320, 176, 176, 110, 40, 40]


def test_iiwa7_is_faster_and_weaker_than_iiwa14() -> None:
    assert IIWA7_R800.velocity == pytest.approx([1.7104, 1.7104, 1.7453, 2.2689, 2.4435, 3.1416, 3.1416], abs=5e-5)
    assert IIWA7_R800.torque.tolist() == [176, 176, 110, 110, 110, 40, 40]
    assert np.all(IIWA7_R800.velocity >= IIWA14_R820.velocity)


@pytest.mark.parametrize("limits", [IIWA14_R820, IIWA7_R800])
def test_a_sine_of_half_a_hertz_may_use_the_whole_velocity_limit(limits: JointLimits) -> None:
    omega = 2 * np.pi * 0.5
    assert np.all(omega * limits.velocity <= limits.acceleration)
    assert np.all(omega**2 * limits.velocity <= limits.jerk)


def test_limits_cannot_be_changed_in_place() -> None:
    with pytest.raises(ValueError, match="read-only"):
        IIWA14_R820.velocity[0] = 9.0


def test_limits_do_not_follow_the_array_they_were_made_from() -> None:
    velocity = np.array([1.0, 1.0])
    limits = _limits(velocity=velocity)
    velocity[0] = 7.0
    assert limits.velocity[0] == 1.0


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"position_lower": [0.0, 2.0]}, r"Joint 2 has the lower position limit 2 rad.*1 rad"),
        ({"velocity": [1.0, 0.0]}, r"velocity of joint 2 is 0"),
        ({"jerk": [np.inf, 1.0]}, r"jerk of joint 1 is inf"),
        ({"torque": [1.0]}, r"torque has shape \(1,\)"),
    ],
)
def test_contradictions_are_refused(changes: dict[str, object], words: str) -> None:
    with pytest.raises(LimitsError, match=words):
        _limits(**changes)


def test_an_unknown_robot_is_refused_with_the_known_names() -> None:
    with pytest.raises(LimitsError, match=r"'iiwa9'.*iiwa14, iiwa7"):
        limits_for("iiwa9")
