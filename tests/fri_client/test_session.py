"""The session's rules, state by state and version by version; expected answers are PROTOCOL section 8, written out."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fri_client.handover import Disposition
from fri_client.messages import (
    COMMAND_IDENTIFIER,
    MONITORING_IDENTIFIER,
    CommandMessage,
    ConnectionInfo,
    FriVersion,
    IpoData,
    MessageHeader,
    MonitorData,
    MonitoringMessage,
    RobotInfo,
)
from fri_client.robot_counter import COUNTER_WINDOW, RESTART_RUN
from fri_client.session import Session
from fri_client.session_drop import DropReason

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
        ),
    )


def begun(version: FriVersion = FriVersion.V1_15) -> Session:
    """A session whose motion began at counter 10."""
    session = Session(version)
    session.judge(message(9, COMMANDING_WAIT), 1)
    first = message(10)
    session.judge(first, 2)
    session.begin_motion(first)
    return session


def position_of(command: CommandMessage | None) -> tuple[float, ...] | None:
    assert command is not None
    return None if command.command_data is None else command.command_data.joint_position


@pytest.mark.parametrize("version", list(FriVersion))
@pytest.mark.parametrize(
    ("state", "expected"),
    [
        (IDLE, None),
        (WAIT, "monitoring"),
        (READY, "monitoring"),
        (COMMANDING_WAIT, IPO),
        (ACTIVE, IPO),
        (5, None),
        (9, None),
        (-1, None),
    ],
)
def test_each_state_is_answered_as_the_vendors_client_does(version: FriVersion, state: int, expected: object) -> None:
    session = Session(version)
    told = message(1, state, ipo=IPO)
    assert session.judge(told, 1) == FRESH
    answer = session.answer(told, WANTED)  # nobody asked for a motion, so WANTED must not show
    if expected is None:
        assert not session.answer_due
        assert answer is None
    elif expected == "monitoring":
        assert position_of(answer) == (COMMANDED if version.value.startswith("1.") else None)
    else:
        assert position_of(answer) == expected


def test_a_robot_of_1_x_that_sends_no_commanded_position_gets_a_bare_header() -> None:
    session = Session(FriVersion.V1_15)
    told = message(1, READY, commanded=None)
    session.judge(told, 1)
    assert position_of(session.answer(told)) is None


def test_own_counter_counts_what_was_sent_and_the_other_reflects_what_is_answered() -> None:
    session = Session(FriVersion.V1_15)
    headers = []
    for counter, state in ((500, WAIT), (501, IDLE), (502, READY), (503, WAIT)):
        told = message(counter, state)
        session.judge(told, counter)
        answer = session.answer(told)
        if answer is not None:
            headers.append(answer.header)
            session.sent()
    assert headers == [MessageHeader(COMMAND_IDENTIFIER, own, robot) for own, robot in ((0, 500), (1, 502), (2, 503))]


def test_own_counter_wraps_after_32_bits() -> None:
    session = Session(FriVersion.V1_15)
    session.own_counter = 0xFFFFFFFF
    session.sent()
    assert session.own_counter == 0


def test_a_multiplier_of_n_answers_every_nth_message_and_none_of_them_in_idle() -> None:
    for multiplier, due in ((0, [1] * 6), (1, [1] * 6), (None, [1] * 6), (3, [0, 0, 1, 0, 0, 1])):
        session = Session(FriVersion.V1_15)
        answered = []
        for counter in range(6):
            session.judge(message(counter, READY, multiplier=multiplier), counter)
            answered.append(int(session.answer_due))
        assert answered == due
    assert session.command_period_ms == 3


def test_gaps_duplicates_and_late_arrivals_are_told_apart() -> None:
    session = Session(FriVersion.V1_15)
    judged = [session.judge(message(counter, READY), counter) for counter in (10, 11, 11, 14, 12, 12, 15, 13, 10)]
    assert judged == [FRESH, FRESH, DUPLICATE, FRESH, STALE, DUPLICATE, FRESH, STALE, DUPLICATE]
    counts = session.counts
    assert (counts.received, counts.fresh, counts.duplicates, counts.stale, counts.missing) == (9, 4, 3, 2, 0)


def test_the_robots_counter_may_wrap() -> None:
    session = Session(FriVersion.V1_15)
    for counter in (0xFFFFFFFE, 0xFFFFFFFF, 0, 1):
        assert session.judge(message(counter, READY), 1) == FRESH
    assert session.counts.missing == 0
    assert session.judge(message(0xFFFFFFFF, READY), 1) == DUPLICATE
    assert session.judge(message(4, READY), 1) == FRESH
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
    assert session.judge(message(11, **{field: bad}), 5) == REFUSED
    assert (session.refusal_joint, session.counts.refused, session.answer_due) == (5, 1, answered)
    assert "joint 5" in session.refusal
    # It cost this one message; the next good one is judged as if nothing had been.
    assert session.judge(message(12), 6) == FRESH
    assert session.counts.missing == 0


def test_huge_finite_numbers_are_not_mistaken_for_infinite_ones() -> None:
    session = Session(FriVersion.V1_15)
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
        assert session.judge(bad, 5) == REFUSED
        assert session.drop is None
        assert session.refusal


def test_one_wild_counter_is_refused_and_leaves_no_trace() -> None:
    session = begun()
    assert session.judge(message(10 + COUNTER_WINDOW + 1), 5) == REFUSED
    assert session.judge(message(11), 6) == FRESH
    assert (session.drop, session.counts.missing) == (None, 0)


@pytest.mark.parametrize("start", [0, 1_000_000, 10 - 300])
def test_a_counter_that_begins_anew_is_believed_after_a_run_and_drops_a_motion(start: int) -> None:
    session = begun()
    judged = [session.judge(message(start + k), 5) for k in range(RESTART_RUN + 2)]
    fresh = judged.index(FRESH)
    assert fresh <= RESTART_RUN
    assert judged[fresh:] == [FRESH] * (len(judged) - fresh)
    assert session.drop is not None
    assert session.drop.reason == DropReason.COUNTER_RESTART
    # The arm has stood at its last command meanwhile, so that may be held; once the robot has left, only the mirror.
    assert session.may_ramp_down
    session.judge(message(start + RESTART_RUN + 2, READY), 6)
    session.judge(message(start + RESTART_RUN + 3), 7)
    assert position_of(session.answer(message(start), WANTED)) == IPO


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
    ({"operation": 0}, DropReason.OPERATION_MODE, "from AUTOMATIC_MODE to TEST_MODE_1"),
    ({"period": 2}, DropReason.PERIOD_CHANGE, "from 1 ms to 2 ms"),
    ({"safety": 1, "state": READY, "quality": 0}, DropReason.SAFETY_STOP, "SAFETY_STOP"),
    ({"drives": (0,) * 7, "state": IDLE}, DropReason.SESSION_CLOSED, "closed the session"),
    ({"drives": (0,) * 7, "state": READY, "quality": 2}, DropReason.LEFT_COMMANDING_ACTIVE, "at quality GOOD"),
]


@pytest.mark.parametrize(("changes", "reason", "words"), DROPS)
def test_every_way_out_of_commanding_active_latches_and_says_why(
    changes: dict[str, Any], reason: DropReason, words: str
) -> None:
    session = begun()
    session.judge(message(11), 3)
    assert position_of(session.answer(message(11), WANTED)) == WANTED
    session.judge(message(12, **changes), 4)
    drop = session.drop
    assert drop is not None
    assert (drop.reason, drop.cycle) == (reason, 4)
    assert words in drop.sentence()
    assert drop.sentence().count(". ") == 0, "one sentence"


def test_a_better_quality_and_a_field_that_is_no_longer_sent_are_no_drop() -> None:
    session = begun()
    for counter, changes in ((11, {"quality": 2}), (12, {"mode": None}), (13, {"safety": None, "control": None})):
        session.judge(message(counter, **changes), counter)
    assert session.drop is None


def test_silence_drops_and_any_counter_is_taken_after_it() -> None:
    session = begun()
    session.note_silence(0.7, 0.5)
    assert session.drop is not None
    assert "0.7 s (time-out 0.5 s)" in session.drop.sentence()
    assert session.judge(message(5), 9) == FRESH


def test_without_a_motion_nothing_latches() -> None:
    session = Session(FriVersion.V1_15)
    for counter, state in enumerate((ACTIVE, IDLE, WAIT, READY, COMMANDING_WAIT, ACTIVE)):
        session.judge(message(counter, state), counter)
    session.note_silence(1.0, 0.5)
    assert session.drop is None


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"state": READY}, "MONITORING_READY"),
        ({"quality": 1}, "FAIR"),
        ({"mode": 3}, "TORQUE"),
        ({"safety": 2}, "SAFETY_STOP_LEVEL_1"),
        ({"drives": (2, 0, 2, 2, 2, 2, 2)}, "joint 2"),
    ],
)
def test_a_motion_cannot_begin_where_it_would_be_dropped(changes: dict[str, Any], words: str) -> None:
    session = Session(FriVersion.V1_15)
    told = message(1, **changes)
    session.judge(told, 1)
    assert words in (session.obstacle(told) or "")
    with pytest.raises(ValueError, match=words):
        session.begin_motion(told)


def test_as_long_as_the_robot_still_commands_the_stop_may_be_a_ramp_and_never_again_after() -> None:
    session = begun()
    session.judge(message(11, safety=1), 3)
    assert session.may_ramp_down
    assert position_of(session.answer(message(11, safety=1), WANTED)) == WANTED
    session.judge(message(12, READY), 4)
    session.judge(message(13, ACTIVE), 5)
    assert not session.may_ramp_down
    assert position_of(session.answer(message(13), WANTED)) == IPO


_step = st.fixed_dictionaries(
    {
        "advance": st.sampled_from([1, 1, 1, 1, 2, 0, -1, 5000]),
        "state": st.sampled_from([0, 1, 2, 3, 4, 4, 4, 9]),
        "quality": st.sampled_from([3, 3, 3, 2, 1, 0]),
        "safety": st.sampled_from([0, 0, 0, 1]),
        "mode": st.sampled_from([1, 1, 1, 3]),
        "silence": st.sampled_from([False] * 6 + [True]),
        "bad": st.sampled_from([False] * 6 + [True]),
    }
)


@settings(max_examples=400, deadline=None)
@given(st.lists(_step, min_size=1, max_size=60), st.sampled_from([FriVersion.V1_15, FriVersion.V2_5]))
def test_once_the_robot_has_left_only_the_mirror_is_ever_sent(steps: list[dict[str, Any]], version: FriVersion) -> None:
    """WANTED stands for what a motion asks for: once the robot left COMMANDING_ACTIVE it must never go out again."""
    session = begun(version)
    counter, left = 10, False
    for step in steps:
        counter += step["advance"]
        if step["silence"]:
            session.note_silence(1.0, 0.5)
        told = message(
            counter,
            step["state"],
            quality=step["quality"],
            safety=step["safety"],
            mode=step["mode"],
            measured=(math.nan,) * 7 if step["bad"] else MEASURED,
        )
        if session.judge(told, counter) != FRESH:
            assert not session.answer_due
            continue
        left = left or step["state"] != ACTIVE
        latched = session.drop is not None
        answer = session.answer(told, WANTED)
        sent = None if answer is None else position_of(answer)
        if step["state"] in (COMMANDING_WAIT, ACTIVE):
            assert sent in (IPO, WANTED)
        else:
            assert sent != WANTED
        if left:
            assert latched, "leaving COMMANDING_ACTIVE latches"
            assert sent != WANTED
        elif not latched:
            assert sent == WANTED
    if session.drop is not None:
        with pytest.raises(ValueError, match=r"latched|session|quality|mode|safety"):
            session.begin_motion(message(counter))
