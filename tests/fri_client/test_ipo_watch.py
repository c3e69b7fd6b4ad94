"""When a set-point stands still: closed forms of a motion that the robot reports."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fri_client.loop.ipo_watch import IpoWatch
from fri_client.messages import FriVersion
from tests.fri_client.one_side import REST, moved
from tests.fri_client.two_loops import ACTIVE, COMMANDING_WAIT, PERIOD_NS, Bench


@given(
    st.integers(1, 7), st.floats(0.05, 1.0), st.sampled_from([1, 2, 5, 10]), st.lists(st.integers(1, 40), max_size=9),
    st.sampled_from([0, 17, 2**32 - 5]),
)  # fmt: skip
def test_a_moving_set_point_is_never_still_and_its_speed_is_the_robots(
    joint: int, speed: float, period_ms: int, unseen: list[int], counter: int
) -> None:
    """Of messages that were lost, or came together with a newer one, only the newest is seen."""
    watch = IpoWatch()
    position = REST
    for steps in (1, 1, *unseen, 1):
        position = moved(position, joint, speed * steps * period_ms * 1e-3)
        counter = (counter + steps) % 2**32
        watch.observe(position, counter, period_ms * 1e-3)
        assert not watch.is_still
    assert (watch.moving_joint, watch.speed_rad_s) == (joint, pytest.approx(speed))


def test_a_set_point_that_came_to_rest_is_still_after_some_messages_and_moves_again_at_once() -> None:
    watch = IpoWatch()
    for k in range(20):
        watch.observe(moved(REST, 2, min(k, 10) * 1e-4), k, 1e-3)
        assert watch.is_still == (k >= 15)
    assert watch.clause() == ""
    watch.observe(moved(REST, 2, 11e-4), 20, 1e-3)
    assert not watch.is_still
    watch.reset()
    assert not watch.is_still


@pytest.mark.parametrize("together", [1, 2, 8, 30])
def test_messages_that_come_together_do_not_make_the_set_point_faster(together: int) -> None:
    """Eight of them, of which the loop sees the newest: the sentence said eight times the speed."""
    bench, speed = Bench(FriVersion.V1_15), 0.3

    def message() -> bytes:
        return bench.next_datagram(ipo=moved(REST, 3, speed * 1e-3 * bench.counter))

    for state, count in ((COMMANDING_WAIT, 60), (ACTIVE, 60)):
        bench.state = state
        for _ in range(count):
            bench.deliver(message())
    bench.clock.now += (together - 1) * PERIOD_NS
    bench.deliver(*(message() for _ in range(together)))
    assert f"joint 3 moves at {speed:g} rad/s" in bench.ahead._pilot.hindrance
    bench.close()
