"""Which sequences of moves are played: drawn by a seed for a campaign, by hypothesis for the tests."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

from fri_client.messages import FriVersion
from tests.fri_client.adversary.world import Move, Setting

__all__ = ["KINDS", "drawn", "sequences"]

_PERIODS = ((1, 1), (1, 1), (1, 1), (2, 1), (5, 1), (10, 1), (1, 2), (2, 2), (5, 2))
_WHERE = ("receive", "waiting", "clock")

# kind: most messages it lasts for, lowest and highest value, whether the value is a whole number
KINDS: dict[str, tuple[int, float, float, bool]] = {
    "lose": (30, 0.0, 0.0, False),
    "lose_answer": (9, 0.0, 0.0, False),
    "duplicate": (20, 0.0, 0.0, False),
    "late": (5, 0.0, 6.0, False),
    "swap": (2, 0.0, 0.0, False),
    "stall": (1, 0.1, 60.0, False),
    "refuse": (20, 0.0, 0.0, False),
    "stray": (40, 0.0, 1.0, False),
    "state": (4, 0.0, 9.0, True),
    "counter": (12, -5000.0, 5000.0, True),
    "counter_for_good": (1, -100000.0, 100000.0, True),
    "jitter": (200, 0.2, 2.5, False),
    "stamp": (5, -2000.0, 2000.0, False),
    "forged": (10, 0.02, 0.98, False),
    "stale": (1, 0.1, 40.0, False),
    "period": (3, 0.0, 20.0, True),
    "ipo": (3, -0.5, 0.5, False),
    "quality": (5, 0.0, 3.0, True),
    "safety": (3, 0.0, 0.0, False),
    "leave": (1, 0.0, 0.0, False),
    "stop": (1, 0.0, 0.0, False),
}


def _move(kind: str, at: int, count: int, share: float, where: int) -> Move:
    most, low, high, whole = KINDS[kind]
    value = low + share * (high - low)
    place = ("stranger", "robot")[where % 2] if kind == "stray" else _WHERE[where % 3]
    return Move(kind, at, 1 + count % most, round(value) if whole else value, place)


def _setting(index: int, version: int, speed: float, starts_active: bool, duration_ms: int) -> Setting:
    period, multiplier = _PERIODS[index % len(_PERIODS)]
    return Setting(
        period,
        multiplier,
        (FriVersion.V1_15, FriVersion.V2_5, FriVersion.V2_7)[version % 3],
        ipo_speed=speed,
        starts_active=starts_active,
        duration_ms=duration_ms,
    )


def drawn(seed: int) -> tuple[Setting, tuple[Move, ...]]:
    """The sequence of that seed."""
    random = np.random.default_rng(seed)
    speed = float(random.uniform(0.05, 1.0)) if random.random() < 0.05 else 0.0
    index = int(random.integers(len(_PERIODS)))
    setting = _setting(
        index, int(random.integers(3)), speed, bool(random.random() < 0.1), int(random.integers(700, 1500))
    )
    messages = setting.duration_ms // setting.send_period_ms
    moves = tuple(
        _move(
            str(random.choice(list(KINDS))),
            int(random.integers(0, messages)),
            int(random.integers(0, 40)),
            float(random.random()),
            int(random.integers(6)),
        )
        for _ in range(int(random.integers(1, 7)))
    )
    return setting, moves


_moves = st.builds(
    _move,
    st.sampled_from(sorted(KINDS)),
    st.integers(0, 1100),
    st.integers(0, 40),
    st.floats(0.0, 1.0),
    st.integers(0, 5),
)

sequences = st.tuples(
    st.builds(
        _setting,
        st.integers(0, len(_PERIODS) - 1),
        st.integers(0, 2),
        st.sampled_from([0.0] * 12 + [0.05, 0.3, 1.0]),
        st.sampled_from([False] * 9 + [True]),
        st.integers(500, 1100),
    ),
    st.lists(_moves, min_size=1, max_size=6).map(tuple),
)
