"""The gate lets a position out in the cycle that it is for, after the command that it was judged after, or not at all.

Network and clock are simulated. Which cycle of the robot a command reaches is worked out by the robot in here, from
when the command left; where the docs say 10 ms are bridged, the tests leave a period of room on both sides.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import pytest
from hypothesis import event, given
from hypothesis import strategies as st

from fixtures.judge import Judge
from fri_client.loop.gate import CommandGate, Pace
from fri_client.session.robot_clock import Moment, RobotClock
from safety.guard import CommandGuard, Judged
from safety.limits import IIWA14_R820
from tests.fri_client.simulated_channel import ROBOT, SimulatedChannel, SimulatedClock

MS = 1_000_000
REST = (0.1, 0.3, -0.1, -0.9, 0.2, 0.5, 0.05)
BRIDGED_MS = 10
SPEED_RAD_S = 0.2
periods = st.sampled_from([1, 2, 5, 10])


class Rig:
    """A gate whose arm speeds up from rest along joint 1 and goes on at SPEED_RAD_S, as far as commands go out."""

    def __init__(self, period_ms: int = 1, *, simulated: bool = False) -> None:
        self.period = period_ms * MS
        self.clock = SimulatedClock()
        self.channel = SimulatedChannel(self.clock)
        self.robot_clock = RobotClock()
        self.robot_clock.simulated = simulated
        for steps in range(30):  # enough messages to know when the robot sends
            self.robot_clock.note(min(steps, 1), steps * period_ms * MS, period_ms)
        self.gate = CommandGate(self.channel, self.robot_clock, self.clock)
        self.guard = CommandGuard(IIWA14_R820, period_ms * 1e-3)
        self.gate.use(self.guard, period_ms * 1e-3, 1)
        self.counter = 0
        self.guard.anchor(REST)
        self.time = self.clock.now

    def wanted(self, *, faster: bool = True) -> Judged:
        """The next command, judged: a little faster than the last one, or a repetition."""
        position = self.guard.position
        if faster:
            step = self.period * 1e-9
            position[0] += min(SPEED_RAD_S, float(self.guard.velocity[0]) + 0.5 * step) * step
        judged = self.guard.examine(tuple(position.tolist()), None, stopping=not faster)
        assert isinstance(judged, Judged)
        return judged

    def message(self, after: float, stall: float = 0.0) -> int:
        """A message comes `after` periods after the last; the process stalls for `stall` periods. Its time, ns."""
        self.time += round(after * self.period)
        self.clock.now = max(self.clock.now, self.time) + round(stall * self.period)
        return self.time

    def send(self, judged: Judged) -> int | None:
        self.counter += 1
        return self.gate.send(judged, b"command", ROBOT, Moment(self.time, self.time, self.counter))

    def pace(self, time_ns: int) -> Pace:
        return self.gate.pace(Moment(time_ns, time_ns, self.counter + 1))

    def in_motion(self) -> Rig:
        """The same rig, once the arm moves."""
        for _ in range(5):
            self.message(1.0)
            assert self.send(self.wanted())
        assert not self.guard.at_rest
        return self

    def assert_nothing_happens_on(self, judged: Judged) -> None:
        before = (len(self.channel.sent), self.guard.generation, self.guard.position.tolist(), self.gate.last_send_ns)
        assert self.send(judged) is None
        after = (len(self.channel.sent), self.guard.generation, self.guard.position.tolist(), self.gate.last_send_ns)
        assert before == after


@given(periods, st.floats(0.0, 40.0), st.floats(0.0, 3.0), st.floats(0.0, 0.95))
def test_a_moving_arm_gets_a_command_in_its_next_cycles_only(
    period_ms: int, elapsed: float, stall: float, left_late: float
) -> None:
    """elapsed: periods since the last message that was answered; left_late: share of its period after which the answer
    left; stall: between this message and its answer.
    """
    rig = Rig(period_ms).in_motion()
    rig.message(1.0, min(left_late, 0.75))
    assert rig.send(rig.wanted())
    judged = rig.wanted()
    rig.message(elapsed, stall)
    pace = rig.pace(rig.time)
    elapsed_ms = elapsed * period_ms
    may = stall < 0.75 and elapsed >= 1.0 and elapsed_ms <= BRIDGED_MS + period_ms
    must_not = stall > 0.85 or elapsed < 0.15 + min(left_late, 0.75) or elapsed_ms > BRIDGED_MS + 2 * period_ms
    if may:
        assert pace == Pace.NEXT
        assert rig.send(judged) == rig.clock.now
        assert rig.guard.position.tolist() == list(judged.command)
    elif must_not:
        assert stall > 0.85 or pace in (Pace.TOO_EARLY, Pace.UNCLEAR, Pace.STANDS)
        rig.assert_nothing_happens_on(judged)
    if elapsed_ms > BRIDGED_MS + (2 + min(left_late, 0.75)) * period_ms:  # also where cycles are not where we think
        assert pace == Pace.STANDS


@given(periods, st.floats(0.0, 40.0), st.floats(0.0, 100.0), st.booleans())
def test_a_repetition_at_rest_may_always_go(period_ms: int, elapsed: float, stall: float, waiting: bool) -> None:
    rig = Rig(period_ms)
    rig.message(1.0)
    assert rig.send(rig.wanted(faster=False))
    if waiting:
        rig.channel.inbox.append((b"another", ROBOT))
    rig.message(elapsed, stall)
    assert rig.send(rig.wanted(faster=False)) == rig.clock.now


@given(periods, st.floats(0.0, 0.15), st.floats(0.85, 100.0))
def test_an_arm_at_rest_begins_neither_too_early_nor_late(period_ms: int, elapsed: float, stall: float) -> None:
    rig = Rig(period_ms)
    rig.message(1.0)
    first = rig.wanted()
    rig.clock.now += round(stall * rig.period)
    rig.assert_nothing_happens_on(first)
    rig.message(1.0)
    rig.clock.now = rig.time
    assert rig.send(rig.wanted(faster=False))
    rig.message(elapsed)
    rig.assert_nothing_happens_on(rig.wanted())
    rig.message(1.0)
    assert rig.send(rig.wanted())


@pytest.mark.parametrize("period_ms", [1, 2, 5, 10])
def test_on_the_edge_of_what_a_robot_bridges_nothing_goes_out_and_then_only_from_rest(period_ms: int) -> None:
    rig = Rig(period_ms).in_motion()
    judged = rig.wanted()
    paces = []
    for _ in range(80):
        rig.message(0.5)
        paces.append(rig.pace(rig.time))
        if paces[-1] != Pace.NEXT:
            rig.assert_nothing_happens_on(judged)
    assert Pace.UNCLEAR in paces
    assert paces[1:] == sorted(paces[1:])  # NEXT, UNCLEAR, STANDS
    assert paces[-1] == Pace.STANDS
    rig.guard.come_to_rest()
    assert rig.send(rig.wanted())


@given(st.integers(1, 20))
def test_a_send_that_the_network_refuses_leaves_everything_as_it_was(refused: int) -> None:
    rig = Rig().in_motion()
    rig.message(1.0)
    judged, pace = rig.wanted(), rig.pace(rig.time)
    before = (rig.guard.generation, rig.guard.position.tolist(), rig.gate.last_send_ns, len(rig.channel.sent))
    rig.channel.refuse = refused
    for _ in range(refused):
        assert rig.send(judged) == 0
    after = (rig.guard.generation, rig.guard.position.tolist(), rig.gate.last_send_ns, len(rig.channel.sent))
    assert (after, rig.pace(rig.time)) == (before, pace)
    assert rig.send(judged) == rig.clock.now  # the very step that was refused, and none more


@given(st.sampled_from(["another command", "anchor", "release", "rest"]))
def test_what_was_judged_after_another_command_does_not_go_out(changed: str) -> None:
    rig = Rig().in_motion()
    stale = rig.wanted()
    rig.message(1.0)
    if changed == "another command":
        assert rig.send(rig.wanted())
        rig.message(1.0)
    elif changed == "anchor":
        rig.guard.anchor(REST)
    elif changed == "rest":
        rig.guard.come_to_rest()
    else:
        rig.gate.forget()
    rig.assert_nothing_happens_on(stale)


def test_of_two_commands_judged_at_once_only_one_goes_out() -> None:
    rig = Rig().in_motion()
    rig.message(1.0)
    first, second = rig.wanted(), rig.wanted()
    assert rig.send(first)
    rig.message(1.0)
    rig.assert_nothing_happens_on(second)


def test_without_a_guard_and_after_the_robot_left_nothing_goes_out() -> None:
    rig = Rig().in_motion()
    judged = rig.wanted()
    rig.gate.forget()
    assert rig.pace(rig.time) == Pace.FIRST
    assert not isinstance(rig.guard.examine(REST, None), Judged)
    rig.assert_nothing_happens_on(judged)
    bare = CommandGate(rig.channel, rig.robot_clock, rig.clock)
    assert bare.send(judged, b"command", ROBOT, Moment(rig.time, rig.time, 1)) is None


def test_a_header_moves_nothing() -> None:
    rig = Rig().in_motion()
    state = (rig.guard.generation, rig.pace(rig.time))
    assert rig.gate.send_header(b"header", ROBOT) == rig.clock.now == rig.gate.last_send_ns
    rig.channel.refuse = 1
    rig.clock.now += 5
    assert rig.gate.send_header(b"header", ROBOT) == 0
    assert rig.gate.last_send_ns == rig.clock.now - 5
    assert (rig.guard.generation, rig.pace(rig.time)) == state


@given(st.lists(st.floats(0.0, 1e4), min_size=1, max_size=20))
def test_in_simulated_time_only_the_time_stamps_count(stalls: list[float]) -> None:
    rig = Rig(simulated=True).in_motion()
    for stall in stalls:
        rig.message(1.0, stall)
        judged = rig.wanted()
        rig.channel.inbox.append((b"another", ROBOT))
        assert rig.pace(rig.time) == Pace.NEXT
        assert rig.send(judged)
        rig.assert_nothing_happens_on(rig.wanted())  # the same millisecond
    rig.time += 13 * MS
    assert rig.pace(rig.time) == Pace.STANDS


def test_a_datagram_that_waits_when_a_command_leaves_costs_one_cycle_and_not_the_motion() -> None:
    """What waits may be the next message, sent before the command arrived: two steps would meet in one cycle. It may
    also be a stray one or a duplicate, so after that cycle the motion goes on.
    """
    rig = Rig().in_motion()
    rig.channel.inbox.append((b"another", ROBOT))
    rig.message(1.0, 0.1)
    assert rig.send(rig.wanted())
    rig.channel.inbox.clear()
    rig.message(0.15)
    rig.clock.now += round(0.3 * rig.period)
    assert rig.pace(rig.clock.now) == Pace.TOO_EARLY  # it waited, and was read after a stall
    rig.message(1.85)
    assert rig.pace(rig.time) == Pace.NEXT
    assert rig.send(rig.wanted())


cycles = st.tuples(
    st.sampled_from([1, 1, 1, 1, 2, 5, 11, 12, 30]),  # cycles since the last message that gets through
    st.sampled_from([0.0, 0.0, 0.05, 0.3, 0.7]),  # stall before a message is read
    st.sampled_from([0.02, 0.02, 0.1, 0.5, 0.79, 1.2, 4.0]),  # from there to the answer
    st.floats(0.0, 0.19),  # of the command's way to the robot
    st.sampled_from(["", "", "", "refused", "stray"]),
)


@given(st.lists(cycles, max_size=60), periods)
def test_no_two_steps_meet_in_one_cycle_of_the_robot(
    told: Sequence[tuple[int, float, float, float, str]], period_ms: int
) -> None:
    """The robot's side is judged by its own clock: the set-point of a cycle is the last command that arrived in it."""
    rig = Rig(period_ms)
    judge = Judge(rig.period)
    start, cycle = rig.clock.now, 0
    judge.begin(start, REST)
    for lost, read_late, answered_late, way, trouble in told:
        now = rig.clock.now
        cycle = max(cycle + lost, math.ceil((now - start) / rig.period))  # what came in a stall is not answered
        rig.time = rig.clock.now = start + cycle * rig.period + round(read_late * rig.period)
        if rig.pace(rig.time) == Pace.STANDS:
            rig.guard.come_to_rest()
        judged = rig.wanted()
        rig.clock.now += round(answered_late * rig.period)
        next_one = start + (cycle + 1) * rig.period
        rig.channel.inbox.clear()
        if rig.clock.now >= next_one or trouble == "stray":
            rig.channel.inbox.append((b"another", ROBOT))
        rig.channel.refuse = trouble == "refused"
        if rig.send(judged):
            judge.take(rig.clock.now + round(way * rig.period), judged.command)
    judgement = judge.judgement()
    assert judgement.percent("velocity") <= 100.0, judgement.excesses
    assert judgement.percent("acceleration") <= 100.0, judgement.excesses
    limit = SPEED_RAD_S / IIWA14_R820.velocity[0] * 100.0
    assert judgement.percent("velocity") <= limit * 1.001


@given(
    periods,
    st.lists(st.tuples(st.floats(0.0, 1.2), st.booleans(), st.floats(0.0, 0.9)), max_size=6),
    st.floats(-0.5, 3.0),
    st.floats(0.0, 1.2),
    st.booleans(),
)
def test_what_is_expected_is_what_the_gate_admits_as_the_next_step(
    period_ms: int, history: list[tuple[float, bool, float]], arrival: float, stall: float, queued: bool
) -> None:
    """The questions asked ahead are the questions of `send`: messages late by a share of a period, some unanswered."""
    rig = in_time(period_ms)
    clock, gate, period = rig.robot_clock, rig.gate, rig.period
    for cycle, (late, answered, held_up) in enumerate(history, 1):
        received = rig.time + cycle * period + round(late * period)
        rig.counter += 1
        clock.note(1, received, period_ms)
        if answered:
            rig.clock.now = max(rig.clock.now, received + round(held_up * period))
            rig.channel.inbox.extend([(b"waits", ROBOT)] * queued)
            gate.send(rig.wanted(), b"command", ROBOT, clock.moment(0, received, rig.counter))
    assert clock.due_ns is not None
    judged = rig.wanted()
    gate.expect(judged, rig.counter + 1)
    received = clock.due_ns + period + round(arrival * period)
    rig.clock.now = max(rig.clock.now, received + round(stall * period))
    moment = clock.moment(1, received, rig.counter + 1)
    is_next = gate.pace(moment) is Pace.NEXT and clock.admits(1, received) and gate.admits(judged, moment)
    in_its_cycle = moment.cycle_ns == clock.due_ns + period
    event(f"expected: {gate.is_expected(received)}")
    assert gate.is_expected(received) == (is_next and in_its_cycle)


def in_time(period_ms: int = 1) -> Rig:
    """A rig whose robot has just sent a message, and whose clock knows when the next ones are due."""
    rig = Rig(period_ms)
    rig.robot_clock.reset()
    for steps in range(30):
        rig.robot_clock.note(min(steps, 1), rig.message(1.0), period_ms)
    return rig


def test_nothing_is_expected_any_more_once_something_else_happened() -> None:
    """A forgotten robot, another guard, a message that was noted: the answer made ready is worth nothing."""
    for happens in (
        lambda rig: rig.gate.forget(),
        lambda rig: rig.gate.use(CommandGuard(IIWA14_R820, 1e-3), 1e-3, 1),
        lambda rig: rig.robot_clock.note(1, rig.time + MS + 10_000, 1),
        lambda rig: rig.robot_clock.reset(),
    ):
        rig = in_time()
        assert rig.send(rig.wanted())
        rig.gate.expect(rig.wanted(), rig.counter + 1)
        rig.clock.now = rig.time + MS
        assert rig.gate.is_expected(rig.time + MS)
        happens(rig)
        assert not rig.gate.is_expected(rig.time + MS)
        assert rig.gate.send_expected(b"command", ROBOT, rig.time + MS) is None
