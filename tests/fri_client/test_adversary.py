"""No command outside the limits in any cycle of the robot, whatever wire, network and robot do; in simulated time.

The judge (fixtures.judge) is the only oracle: it shares no code with the guard. The named cases are attacks that went
through before there was one gate; the numbers are what was seen then. `python -m benchmarks.adversary` plays 10 000.
"""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import HealthCheck, Phase, given, settings

from fri_client.messages import FriVersion
from tests.fri_client.adversary.sequences import sequences
from tests.fri_client.adversary.world import Move, Outcome, Setting, play

AT = 600
"""In the excitation, at more than half of the velocity limits."""
AFTER_MS = 950
"""A stall of up to 20 ms and the way back to the path are over by then."""


def assert_inside(outcome: Outcome) -> None:
    found = outcome.judgement
    assert found.excess_count == 0, "\n".join(excess.sentence() for excess in found.excesses[:3])
    assert found.commands > 0
    assert outcome.loop._faults == 0


@pytest.mark.parametrize("state", [0, 1, 2, 3, 9])
def test_one_message_with_another_session_state_then_active_again(state: int) -> None:
    """The latched session answered with the raw IPO position: 24 072 % of the velocity limit."""
    outcome = play(Setting(duration_ms=1300), (Move("state", AT, 1, state),))
    assert_inside(outcome)
    assert outcome.result is not None
    assert outcome.result.outcome == "dropped"


def test_a_stale_message_after_silence() -> None:
    assert_inside(play(Setting(duration_ms=2200), (Move("lose", AT, 520), Move("stale", AT + 521, 1, 0.3))))


@pytest.mark.parametrize(
    "extra", [Move("stray", AT, 45, 0.5, "robot"), Move("stray", AT, 45, 0.5, "stranger"), Move("duplicate", AT, 45)]
)
@pytest.mark.parametrize(("stall_ms", "where"), [(40.0, "receive"), (9.0, "receive"), (9.0, "clock"), (9.0, "waiting")])
def test_a_stall_with_strays_undecodable_or_doubled_datagrams_behind_each_message(
    extra: Move, stall_ms: float, where: str
) -> None:
    """27 to 31 path steps reached the robot in one cycle: 1979 to 2275 % of the velocity limit, 729 % after 9 ms."""
    assert_inside(play(Setting(duration_ms=1000), (extra, Move("stall", AT + 2, 1, stall_ms, where))))


@pytest.mark.parametrize("move", [
    *(Move("stall", AT, 1, milliseconds, "receive") for milliseconds in (12.0, 60.0, 700.0)),
    Move("stamp", AT, 400, 3.6e6),
])  # fmt: skip
@pytest.mark.parametrize("send_period_ms", [1, 5])
def test_a_paused_loop_and_a_time_stamp_that_jumps_by_an_hour(move: Move, send_period_ms: int) -> None:
    assert_inside(play(Setting(send_period_ms=send_period_ms, duration_ms=1300 * send_period_ms), (move,)))


@pytest.mark.parametrize("refused", [1, 3, 9, 15])
def test_sends_that_the_network_refuses(refused: int) -> None:
    """The next command was 145, 291, 729, 802 % of the velocity limit away."""
    assert_inside(play(Setting(duration_ms=1000), (Move("refuse", AT, refused),)))


@pytest.mark.parametrize("where", ["receive", "clock", "waiting"])
@pytest.mark.parametrize("setting", [
    Setting(), Setting(2, 2), Setting(5),
])  # fmt: skip
@pytest.mark.parametrize("beyond", [0.2, 0.5, 0.9, 0.95])
def test_a_stall_that_ends_where_the_bridge_does(setting: Setting, beyond: float, where: str) -> None:
    """By a message that was read late the robot was a cycle further, and stood: 1 907 % of an acceleration limit."""
    period_ms = setting.send_period_ms * setting.receive_multiplier
    stalls = (Move("stall", at, 1, 10.0 + beyond * period_ms, where) for at in (74, 101, 250))
    for stall in stalls:
        until_ms = setting.send_period_ms * stall.at + AFTER_MS
        assert_inside(play(replace(setting, duration_ms=until_ms), (stall,)))


@pytest.mark.parametrize("share", [0.28, 0.6, 0.9, 0.97])
def test_a_forgery_while_the_robots_clock_is_not_known_again(share: float) -> None:
    """After a restart of the counter its answer followed the last one in the same cycle: 5 733 %."""
    for at in (208, 215, 226):
        restart = Move("counter_for_good", 201, 1, -31026)
        assert_inside(play(Setting(duration_ms=1000), (restart, Move("forged", at, 4, share, "receive"))))


@pytest.mark.parametrize("value", [0.99, 1.2, 2.5])
@pytest.mark.parametrize(("period", "multiplier"), [(1, 1), (1, 2), (2, 2), (5, 1), (10, 1)])
def test_messages_that_arrive_unevenly(period: int, multiplier: int, value: float) -> None:
    """An answer that left near the end of its cycle reached the next one, and the next answer reached it too: hundreds
    of commands at up to 143 % of the velocity limit and 8 235 % of the acceleration limit.
    """
    setting = Setting(send_period_ms=period, receive_multiplier=multiplier, duration_ms=250 * period)
    assert_inside(play(setting, (Move("jitter", 52, 150, value),)))


@pytest.mark.parametrize("move", [
    Move("period", 36, 3, 5),
    Move("period", 5, 3, 2),
    Move("swap", 46),
    Move("lose", 46, 1),
])  # fmt: skip
@pytest.mark.parametrize("ipo_speed", [0.07, 0.4])
@pytest.mark.parametrize("send_period_ms", [1, 5, 10])
def test_a_set_point_that_moves_is_not_followed_into_a_jump(move: Move, send_period_ms: int, ipo_speed: float) -> None:
    """One message that stated another period made the guard forget where the arm was: 2 188 % of a velocity limit.
    A message lost before a motion: jerk 813 %.
    """
    setting = Setting(send_period_ms=send_period_ms, ipo_speed=ipo_speed, duration_ms=150 * send_period_ms)
    assert play(setting, (move,)).judgement.excess_count == 0


@pytest.mark.parametrize("share", [0.93, 0.95, 0.98, 0.999])
@pytest.mark.parametrize("at", [7, 55, 120])
def test_a_forgery_just_before_its_time_at_a_long_period(share: float, at: int) -> None:
    """Its answer came before the robot's cycle did: 1 376 % of an acceleration limit."""
    assert_inside(play(Setting(send_period_ms=10, duration_ms=2500), (Move("forged", at, 1, share, "receive"),)))


def test_a_re_entry_that_breaks_off_and_whose_next_command_is_refused_for_long() -> None:
    """Each refusal planned the re-entry anew, from where the first one began: jerk 702 % at a period of 5 ms."""
    refused = Move("refuse", 91, 7)
    assert_inside(play(Setting(send_period_ms=5, duration_ms=863), (Move("stall", 84, 1, 23.8, "clock"), refused)))


@pytest.mark.parametrize("jump", [11, 100, 990, 5000])
@pytest.mark.parametrize("kind", ["counter", "counter_for_good"])
def test_a_counter_that_jumps_in_time(kind: str, jump: int) -> None:
    """A moving arm was stopped within one cycle: 14 486 % of the acceleration limit."""
    assert_inside(play(Setting(duration_ms=1300), (Move(kind, AT, 1, jump),)))


@pytest.mark.parametrize("speed", [0.05, 0.3, 1.0])
def test_a_set_point_of_the_robot_that_moves_when_the_motion_would_begin(speed: float) -> None:
    """The motion began "from rest": 584 to 11 669 % of the acceleration limit at the first commands."""
    outcome = play(Setting(ipo_speed=speed, duration_ms=150), ())
    assert outcome.judgement.excess_count == 0
    assert not outcome.loop.motion.commanded
    assert f"moves at {speed:g} rad/s" in outcome.loop._pilot.hindrance


@pytest.mark.parametrize("state", [3, 4])
@pytest.mark.parametrize(("period", "multiplier"), [(1, 1), (2, 2), (5, 1), (10, 1)])
def test_a_moving_set_point_of_a_robot_that_commands_is_not_mirrored_whatever_state_a_message_claims(
    state: int, period: int, multiplier: int
) -> None:
    """Four messages claimed COMMANDING_WAIT: the position that had moved on was sent back, 1 141 % of a limit."""
    setting = Setting(period, multiplier, ipo_speed=0.44, starts_active=True, duration_ms=100 * period)
    assert play(setting, (Move("state", 67, 4, state, "receive"),)).judgement.excess_count == 0


def test_forgeries_while_the_clock_is_learnt_do_not_end_the_bridge_too_soon() -> None:
    """They told cycles that began 4 ms too early; after uneven messages a motion was taken up from rest that had never
    stood: jerk 165 %.
    """
    setting = Setting(10, 1, FriVersion.V2_5, duration_ms=983)
    uneven = Move("jitter", 36, 15, 1.8491789181786233, "waiting")
    assert_inside(play(setting, (uneven, Move("forged", 1, 8, 0.6155047761989721, "receive"))))


@pytest.mark.parametrize("lost", [1, 2, 3, 9])
@pytest.mark.parametrize("how", ["lost", "silent, and the counter stands", "refused"])
@pytest.mark.parametrize(("period", "multiplier"), [(5, 1), (10, 1), (5, 2), (2, 2), (1, 2)])
def test_a_stop_after_the_robot_has_held(lost: int, how: str, period: int, multiplier: int) -> None:
    """A stop after 45 ms without a command began at 74 % of full speed, at a send period of 5 ms.

    1463 % of the acceleration limit where the counter stood meanwhile, 4261 % where the network had refused nine sends.
    """
    at = AT // period
    if how == "refused":
        moves = (Move("refuse", at, lost), Move("stop", at + lost))
    else:
        moves = (Move("lose", at, lost), Move("stop", at + lost + 1))
        if how != "lost":
            moves = (*moves, Move("counter_for_good", at + lost, 1, -lost))
    assert_inside(play(Setting(period, multiplier, duration_ms=1300), moves))


@settings(
    max_examples=120,  # ten thousand: `python -m benchmarks.adversary`
    deadline=None,
    derandomize=True,
    database=None,
    # Shrinking plays a motion of a second hundreds of times; a history of at most six moves is short enough to read.
    phases=[Phase.explicit, Phase.generate],
    suppress_health_check=list(HealthCheck),
)
@given(sequences)
def test_no_sequence_of_moves_leads_to_a_command_beyond_the_limits(
    sequence: tuple[Setting, tuple[Move, ...]],
) -> None:
    outcome = play(*sequence)
    found = outcome.judgement
    assert found.excess_count == 0, "\n".join(excess.sentence() for excess in found.excesses[:3])
    assert outcome.loop._faults == 0


def test_late_messages_are_not_taken_for_the_next_cycle_after_forgeries_had_told_a_wrong_beginning() -> None:
    """Found by 10 000 sequences: nine forgeries came 2.3 ms before their cycle while the clock was learnt. Messages
    that were 8 ms late then looked like ones of the next cycle; two answers reached one: 1 051 % of an acceleration.
    """
    forged = Move("forged", 1, 9, 0.7683168294733308, "waiting")
    jitter = Move("jitter", 43, 26, 1.1495464015071497, "receive")
    assert_inside(play(Setting(10, 1, FriVersion.V1_15, duration_ms=1190), (jitter, forged)))


def test_a_stop_in_the_tick_of_the_message_that_would_begin_the_motion_is_a_stop() -> None:
    """It was an internal error, "a motion begins once", with the exit code of one; found by 10 000 sequences."""
    moves = (
        Move("stall", 1, 1, 34.543006938165576, "waiting"),
        Move("duplicate", 6, 7, 0.0, "waiting"),
        Move("forged", 205, 9, 0.8917101582311744, "waiting"),
        Move("stop", 7, 1, 0.0, "waiting"),
    )
    outcome = play(Setting(5, 1, FriVersion.V2_7, duration_ms=1165), moves)
    assert_inside(outcome)
    assert outcome.result is not None
    assert (outcome.result.outcome, outcome.result.reason) == ("stopped", "OPERATOR_STOP")


def test_a_gap_behind_a_counter_that_jumped_for_good_and_forgeries_is_seen() -> None:
    """Found by 1 of 1 500 sequences (seed 700005000637): where cycles begin came from a forgery, a gap of 12 ms looked
    bridged, and the path went on by its step of 15 µrad: 2 190 % of the jerk limit, 1 % of the velocity.
    """
    jump = Move("counter_for_good", 28, 1, -64324, "receive")
    forged = Move("forged", 43, 9, 0.7544126958299741, "clock")
    assert_inside(play(Setting(1, 2, FriVersion.V2_5, 0.0, False, 1021), (jump, forged)))
