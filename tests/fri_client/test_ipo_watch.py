"""When a set-point stands still: closed forms of a motion that the robot reports."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fri_client.loop.ipo_watch import IpoWatch
from tests.fri_client.one_side import REST, moved


@given(st.integers(1, 7), st.floats(0.05, 1.0), st.sampled_from([1, 2, 5, 10]), st.lists(st.integers(1, 4), max_size=9))
def test_a_moving_set_point_is_never_still_and_its_speed_is_the_robots(
    joint: int, speed: float, period_ms: int, lost: list[int]
) -> None:
    watch = IpoWatch()
    position = REST
    for steps in (1, 1, *lost, 1):
        position = moved(position, joint, speed * steps * period_ms * 1e-3)
        watch.observe(position, steps * period_ms * 1e-3)
        assert not watch.is_still
    assert (watch.moving_joint, watch.speed_rad_s) == (joint, pytest.approx(speed))


def test_a_set_point_that_came_to_rest_is_still_after_some_messages_and_moves_again_at_once() -> None:
    watch = IpoWatch()
    for k in range(20):
        watch.observe(moved(REST, 2, min(k, 10) * 1e-4), 1e-3)
        assert watch.is_still == (k >= 15)
    assert watch.clause() == ""
    watch.observe(moved(REST, 2, 11e-4), 1e-3)
    assert not watch.is_still
    watch.reset()
    assert not watch.is_still
