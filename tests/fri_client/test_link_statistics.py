"""Turn-around, jitter and late answers against sorted lists and closed forms."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fri_client.loop.link_statistics import Histogram, LinkStatistics

MS = 1_000_000


def test_the_counter_wraps_and_a_new_session_may_start_anywhere() -> None:
    statistics = LinkStatistics()
    for number in range(2**32 - 100, 2**32 + 100):
        statistics.observe(number % 2**32, number * MS, 0, 1)
    statistics.restart()
    statistics.observe(5, 7 * MS, 0, 1)
    statistics.observe(6, 8 * MS, 0, 1)
    assert (statistics.jitter.count, statistics.jitter.maximum_ns) == (200, 0)


def test_an_answer_is_late_when_it_takes_longer_than_the_send_period() -> None:
    statistics = LinkStatistics()
    for number, turn_around in enumerate([MS, MS + 1, 5 * MS, 0]):
        statistics.observe(number, 1, 1 + turn_around, 1)
    statistics.observe(4, 1, 0, 1)
    statistics.observe(5, 1, 10**9, None)
    assert statistics.late == 2
    assert statistics.turn_around.count == 5


def test_jitter_is_measured_against_the_distance_in_send_periods() -> None:
    statistics = LinkStatistics()
    # Numbers 0, 1, 4 (two lost), 5 at a period of 2 ms: off by 0, +300 µs and -300 µs.
    for number, receive_ns in ((0, 0), (1, 2 * MS), (4, 8 * MS + 300_000), (5, 10 * MS)):
        statistics.observe(number, receive_ns, 0, 2)
    assert statistics.jitter.count == 3
    assert statistics.jitter.maximum_ns == 300_000


def test_bins_are_contiguous_and_at_most_a_sixteenth_wide() -> None:
    edges = [Histogram.lower_edge_ns(index) for index in range(Histogram.BINS + 1)]
    assert edges[0] == 0
    assert edges[-1] == 2**36
    widths = np.diff(edges)
    assert (widths >= 1).all()
    assert all(width <= max(1, lower / 16) for lower, width in zip(edges, widths, strict=False))


@settings(deadline=None)
@given(st.lists(st.integers(0, 2**36 - 1) | st.integers(0, 100_000), min_size=1, max_size=200))
def test_a_quantile_is_the_sorted_one_rounded_up_to_its_bin(durations: list[int]) -> None:
    histogram = Histogram()
    for duration in durations:
        histogram.add(duration)
    summary = histogram.summary()
    for name, fraction in (("p50_us", 0.5), ("p99_us", 0.99), ("p999_us", 0.999)):
        exact = sorted(durations)[math.ceil(fraction * len(durations)) - 1] / 1000
        assert exact <= summary[name] <= max(exact * (1 + 1 / 16), exact + 0.001)
    assert summary["max_us"] == max(durations) / 1000
    assert sum(summary["counts"]) == len(durations)
    assert len(summary["edges_us"]) == len(summary["counts"])
    counted, edges = list(summary["counts"]), [*summary["edges_us"], math.inf]
    for duration in durations:
        # Every duration lies in a bin that counted one.
        assert any(
            lower <= duration / 1000 < upper and count
            for lower, upper, count in zip(edges, edges[1:], counted, strict=False)
        )


@pytest.mark.parametrize("duration", [-1, -(10**12), 2**36, 10**15])
def test_durations_beyond_the_bins_are_counted_in_the_outermost(duration: int) -> None:
    histogram = Histogram()
    histogram.add(5)
    histogram.add(duration)
    histogram.add(duration)
    assert histogram.count == 3
    assert sum(histogram.summary()["counts"]) == 3
    assert histogram.maximum_ns == max(duration, 5)


def test_messages_are_counted_by_the_session_alone() -> None:
    """It judged each one; a second count of what is missing knew nothing of messages that came and were refused."""
    assert set(LinkStatistics().summary()) == {"turn_around", "jitter"}


def test_a_summary_of_nothing_is_json() -> None:
    assert json.loads(json.dumps(LinkStatistics().summary(), allow_nan=False))["turn_around"]["p50_us"] is None


def test_counting_does_not_grow() -> None:
    statistics = LinkStatistics()
    size = len(statistics.turn_around._counts), len(statistics.jitter._counts)
    random = np.random.default_rng(7)
    for number in random.integers(0, 2**32, 3000).tolist():
        statistics.observe(number, number, number * 3, 1)
    assert (len(statistics.turn_around._counts), len(statistics.jitter._counts)) == size
    statistics.observe_undecodable()
    assert statistics.undecodable == 1
