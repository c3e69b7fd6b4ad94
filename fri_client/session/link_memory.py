"""What the link did in the last second, for the sentence that explains a drop: misses, turn-arounds, quality.

Preallocated: noting a tick writes three numbers. The journal notes each tick and asks once, when the session is lost;
counts over the whole run are `link_statistics`.
"""

from __future__ import annotations

from array import array
from collections import deque
from dataclasses import dataclass
from itertools import pairwise

from fri_client.messages import ConnectionQuality, name_of

_TICKS = 2048
"""More than a second's messages at 1 kHz, duplicates and garbage included."""

_WINDOW_NS = 1_000_000_000
_QUALITIES = 8


@dataclass(frozen=True, slots=True)
class RecentLink:
    """The link before an end. missing, answered, turn_around_ms (longest, None without an answer), pause_ms (longest
    between two messages; 0: none that is worth a word), held_back (answers that were not let out): of the last second.

    qualities: the last changes as (seconds before the end, quality before, quality after), oldest first.
    """

    missing: int
    answered: int
    turn_around_ms: float | None
    qualities: tuple[tuple[float, int, int], ...] = ()
    pause_ms: float = 0.0
    held_back: int = 0

    def clause(self) -> str:
        """The numbers as part of a sentence."""
        history = ""
        for ago, before, after in self.qualities:
            history += f", {_quality(before)} -> " if not history else " -> "
            history += f"{_quality(after)} {ago:.2f} s before"
        longest = "no answer" if self.turn_around_ms is None else f"longest turn-around {self.turn_around_ms:.2f} ms"
        if self.pause_ms:
            longest += f", longest pause between messages {self.pause_ms:.0f} ms"
        quality = f"; quality {history.removeprefix(', ')}" if history else "; quality unchanged in the motion"
        held_back = f", {self.held_back} answer{'s' * (self.held_back != 1)} held back" if self.held_back else ""
        missing = f"{self.missing} message{'s' * (self.missing != 1)} missing"
        return f"in the last second {missing}{held_back} and {longest}{quality}"


class LinkMemory:
    """Remembers the last _TICKS ticks and the last changes of the quality; nothing grows."""

    def __init__(self) -> None:
        self._time_ns = array("q", bytes(8 * _TICKS))
        self._turn_around_ns = array("q", [-1]) * _TICKS  # -1: not answered
        self._missing = array("q", bytes(8 * _TICKS))
        self._held_back = array("q", bytes(8 * _TICKS))
        self._next = 0
        self._qualities: deque[tuple[int, int, int]] = deque(maxlen=_QUALITIES)

    def tick(self, receive_ns: int, send_ns: int, missing: int, *, held_back: int = 0) -> None:
        """Note one message: received, answered (send_ns 0: not), messages missing before it, answers held back."""
        place = self._next
        self._next = (place + 1) % _TICKS
        self._time_ns[place] = receive_ns
        self._turn_around_ns[place] = send_ns - receive_ns if send_ns else -1
        self._missing[place] = missing
        self._held_back[place] = held_back

    def quality(self, receive_ns: int, before: int, after: int) -> None:
        """Note a change of the connection quality."""
        self._qualities.append((receive_ns, before, after))

    def forget_qualities(self) -> None:
        """A motion begins: what the quality did before explains none of its ends."""
        self._qualities.clear()

    def recall(self, now_ns: int) -> RecentLink:
        """What is remembered of the second before now_ns (CLOCK_MONOTONIC)."""
        since = now_ns - _WINDOW_NS
        recent = [place for place, time_ns in enumerate(self._time_ns) if time_ns > since]
        # In their order; the end of the ring is older than its beginning.
        times = [time_ns for time_ns in (*self._time_ns[self._next :], *self._time_ns[: self._next], now_ns) if time_ns]
        pauses = [here - before for before, here in pairwise(times) if here > since]
        turn_arounds = [t for t in (self._turn_around_ns[place] for place in recent) if t >= 0]
        return RecentLink(
            sum(self._missing[place] for place in recent),
            len(turn_arounds),
            max(turn_arounds) / 1e6 if turn_arounds else None,
            tuple(((now_ns - time_ns) / 1e9, before, after) for time_ns, before, after in self._qualities),
            max(pauses, default=0) / 1e6,
            sum(self._held_back[place] for place in recent),
        )


def _quality(value: int) -> str:
    return name_of(ConnectionQuality, value)
