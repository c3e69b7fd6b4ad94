"""The answer made ready beforehand is the answer of the plain way, byte for byte, whatever comes in.

Two loops hear the same datagrams over simulated channels under one clock that only the test moves. One of them has
nothing prepared, ever: decode, session, guard, encode. It is the oracle. What was sent is moreover held against the
datagrams themselves: counters, seven finite positions, nothing for what is old, foreign or damaged.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)
from msgspec.structs import replace

from fri_client.handover.motion_phase import MotionPhase
from fri_client.handover.ring import EventCode
from fri_client.messages import (
    FriVersion,
)
from tests.fri_client.simulated_channel import STRANGER
from tests.fri_client.two_loops import PERIOD_NS, REST, Bench

ODD: tuple[dict[str, Any], ...] = (
    {"measured": (math.nan,) * 7}, {"measured": (0.1, math.inf, *REST[2:])}, {"torque": (math.nan,) * 7},
    {"external": (0.0, math.inf, *(0.0,) * 5)}, {"external": (0.0, 29.5, *(0.0,) * 5)}, {"ipo": (math.nan,) * 7},
    {"ipo": tuple(q + 0.1 for q in REST)}, {"reflected": 7},
    {"ipo": (*REST[:6], -3.5e307)}, {"ipo": (7.1, *REST[1:])}, {"ipo": (6.9, *REST[1:])},
    {"commanded": (0.1, 3.5e307, *REST[2:])}, {"commanded": (-7.1, *REST[1:])}, {"commanded": (4.0, *REST[1:])},
)  # fmt: skip
ENDING: tuple[dict[str, Any], ...] = (
    {"external": (0.0, 30.5, *(0.0,) * 5)}, {"measured": tuple(q + 0.3 for q in REST)}, {"safety": 1},
    {"drives": (2, 2, 0, 2, 2, 2, 2)}, {"control": 2}, {"period": 2},
)  # fmt: skip


def late(machine: AnyWeather) -> bool:
    """What ends a motion comes after some of what does not."""
    return not machine.bench.over and machine.rounds > 12


class AnyWeather(RuleBasedStateMachine):
    """Good, bad, old, cut, damaged, foreign, queued and missing datagrams in any order, and requests to stop."""

    @initialize(
        version=st.sampled_from([FriVersion.V1_15, FriVersion.V2_5, FriVersion.V2_7]),
        counter=st.sampled_from([120, 16_370, (1 << 32) - 20]),
        driven=st.sampled_from([1, 300, 700]),
    )
    def begin(self, version: FriVersion, counter: int, driven: int) -> None:
        self.rounds = 0
        self.bench = Bench(version)
        self.bench.counter = counter
        self.bench.start()
        self.bench.drive(driven)

    def teardown(self) -> None:
        if hasattr(self, "bench"):
            self.bench.close()

    @precondition(lambda self: not self.bench.over)
    @rule(count=st.integers(1, 40))
    def good(self, count: int) -> None:
        self.rounds += 1
        for _ in range(0 if self.bench.over else count):
            self.bench.deliver(self.bench.next_datagram())

    @precondition(lambda self: not self.bench.over)
    @rule(changes=st.sampled_from(ODD))
    def odd(self, changes: dict[str, Any]) -> None:
        self.good(3)
        self.bench.deliver(self.bench.next_datagram(**changes))

    @precondition(late)
    @rule(changes=st.sampled_from(ENDING))
    def ending(self, changes: dict[str, Any]) -> None:
        self.odd(changes)

    @precondition(late)
    @rule(state=st.integers(0, 5))
    def state(self, state: int) -> None:
        self.good(3)
        self.bench.state = state
        self.bench.deliver(self.bench.next_datagram())

    @precondition(late)
    @rule(quality=st.integers(0, 3))
    def quality(self, quality: int) -> None:
        self.good(3)
        self.bench.quality = quality
        self.bench.deliver(self.bench.next_datagram())

    @precondition(lambda self: not self.bench.over)
    @rule(back=st.integers(0, 80))
    def old(self, back: int) -> None:
        self.good(3)
        message = self.bench.message()
        counter = message.header.sequence_counter - back & 0xFFFFFFFF
        stale = replace(message, header=replace(message.header, sequence_counter=counter))
        self.bench.deliver(self.bench.codec.encode_monitoring(stale))

    @precondition(lambda self: not self.bench.over)
    @rule(missing=st.sampled_from([1, 2, 9, 30, 499, 5000]), in_time=st.booleans())
    def gap(self, missing: int, in_time: bool) -> None:
        """So many messages are lost in the time they take; or the counter jumps, and no time has passed."""
        self.good(3)
        before = self.bench.counter
        self.bench.counter += missing
        if in_time and missing < 499:
            self.bench.clock.now += missing * PERIOD_NS
        self.bench.deliver(self.bench.next_datagram())
        if not in_time:
            self.bench.counter = before
        self.bench.deliver(self.bench.next_datagram())

    @precondition(lambda self: not self.bench.over)
    @rule(cut=st.integers(0, 400))
    def cut(self, cut: int) -> None:
        self.good(3)
        assert self.bench.deliver(self.bench.next_datagram()[: -cut - 9]) == [(), ()]

    @precondition(lambda self: not self.bench.over)
    @rule(place=st.integers(0, 10_000), bit=st.integers(0, 7))
    def damaged(self, place: int, bit: int) -> None:
        self.good(3)
        datagram = bytearray(self.bench.next_datagram())
        datagram[place % len(datagram)] ^= 1 << bit
        self.bench.deliver(bytes(datagram))

    @precondition(lambda self: not self.bench.over)
    @rule(garbage=st.binary(max_size=1600))
    def garbage(self, garbage: bytes) -> None:
        self.bench.deliver(garbage)

    @precondition(lambda self: not self.bench.over)
    @rule()
    def foreign(self) -> None:
        self.good(3)
        counter = self.bench.counter
        self.bench.counter = counter + 1 & 0xFFFFFFFF
        datagram = self.bench.codec.encode_monitoring(self.bench.message())
        self.bench.counter = counter
        self.bench.deliver(datagram, sender=STRANGER)

    @precondition(lambda self: not self.bench.over)
    @rule(count=st.integers(2, 12), turn=st.integers(0, 60))
    def queued(self, count: int, turn: int) -> None:
        """A stall of the client; with `turn` below count, the quality falls in the middle of what waits."""
        self.good(3)
        datagrams = []
        for place in range(count):
            if place == turn:
                self.bench.quality = 1
            datagrams.append(self.bench.next_datagram())
        self.bench.clock.now += (count - 1) * PERIOD_NS
        (answers, _) = self.bench.deliver(*datagrams)
        # All but the newest come too late for an answer.
        for answer in answers:
            assert self.bench.codec.decode_command(answer).header.reflected_sequence_counter == self.bench.counter
        assert len(answers) <= 1

    @precondition(late)
    @rule(how=st.sampled_from(["operator", "signal", "idle", "silence"]))
    def outside(self, how: str) -> None:
        self.good(3)
        if how == "operator":
            self.bench.both(lambda loop: loop._ring.request_stop(EventCode.OPERATOR_STOP))
        elif how == "signal":
            self.bench.both(lambda loop: loop.stop_from_signal(15))
        else:
            self.bench.clock.now += 50_000_000 if how == "idle" else 600_000_000
            self.bench.both(lambda loop: loop._idle(self.bench.clock.now))

    @precondition(lambda self: self.bench.over)
    @rule()
    def nothing_more(self) -> None:
        assert self.bench.outcomes[0] == self.bench.outcomes[1]

    @invariant()
    def both_motions_are_in_the_same_place(self) -> None:
        if not hasattr(self, "bench"):
            return
        ahead, plain = self.bench.loops
        for name in ("phase", "period", "sample_in_period", "_last"):
            assert getattr(ahead.motion, name) == getattr(plain.motion, name), name
        assert ahead.motion.stopping.kind == plain.motion.stopping.kind
        assert vars(ahead.motion._course)["_on_table"] == vars(plain.motion._course)["_on_table"]
        assert ahead.session.counts == plain.session.counts
        assert ahead._faults == plain._faults == 0
        assert (ahead.session.drop is None) or ahead.motion.phase >= MotionPhase.LATCHED


@pytest.mark.parametrize("changes", [*ODD, *ENDING])
def test_each_odd_message_is_answered_as_on_the_plain_way(bench: Bench, changes: dict[str, Any]) -> None:
    bench.drive(700)
    bench.deliver(bench.next_datagram(**changes))
    for _ in range(20):
        bench.deliver(bench.next_datagram())


def test_an_answer_made_ready_is_the_answer_of_the_plain_way() -> None:
    run_state_machine_as_test(
        AnyWeather,
        settings=settings(
            max_examples=25,
            stateful_step_count=30,
            deadline=None,
            # Shrinking drives two loops thousands of times; the history of a failure is short enough to read.
            phases=[Phase.generate],
            suppress_health_check=list(HealthCheck),
        ),
    )


@pytest.fixture
def bench(request: pytest.FixtureRequest) -> Any:
    bench = Bench(getattr(request, "param", FriVersion.V1_15))
    bench.start()
    yield bench
    bench.close()


@pytest.mark.parametrize("bench", [FriVersion.V1_15, FriVersion.V2_5, FriVersion.V2_7], indirect=True)
def test_nearly_every_answer_of_an_undisturbed_motion_is_made_ready(bench: Bench) -> None:
    bench.drive(1000)
    assert bench.used > 950


@pytest.mark.parametrize("ask", [lambda loop: loop.stop_from_signal(15), lambda loop: loop._ring.request_stop()])
def test_a_stop_asked_for_while_the_answer_lies_ready_is_obeyed_in_that_very_cycle(bench: Bench, ask: Any) -> None:
    bench.drive(700)
    bench.both(ask)
    used = bench.used
    bench.drive(1)
    assert bench.used == used
    assert bench.ahead.motion.phase == MotionPhase.STOP_RAMP


@pytest.mark.parametrize("refused", [1, 3, 9, 15])
def test_a_command_the_network_refused_does_not_move_the_path(bench: Bench, refused: int) -> None:
    """Before, the path went on without being sent: the next command was 145 to 802 % of the velocity limit away."""
    bench.drive(700)
    before = bench.position
    for channel in bench.channels:
        channel.refuse = refused
    while any(channel.refuse for channel in bench.channels):  # after a long pause a message more passes without a send
        assert bench.deliver(bench.next_datagram()) == [(), ()]
    bench.drive(1)
    assert np.abs(np.subtract(bench.position, before)).max() <= 0.0629e-3 * 1.01
    bench.drive(30)


def test_the_stop_of_a_lost_session_moves_one_step_for_all_that_waited(bench: Bench) -> None:
    bench.drive(700)
    before = bench.position
    datagrams = [bench.next_datagram() for _ in range(3)]
    bench.quality = 1
    datagrams += [bench.next_datagram() for _ in range(6)]
    bench.clock.now += 8 * PERIOD_NS
    (answers, _) = bench.deliver(*datagrams)
    (answer,) = answers
    command = bench.codec.decode_command(answer).command_data
    assert command is not None
    assert command.joint_position is not None
    assert np.abs(np.subtract(command.joint_position, before)).max() <= 1.1e-4  # 0.004 rad at 2.5 Hz: 0.063 mrad per ms
