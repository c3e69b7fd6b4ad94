"""What a session makes of each message: fresh, duplicate, stale or refused, and when it is lost."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fri_client.handover.ring import Disposition
from fri_client.messages import (
    MONITORING_IDENTIFIER,
    ConnectionInfo,
    IpoData,
    MessageHeader,
    MonitorData,
    MonitoringMessage,
    RobotInfo,
)
from fri_client.session.refusal import Refusal, refusal_sentence
from fri_client.session.robot_counter import COUNTER_WINDOW, RESTART_RUN
from fri_client.session.session import Session
from fri_client.session.session_drop import DropReason

IDLE, WAIT, READY, COMMANDING_WAIT, ACTIVE = range(5)
FRESH, DUPLICATE, STALE, REFUSED = (
    Disposition.FRESH,
    Disposition.DUPLICATE,
    Disposition.STALE,
    Disposition.REFUSED,
)
MEASURED = tuple(0.01 * joint for joint in range(7))
COMMANDED = tuple(0.02 * joint for joint in range(7))
IPO = tuple(0.03 * joint for joint in range(7))
WANTED = tuple(0.5 + 0.01 * joint for joint in range(7))


def message(counter: int, state: int = ACTIVE, **changes: Any) -> MonitoringMessage:
    """A good message of a robot in `state`; each keyword changes one thing."""
    drives = changes.get("drives", (2,) * 7)
    return MonitoringMessage(
        MessageHeader(MONITORING_IDENTIFIER, counter & 0xFFFFFFFF, 0),
        RobotInfo(
            changes.get("joints", 7),
            changes.get("safety", 0),
            drives,
            changes.get("operation", 2),
            changes.get("control", 0),
        ),
        MonitorData(
            measured_joint_position=changes.get("measured", MEASURED),
            measured_torque=changes.get("torque", (0.0,) * 7),
            commanded_joint_position=changes.get("commanded", COMMANDED),
            external_torque=changes.get("external", (0.0,) * 7),
        ),
        ConnectionInfo(state, changes.get("quality", 3), changes.get("period", 1), changes.get("multiplier", 1)),
        IpoData(
            joint_position=changes.get("ipo", IPO if state >= COMMANDING_WAIT else None),
            client_command_mode=changes.get("mode", 1),
            overlay_type=changes.get("overlay", 1),
        ),
    )


def later(milliseconds: float) -> int:
    """A time of receipt, ns, so much after the motion began."""
    return 1_000_000_000 + int(milliseconds * 1e6)


def begun() -> Session:
    """A session whose motion began at counter 10."""
    session = Session()
    session.judge(message(9, COMMANDING_WAIT), later(-1))
    first = message(10)
    session.judge(first, later(0))
    session.begin_motion(first)
    return session


def test_own_counter_wraps_after_32_bits() -> None:
    session = Session()
    session.own_counter = 0xFFFFFFFF
    session.sent()
    assert session.own_counter == 0


def test_a_multiplier_of_n_answers_every_nth_message_and_none_of_them_in_idle() -> None:
    for multiplier, due in ((0, [1] * 6), (1, [1] * 6), (None, [1] * 6), (3, [0, 0, 1, 0, 0, 1])):
        session = Session()
        answered = []
        for counter in range(6):
            session.judge(message(counter, READY, multiplier=multiplier), later(counter))
            answered.append(int(session.answer_due))
        assert answered == due
    assert session.command_period_ms == 3


def test_gaps_duplicates_and_late_arrivals_are_told_apart() -> None:
    session = Session()
    counters = (10, 11, 11, 14, 12, 12, 15, 13, 10)
    judged = [session.judge(message(counter, READY), later(counter)) for counter in counters]
    assert judged == [FRESH, FRESH, DUPLICATE, FRESH, STALE, DUPLICATE, FRESH, STALE, DUPLICATE]
    counts = session.counts
    assert (counts.received, counts.fresh, counts.duplicates, counts.stale, counts.missing) == (9, 4, 3, 2, 0)


def test_the_robots_counter_may_wrap() -> None:
    session = Session()
    for k, counter in enumerate((0xFFFFFFFE, 0xFFFFFFFF, 0, 1)):
        assert session.judge(message(counter, READY), later(k)) == FRESH
    assert session.counts.missing == 0
    assert session.judge(message(0xFFFFFFFF, READY), later(3)) == DUPLICATE
    assert session.judge(message(4, READY), later(6)) == FRESH
    assert session.gap == 2


def test_neither_duplicate_nor_stale_is_answered() -> None:
    session = begun()
    for counter in (10, 9):
        session.judge(message(counter), 5)
        assert not session.answer_due


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize(
    ("field", "answered"),
    [("measured", False), ("commanded", False), ("ipo", False), ("torque", True), ("external", True)],
)
def test_no_number_that_is_not_finite_gets_past(field: str, answered: bool, value: float) -> None:
    session = begun()
    bad = tuple(value if joint == 4 else 0.0 for joint in range(7))
    assert session.judge(message(11, **{field: bad}), later(5)) == REFUSED
    assert (session.refusal_joint, session.counts.refused, session.answer_due) == (5, 1, answered)
    assert session.refusal is not None
    assert "joint 5" in refusal_sentence(session.refusal, session.refusal_joint, session.refusal_value)
    # It cost this one message; the next good one is judged as if nothing had been.
    assert session.judge(message(12), later(6)) == FRESH
    assert session.counts.missing == 0


@pytest.mark.parametrize("field", ["measured", "commanded", "ipo"])
def test_a_position_that_no_joint_can_have_is_refused_and_named(field: str) -> None:
    """1e308 rad was finite, so it got as far as an operator's sentence, with all its 309 digits."""
    session = begun()
    assert session.judge(message(11, **{field: (0.0, 0.0, 1e308, 0.0, 0.0, 0.0, 0.0)}), later(1)) == REFUSED
    assert (session.refusal_joint, session.refusal_value) == (3, 1e308)
    assert session.refusal is not None
    assert len(refusal_sentence(session.refusal, 3, 1e308)) < 100


def test_a_refused_message_leaves_its_counter_to_the_good_one() -> None:
    """The good message with the counter of a damaged one was dropped as a duplicate."""
    session = begun()
    assert session.judge(message(11, joints=6), later(1)) == REFUSED
    assert session.judge(message(11), later(1)) == FRESH
    assert session.judge(message(12, measured=None), later(2)) == REFUSED
    assert session.judge(message(13), later(3)) == FRESH
    assert (session.counts.missing, session.counts.duplicates, session.counts.refused) == (0, 0, 2)


@pytest.mark.parametrize("ahead", [1, 2, 11, 100, 990])
def test_a_counter_that_runs_ahead_of_time_is_not_believed(ahead: int) -> None:
    """A jump of 11 to 990 was taken as lost time, and stopped a moving arm within one cycle."""
    session = begun()
    for k in range(1, 50):
        assert session.judge(message(10 + k), later(k)) == FRESH
    assert session.judge(message(59 + 1 + ahead), later(50)) == REFUSED
    assert session.refusal == Refusal.COUNTER
    assert session.judge(message(60), later(50)) == FRESH
    # The same counters are good where the time has passed: then the messages between were lost.
    assert session.judge(message(60 + ahead), later(50 + ahead)) == FRESH
    assert (session.gap, session.drop) == (ahead - 1, None)


@given(st.lists(st.floats(0.0, 0.9), min_size=1, max_size=300), st.sampled_from([1, 2, 5, 10]))
def test_messages_that_come_late_are_believed_however_unevenly(late: list[float], period: int) -> None:
    session = begun()
    for k, share in enumerate(late, start=1):
        session.judge(message(10 + k, period=period), later((k + share) * period))
    assert session.counts.refused <= 1  # the first period that differs from the one the motion began with


def test_huge_finite_numbers_are_not_mistaken_for_infinite_ones() -> None:
    session = Session()
    assert session.judge(message(1, READY, torque=(1.7e308,) * 7), 5) == FRESH


def test_messages_that_lack_a_group_are_refused() -> None:
    good = message(11)
    header, robot, monitor, connection = good.header, good.robot_info, good.monitor_data, good.connection_info
    for bad in (
        MonitoringMessage(header),
        MonitoringMessage(header, robot, monitor),  # cut at a field boundary: the vendor's client reads it as IDLE
        MonitoringMessage(header, robot, None, connection, good.ipo_data),
        MonitoringMessage(header, robot, MonitorData(), connection, good.ipo_data),
        MonitoringMessage(header, robot, monitor, connection),  # COMMANDING_ACTIVE without an IPO position
        message(11, joints=6),
    ):
        session = begun()
        assert session.judge(bad, later(5)) == REFUSED
        assert session.drop is None
        assert session.refusal is not None
        assert refusal_sentence(session.refusal, session.refusal_joint, session.refusal_value)


def test_one_wild_counter_is_refused_and_leaves_no_trace() -> None:
    session = begun()
    assert session.judge(message(10 + COUNTER_WINDOW + 1), later(5)) == REFUSED
    assert session.judge(message(11), later(6)) == FRESH
    assert (session.drop, session.counts.missing) == (None, 0)


@pytest.mark.parametrize("start", [0, 1_000_000, 10 - 300])
def test_a_counter_that_begins_anew_is_believed_after_a_run_and_drops_a_motion(start: int) -> None:
    session = begun()
    judged = [session.judge(message(start + k), later(k)) for k in range(RESTART_RUN + 2)]
    fresh = judged.index(FRESH)
    assert fresh <= RESTART_RUN
    assert judged[fresh:] == [FRESH] * (len(judged) - fresh)
    assert session.drop is not None
    assert session.drop.reason == DropReason.COUNTER_RESTART


DROPS = [
    ({"state": IDLE}, DropReason.SESSION_CLOSED, "closed the session (COMMANDING_ACTIVE -> IDLE)"),
    ({"state": 7}, DropReason.SESSION_CLOSED, "closed the session"),
    ({"state": WAIT}, DropReason.LEFT_COMMANDING_ACTIVE, "left COMMANDING_ACTIVE for MONITORING_WAIT"),
    ({"state": READY}, DropReason.LEFT_COMMANDING_ACTIVE, "MONITORING_READY"),
    ({"state": COMMANDING_WAIT}, DropReason.LEFT_COMMANDING_ACTIVE, "COMMANDING_WAIT"),
    ({"quality": 1}, DropReason.QUALITY, "quality fell to FAIR"),
    ({"quality": 0}, DropReason.QUALITY, "quality fell to POOR"),
    ({"quality": 9}, DropReason.QUALITY, "ConnectionQuality 9"),
    ({"safety": 1}, DropReason.SAFETY_STOP, "SAFETY_STOP_LEVEL_0"),
    ({"safety": 3}, DropReason.SAFETY_STOP, "SAFETY_STOP_LEVEL_2"),
    ({"drives": (2, 2, 2, 0, 2, 2, 2)}, DropReason.DRIVES_OFF, "drive of joint 4 became OFF"),
    ({"drives": (2, 2, 2, 2, 2, 2, 1)}, DropReason.DRIVES_OFF, "drive of joint 7 became TRANSITIONING"),
    ({"mode": 3}, DropReason.COMMAND_MODE, "from POSITION to TORQUE"),
    ({"control": 2}, DropReason.CONTROL_MODE, "from POSITION to JOINT_IMPEDANCE"),
    ({"overlay": 2}, DropReason.OVERLAY_TYPE, "the overlay type changed from JOINT to CARTESIAN"),
    ({"overlay": 0}, DropReason.OVERLAY_TYPE, "from JOINT to NO_OVERLAY"),
    ({"operation": 0}, DropReason.OPERATION_MODE, "from AUTOMATIC_MODE to TEST_MODE_1"),
    ({"period": 2}, DropReason.PERIOD_CHANGE, "from 1 ms to 2 ms"),
    ({"multiplier": 3}, DropReason.PERIOD_CHANGE, "from 1 ms to 3 ms"),
    ({"safety": 1, "state": READY, "quality": 0}, DropReason.SAFETY_STOP, "SAFETY_STOP"),
    ({"drives": (0,) * 7, "state": IDLE}, DropReason.SESSION_CLOSED, "closed the session"),
    ({"drives": (0,) * 7, "state": READY, "quality": 2}, DropReason.LEFT_COMMANDING_ACTIVE, "at quality GOOD"),
]


def test_another_send_period_with_the_same_time_between_commands_is_another_period() -> None:
    """Twice as long from message to message and every one answered: the labels of the samples would be wrong."""
    session = Session()
    for k in range(4):
        session.judge(message(k, multiplier=2), later(k))
    session.begin_motion(message(3, multiplier=2))
    session.judge(message(4, period=2, multiplier=1), later(4))
    assert session.drop is not None
    assert session.drop.reason == DropReason.PERIOD_CHANGE
    assert "from 1 ms to 2 ms" in session.drop.sentence()


@pytest.mark.parametrize(("changes", "reason", "words"), DROPS)
def test_every_way_out_of_commanding_active_latches_and_says_why(
    changes: dict[str, Any], reason: DropReason, words: str
) -> None:
    session = begun()
    session.judge(message(11), later(1))
    assert session.answer_due
    session.judge(message(12, **changes), later(2))
    drop = session.drop
    assert drop is not None
    assert (drop.reason, drop.cycle) == (reason, 4)
    assert words in drop.sentence()
    assert drop.sentence().count(". ") == 0, "one sentence"


def test_a_better_quality_and_a_field_that_is_no_longer_sent_are_no_drop() -> None:
    session = begun()
    for counter, changes in ((11, {"quality": 2}), (12, {"mode": None}), (13, {"safety": None, "control": None})):
        session.judge(message(counter, **changes), later(counter))
    assert session.drop is None


SILENT: dict[str, Any] = {"mode": None, "overlay": None, "control": None, "operation": None}


@pytest.mark.parametrize(
    ("said", "drop", "words"),
    [
        ([{"operation": 2}], DropReason.OPERATION_MODE, "for the first time that the operation mode is AUTOMATIC_MODE"),
        ([{"operation": 0}, {}, {"operation": 1}], DropReason.OPERATION_MODE, "from TEST_MODE_1 to TEST_MODE_2"),
        ([{"mode": 3}], DropReason.COMMAND_MODE, "says for the first time that the client command mode is TORQUE"),
        ([{"control": 0}, {}, {"control": 1}], DropReason.CONTROL_MODE, "from POSITION to CARTESIAN_IMPEDANCE"),
        ([{"overlay": 1}, {"overlay": 2}], DropReason.OVERLAY_TYPE, "from JOINT to CARTESIAN"),
        ([{"operation": 0, "mode": 1, "overlay": 1, "control": 2}, {}, {"operation": 0, "control": 2}], None, ""),
    ],
)  # fmt: skip
def test_what_a_robot_says_first_in_a_motion_is_judged_as_at_its_beginning_and_holds_from_then_on(
    said: list[dict[str, Any]], drop: DropReason | None, words: str
) -> None:
    session = Session()
    first = message(10, **SILENT)
    session.judge(first, later(0))
    session.begin_motion(first, test_mode_only=True)
    for place, changes in enumerate(said, start=1):
        assert session.drop is None
        session.judge(message(10 + place, **(SILENT | changes)), later(place))
    assert (None if session.drop is None else session.drop.reason) == drop
    assert session.drop is None or words in session.drop.sentence()


def test_silence_drops_and_any_counter_is_taken_after_it() -> None:
    session = begun()
    session.note_silence(0.7, 0.5)
    assert session.drop is not None
    assert "0.7 s (time-out 0.5 s)" in session.drop.sentence()
    assert session.judge(message(5), 9) == FRESH


def test_without_a_motion_nothing_latches() -> None:
    session = Session()
    for counter, state in enumerate((ACTIVE, IDLE, WAIT, READY, COMMANDING_WAIT, ACTIVE)):
        session.judge(message(counter, state), counter)
    session.note_silence(1.0, 0.5)
    assert session.drop is None


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"state": READY}, "MONITORING_READY"),
        ({"quality": 1}, "FAIR"),
        ({"period": None}, "does not say its send period"),
        ({"mode": 3}, "TORQUE"),
        ({"safety": 2}, "SAFETY_STOP_LEVEL_1"),
        ({"drives": (2, 0, 2, 2, 2, 2, 2)}, "joint 2"),
        ({"drives": (2, 2, 2)}, "3 joints instead of 7"),
    ],
)
def test_a_motion_cannot_begin_where_it_would_be_dropped(changes: dict[str, Any], words: str) -> None:
    session = Session()
    told = message(1, **changes)
    session.judge(told, 1)
    assert words in (session.obstacle(told) or "")
    with pytest.raises(ValueError, match=words):
        session.begin_motion(told)
