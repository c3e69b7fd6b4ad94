"""How punctual the link was: jitter, turn-around and late answers, measured while the loop runs.

Here: two histograms of fixed size; a tick costs a few integer operations and keeps no object. Not here: which messages
came, which are missing and which came twice (`session`, which judges each by its counter), and the grade an operator
sees (`doctor`). The loop calls `observe` once per message that is newer than all before it; whoever reports calls
`summary`.
"""

from __future__ import annotations

from array import array
from typing import Any

from fri_client.session.robot_counter import WRAP


class Histogram:
    """Durations in logarithmic bins: 16 per octave, so a bin is at most 1/16 of its lower edge wide, up to 68 s.

    Durations are added in nanoseconds and reported in microseconds; negative ones count as 0, longer ones fall into
    the last bin. The number of bins never changes.
    """

    BINS = 31 * 16 + 32
    _LONGEST = (1 << 36) - 1

    def __init__(self) -> None:
        self._counts = array("Q", bytes(8 * self.BINS))
        self.count = 0
        self.maximum_ns = 0

    def add(self, duration_ns: int) -> None:
        """Count one duration."""
        self.count += 1
        if duration_ns > self.maximum_ns:
            self.maximum_ns = duration_ns
            if duration_ns > self._LONGEST:
                duration_ns = self._LONGEST
        elif duration_ns < 0:
            duration_ns = 0
        elif duration_ns > self._LONGEST:
            duration_ns = self._LONGEST
        shift = duration_ns.bit_length() - 5
        if shift > 0:
            self._counts[(shift << 4) + (duration_ns >> shift)] += 1
        else:
            self._counts[duration_ns] += 1

    @staticmethod
    def lower_edge_ns(bin_index: int) -> int:
        """Smallest duration that falls into a bin."""
        if bin_index < 32:
            return bin_index
        shift = (bin_index >> 4) - 1
        return (bin_index - (shift << 4)) << shift

    def quantile_us(self, fraction: float) -> float | None:
        """Duration that `fraction` of the counted ones do not exceed, rounded up to its bin; None without any."""
        if not self.count:
            return None
        wanted = fraction * self.count
        reached = 0
        for index, count in enumerate(self._counts):
            reached += count
            if count and reached >= wanted:
                upper = self.lower_edge_ns(index + 1) - 1
                return min(upper, self.maximum_ns) / 1000 if index + 1 < self.BINS else self.maximum_ns / 1000
        return self.maximum_ns / 1000

    def summary(self) -> dict[str, Any]:
        """count, p50_us, p99_us, p999_us, max_us; edges_us (lower edges) and counts of the occupied range of bins."""
        occupied = [index for index, count in enumerate(self._counts) if count]
        span = range(occupied[0], occupied[-1] + 1) if occupied else range(0)
        return {
            "count": self.count,
            "p50_us": self.quantile_us(0.5),
            "p99_us": self.quantile_us(0.99),
            "p999_us": self.quantile_us(0.999),
            "max_us": self.maximum_ns / 1000 if self.count else None,
            "edges_us": [self.lower_edge_ns(index) / 1000 for index in span],
            "counts": [self._counts[index] for index in span],
        }


class LinkStatistics:
    """Of one run of the link.

    late: answered, but more than one send period after they were received. undecodable: datagrams refused.
    turn_around: from receive to send. jitter: |interval between two messages - their distance in send periods|.
    """

    def __init__(self) -> None:
        self.late = 0
        self.undecodable = 0
        self.turn_around = Histogram()
        self.jitter = Histogram()
        self._spaces = self._spaced_ns = 0
        self.restart()

    @property
    def spacing_ms(self) -> float | None:
        """Mean time from one of the robot's messages to the next, by its counter; None before there are two."""
        return 1e-6 * self._spaced_ns / self._spaces if self._spaces else None

    def restart(self) -> None:
        """Forget the counter of the robot (a new session may start anywhere); what was measured stays."""
        self._newest: int | None = None
        self._newest_receive_ns = 0

    def observe_undecodable(self) -> None:
        """Count a datagram that was refused."""
        self.undecodable += 1

    def observe(self, sequence_counter: int, receive_ns: int, send_ns: int, period_ms: float | None) -> None:
        """Measure one message, newer than those before, and its answer.

        sequence_counter: the robot's, uint32. receive_ns, send_ns: one monotonic clock; send_ns is 0 where nothing was
        sent. period_ms: the send period, None or 0 where the robot does not say; then neither lateness nor jitter is
        judged.
        """
        period_ns = int(period_ms * 1_000_000) if period_ms else 0
        if send_ns:
            turn_around_ns = send_ns - receive_ns
            self.turn_around.add(turn_around_ns)
            if 0 < period_ns < turn_around_ns:
                self.late += 1
        if self._newest is not None and period_ns:
            ahead = (sequence_counter - self._newest) & WRAP
            self.jitter.add(abs(receive_ns - self._newest_receive_ns - ahead * period_ns))
            self._spaces += ahead
            self._spaced_ns += receive_ns - self._newest_receive_ns
        self._newest, self._newest_receive_ns = sequence_counter, receive_ns

    def summary(self) -> dict[str, Any]:
        """Both histograms, as plain numbers, lists and dicts that JSON can hold."""
        return {"turn_around": self.turn_around.summary(), "jitter": self.jitter.summary()}
