"""The robot's counter as a clock: nothing that a robot can have sent is refused, nothing that it cannot is admitted.

The truth is a robot written out here. It sends message n at its own time n periods, later for good once it paused, and
the network and the host delay each message, never below nothing and never past the one after it.
"""

from __future__ import annotations

import random
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fri_client.messages import MONITORING_IDENTIFIER, MessageHeader, MonitorData, MonitoringMessage, TimeStamp
from fri_client.session.robot_clock import RobotClock

MS = 1_000_000
START = 7_000 * MS
LONG = 2_000
"""Messages: more than any window over which the clock can look."""

periods = st.sampled_from([1, 2, 5, 10])
arrivals = st.lists(
    st.tuples(
        st.integers(1, 40),  # counters since the last message that got through
        st.sampled_from([0.0, 0.0, 0.0, 0.4, 3.0]),  # periods for which the robot paused before
        st.floats(0.0, 5.0),  # periods of delay
    ),
    max_size=200,
)


def sent_and_received(
    steps_pauses_delays: list[tuple[int, float, float]], period_ms: int
) -> Iterator[tuple[int, int, int]]:
    """Of every message: counters since the one before, when the robot sent it, when it was received, ns."""
    sent = received = START
    for steps, pause, delay in steps_pauses_delays:
        sent += round((steps + pause) * period_ms * MS)
        received = max(received, sent + round(delay * period_ms * MS))
        yield steps, sent, received


def followed(messages: Iterator[tuple[int, int, int]], period_ms: int) -> tuple[RobotClock, int]:
    """A clock that has seen the robot's first messages without delay, up to START, and these after it; when the last
    was sent.
    """
    clock = RobotClock()
    for n in range(-50, 1):
        clock.note(1, START + n * period_ms * MS, period_ms)
    last = START
    for steps, sent, received in messages:
        assert clock.admits(steps, received)
        clock.note(steps, received, period_ms)
        last = sent
    return clock, last


@given(arrivals, periods)
def test_a_message_that_is_late_is_admitted_however_late_and_whatever_was_lost_before_it(
    told: list[tuple[int, float, float]], period_ms: int
) -> None:
    followed(sent_and_received(told, period_ms), period_ms)  # asserts at each message


@given(
    st.lists(st.tuples(st.integers(1, 40), st.just(0.0), st.floats(0.0, 5.0)), max_size=200),
    periods,
    st.integers(1, 1000),
    st.floats(0.0, 0.7),
)
def test_a_counter_ahead_of_the_robots_time_is_not_admitted_and_is_once_its_time_has_come(
    told: list[tuple[int, float, float]], period_ms: int, ahead: int, early: float
) -> None:
    clock, last = followed(sent_and_received(told, period_ms), period_ms)
    due = last + ahead * period_ms * MS
    assert not clock.admits(ahead, due - round((1.0 - early) * period_ms * MS))
    assert clock.admits(ahead, due)


@given(st.integers(1, 1000), st.floats(0.3, 1.0))
def test_what_was_not_believed_leaves_no_trace(ahead: int, share: float) -> None:
    clock, last = followed(iter(()), 1)
    for _ in range(3):
        assert not clock.admits(ahead + 1, last + round((ahead + share) * MS) - MS)
    assert clock.admits(1, last + MS)


@pytest.mark.parametrize("drift", [1e-4, -1e-4])
def test_clocks_that_drift_apart_by_100_ppm_lose_no_message_and_let_none_through_ahead_of_time(drift: float) -> None:
    generator = random.Random(1)
    clock, last = RobotClock(), START
    clock.note(0, START, 1)
    for n in range(1, LONG * 10):
        last = START + round(n * MS * (1.0 + drift))
        received = last + round(generator.uniform(0.0, 0.6) * MS)
        assert clock.admits(1, received)
        clock.note(1, received, 1)
    assert not clock.admits(2, last + MS)
    assert clock.admits(1, last + MS)


def test_a_robot_that_paused_is_late_for_good_and_soon_known_to_be() -> None:
    clock, last = followed(sent_and_received([(1, 0.0, 0.0)] * 50 + [(1, 8.0, 0.0)] + [(1, 0.0, 0.0)] * LONG, 1), 1)
    assert not clock.admits(2, last + MS)
    assert clock.admits(1, last + MS)


def test_after_a_reset_and_at_another_period_the_next_message_is_taken_as_it_comes() -> None:
    clock, last = followed(sent_and_received([(1, 0.0, 0.0)] * 20, 1), 1)
    clock.reset()
    assert clock.admits(1000, last)
    for n in range(50):
        clock.note(1, last + n * MS, 1)
    last += 49 * MS
    assert not clock.admits(2, last + MS)
    for n in range(50):
        clock.note(1, last + n * 5 * MS, 5)  # from here on a message means 5 ms
    last += 49 * 5 * MS
    assert not clock.admits(2, last + 5 * MS)
    assert clock.admits(2, last + 10 * MS)


@given(periods, st.integers(1, 18), st.floats(0.0, 1.0))
def test_messages_that_waited_at_the_start_are_taken_and_what_comes_after_them_in_time(
    period_ms: int, waiting: int, share: float
) -> None:
    """They are read at once, so the second looked as if it came ahead of its time, and so did all after it."""
    clock = RobotClock()
    read = START + round((waiting - 1 + share) * period_ms * MS)
    for _ in range(waiting):
        assert clock.admits(1, read)
        clock.note(1, read, period_ms)
    for n in range(waiting, waiting + 200):
        assert clock.admits(1, max(read, START + n * period_ms * MS))
        clock.note(1, max(read, START + n * period_ms * MS), period_ms)
    last = START + (waiting + 199) * period_ms * MS
    assert not clock.admits(2, last + period_ms * MS)


@given(periods, st.integers(1, 20), st.lists(st.integers(-40_000, 60_000), min_size=5, max_size=20))
def test_after_a_pause_of_whole_periods_each_message_has_a_cycle_of_its_own(
    period_ms: int, paused: int, jitter_ns: list[int]
) -> None:
    """The robot's process was held up and its counter did not go on: messages that came some 10 µs before their time
    looked nearly a period late, and every second command was held back until the robot left.
    """
    clock = in_step(period_ms)
    assert clock.due_ns is not None
    begin = clock.due_ns
    cycles = []
    for n, early in enumerate(jitter_ns, 1):
        time_ns = begin + (n + paused) * period_ms * MS + early
        clock.note(1, time_ns, period_ms)
        moment = clock.moment(0, time_ns, n)
        assert moment.is_late
        cycles.append(moment.cycle_ns)
    assert np.all(np.diff(cycles) == period_ms * MS)


def in_step(period_ms: int) -> RobotClock:
    """A clock that has seen fifty messages in time."""
    clock = RobotClock()
    for n in range(50):
        clock.note(min(n, 1), START + n * period_ms * MS, period_ms)
    return clock


def stamped(nanoseconds: int | None) -> MonitoringMessage:
    stamp = None if nanoseconds is None else TimeStamp(*divmod(nanoseconds, 10**9))
    return MonitoringMessage(MessageHeader(MONITORING_IDENTIFIER, 1, 0), monitor_data=MonitorData(timestamp=stamp))


@given(st.integers(0, 2**32 * 10**9 - 1), st.integers(0, 2**62))
def test_only_simulated_time_is_read_from_the_time_stamp(stamp: int, receive_ns: int) -> None:
    clock = RobotClock()
    assert clock.time_of(stamped(stamp), receive_ns) == receive_ns
    clock.simulated = True
    assert clock.time_of(stamped(stamp), receive_ns) == stamp
    for without in (stamped(None), MonitoringMessage(MessageHeader(MONITORING_IDENTIFIER, 1, 0))):
        assert clock.time_of(without, receive_ns) == receive_ns
