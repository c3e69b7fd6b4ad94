"""The client's side of one FRI session: what a monitoring message is worth, and when the session is over.

Here: judging each decoded message (fresh, duplicate, stale, refused), the counters of both sides, and the latch: a
motion's session that is lost stays lost. Not here: sockets (`loop`), what is answered (`pilot`), whether an answer may
go out (`gate`).

Which messages may be answered. A fresh message of a living session may (at a receive multiplier of N every N-th,
PROTOCOL section 7). Duplicates and stale messages may not: the robot has the answer to the duplicate, and an answer
to an old message would reach it after the answer to a newer one. The vendor's client answers both and lets old
values overwrite new ones (PROTOCOL section 6); a motion that advances one step per answer must not. A message
that is refused for a torque that is no number is answered, since positions, state and quality are sound, and one bad
torque must not disturb an arm in motion; its sample is refused all the same. Any other refused message is not
answered, because nothing in it can be trusted; its counter is not used up, so that the good message with the same
counter is taken. If refusals go on for the time-out, that is silence.

A counter is believed only if the robot can have counted so far by now (`robot_clock`).

The latch. Once a motion was begun, anything but an undisturbed COMMANDING_ACTIVE drops the session for good. What may
still be sent then is decided in `pilot`.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from sys import float_info

from fri_client.handover.ring import Disposition
from fri_client.messages import (
    JOINT_COUNT,
    ClientCommandMode,
    ConnectionInfo,
    ConnectionQuality,
    DriveState,
    IpoData,
    MonitorData,
    MonitoringMessage,
    RobotInfo,
    SafetyState,
    SessionState,
    name_of,
)
from fri_client.session.message_checks import (
    NamedArrays,
    is_good,
    joint_not_driven,
    positions,
    torques,
)
from fri_client.session.motion_terms import MotionTerms
from fri_client.session.refusal import Refusal
from fri_client.session.robot_clock import Moment, RobotClock
from fri_client.session.robot_counter import WRAP, Order, RobotCounter
from fri_client.session.session_drop import DropReason, SessionDrop

__all__ = ["DropReason", "Session", "SessionCounts", "SessionDrop"]

_IDLE = int(SessionState.IDLE)
_COMMANDING_WAIT = int(SessionState.COMMANDING_WAIT)
_COMMANDING_ACTIVE = int(SessionState.COMMANDING_ACTIVE)
_FRESH = int(Disposition.FRESH)
_NO_IPO = IpoData()
_NO_ROBOT_INFO = RobotInfo()

FARTHEST_RAD = 7.0
"""A joint position beyond this, more than a whole turn, is a number that no joint of an arm can report."""


@dataclass(slots=True)
class SessionCounts:
    """What came in and went out so far.

    received: decoded messages; missing: gaps in the robot's counter, less what arrived late after all; stale: older
    than one already seen; restarts: times the robot's counter began anew.
    """

    received: int = 0
    fresh: int = 0
    answered: int = 0
    missing: int = 0
    duplicates: int = 0
    stale: int = 0
    refused: int = 0
    restarts: int = 0


class Session:
    """One client session: `judge` each message; where `answer_due`, an answer may be sent; then `sent`.

    After `judge` returned FRESH the attributes describe that message: state (a value out of range counts as IDLE),
    quality, state_changed, previous_state, quality_changed, previous_quality, gap (messages missing before it), moment
    (by `clock`). After REFUSED, refusal says why, with refusal_joint (from 1, 0: none) and refusal_value. left: how
    the robot went back before a motion began, as a clause; empty where it did not.
    """

    def __init__(self) -> None:
        self.clock = RobotClock()
        self.moment = Moment(0, 0, 0)
        self.own_counter = 0
        self._counter = RobotCounter()
        self._since_answer = 0
        self._steps = 1  # counters from the message before to this one
        self._terms: MotionTerms | None = None
        self._begun_ns = 0
        self.counts = SessionCounts()
        self.state = self.previous_state = _IDLE
        self.quality = self.previous_quality = int(ConnectionQuality.POOR)
        self.state_changed = self.quality_changed = False
        self.gap = 0
        self.answer_due = False
        self.first_fresh_ns = 0
        self.last_fresh_ns = 0
        self.left = ""
        self.send_period_ms: int | None = None
        self.command_period_ms: int | None = None
        self.drop: SessionDrop | None = None
        self.refusal: Refusal | None = None
        self.refusal_joint = 0
        self.refusal_value = 0.0

    def judge(self, message: MonitoringMessage, receive_ns: int) -> int:
        """Judge one decoded message, received at receive_ns (CLOCK_MONOTONIC); returns a Disposition as a plain int."""
        counts = self.counts
        counts.received += 1
        self.answer_due = False
        monitor, info, ipo = message.monitor_data, message.connection_info, message.ipo_data
        if monitor is None or info is None or monitor.measured_joint_position is None:
            self._counter.refuse(message.header.sequence_counter)
            return self._refuse_for_lack_of(monitor, info)
        raw_state = info.session_state
        state = raw_state if 0 <= raw_state <= _COMMANDING_ACTIVE else _IDLE
        angles = monitor.measured_joint_position
        if monitor.commanded_joint_position is not None:
            angles += monitor.commanded_joint_position
        if ipo is not None and ipo.joint_position is not None:
            angles += ipo.joint_position
        elif state >= _COMMANDING_WAIT:
            self._counter.refuse(message.header.sequence_counter)
            return self._refuse(Refusal.NO_IPO_POSITION)
        # A NaN may hide from min and max, but not from the sum; only then each number is looked at.
        if not (isfinite(sum(angles)) and min(angles) >= -FARTHEST_RAD and max(angles) <= FARTHEST_RAD):
            self._counter.refuse(message.header.sequence_counter)
            self._find_wrong(positions(monitor, ipo), FARTHEST_RAD)
            return int(Disposition.REFUSED)
        robot = message.robot_info
        if robot is not None and robot.number_of_joints is not None and robot.number_of_joints != JOINT_COUNT:
            self._counter.refuse(message.header.sequence_counter)
            return self._refuse(Refusal.NUMBER_OF_JOINTS, 0, robot.number_of_joints)
        # What a message of a motion states of another period is a reason to drop, not another clock.
        begin = None if self._terms is None else self._terms.connection
        disposition = self._judge_counter(message, receive_ns, (begin or info).send_period)
        if disposition != _FRESH:
            return disposition
        total = 0.0
        if monitor.measured_torque is not None:
            total = sum(monitor.measured_torque)
        if monitor.external_torque is not None:
            total += sum(monitor.external_torque)
        if monitor.commanded_torque is not None:
            total += sum(monitor.commanded_torque)
        # A sum of finite numbers may overflow, so the sum only raises the suspicion.
        if not isfinite(total) and self._find_wrong(torques(monitor), float_info.max):
            disposition = int(Disposition.REFUSED)
        else:
            counts.fresh += 1
            self.last_fresh_ns = receive_ns
            if not self.first_fresh_ns:
                self.first_fresh_ns = receive_ns
        self.previous_state = self.state
        self.state_changed = state != self.state
        self.state = state
        quality = info.quality
        if self.state_changed and self._terms is None:
            self._note_leaving(quality)
        self.previous_quality = self.quality
        self.quality_changed = quality != self.quality
        self.quality = quality
        multiplier = info.receive_multiplier or 1
        self.send_period_ms = info.send_period
        self.command_period_ms = None if info.send_period is None else info.send_period * multiplier
        if self._terms is not None and self.drop is None:
            breach = self._terms.breach(message, info, state)
            if breach is not None:
                self._latch(breach.reason, state, breach.value, breach.limit, breach.joint)
        if state == _IDLE:
            return disposition
        # Counted by the robot's counter: messages that were lost or refused shift no phase.
        self._since_answer += self._steps
        if self._since_answer >= multiplier:
            self._since_answer %= multiplier
            self.answer_due = True
        return disposition

    def begin_motion(
        self, message: MonitoringMessage, *, test_mode_only: bool = False, never_in_t1: bool = False
    ) -> None:
        """From here on the session is watched: call it with the COMMANDING_ACTIVE message the motion starts from.

        test_mode_only, never_in_t1: see `MotionTerms`. Raises ValueError where `obstacle` names one, or when a session
        was dropped before: a latched session stays so.
        """
        hindrance = self.obstacle(message)
        if self.drop is not None or hindrance is not None:
            raise ValueError(hindrance or "the session is latched")
        self._terms = MotionTerms(message, test_mode_only=test_mode_only, never_in_t1=never_in_t1)
        self._begun_ns = self.moment.time_ns

    def obstacle(self, message: MonitoringMessage) -> str | None:
        """Why a motion cannot begin on this fresh message, as a clause for the operator; None when it can."""
        if self.state != _COMMANDING_ACTIVE:
            return f"the session is in {name_of(SessionState, self.state)}, not in COMMANDING_ACTIVE"
        if not is_good(self.quality):
            return f"the connection quality is {name_of(ConnectionQuality, self.quality)}, below GOOD"
        if not self.send_period_ms:
            return "the robot does not say its send period"
        mode = (message.ipo_data or _NO_IPO).client_command_mode
        if mode is not None and mode != ClientCommandMode.POSITION:
            return f"the client command mode is {name_of(ClientCommandMode, mode)}, not POSITION"
        robot = message.robot_info or _NO_ROBOT_INFO
        if robot.safety_state not in (None, SafetyState.NORMAL_OPERATION):
            return f"the safety state is {name_of(SafetyState, robot.safety_state)}"
        if robot.drive_state and len(robot.drive_state) != JOINT_COUNT:
            return f"the robot reports the drives of {len(robot.drive_state)} joints instead of 7"
        joint = joint_not_driven(robot)
        if joint:
            return f"the drive of joint {joint} is {name_of(DriveState, robot.drive_state[joint - 1])}"
        return None

    @property
    def begun(self) -> bool:
        """Whether a motion was begun in this session, dropped since or not."""
        return self._terms is not None

    def sent(self) -> None:
        """The answer went out: the own counter moves on."""
        self.own_counter = (self.own_counter + 1) & WRAP
        self.counts.answered += 1

    def note_silence(self, silence_s: float, timeout_s: float) -> None:
        """No usable message came for the time-out. After it any counter is taken as the robot's new one."""
        self._counter.resynchronise()
        self.clock.reset()
        self._latch(DropReason.SILENCE, self.state, silence_s, timeout_s)

    def take_foreseen(self, message: MonitoringMessage, receive_ns: int) -> None:
        """`judge` for a message that was answered before it was looked at as a whole.

        Raises RuntimeError where it turns out not to be the fresh one that the answer was for.
        """
        disposition = self.judge(message, receive_ns)
        if disposition != _FRESH or not self.answer_due or self.drop is not None:
            raise RuntimeError(f"the message {message.header.sequence_counter} was not what it looked like")

    def _judge_counter(self, message: MonitoringMessage, receive_ns: int, period_ms: int | None) -> int:
        counter, clock, robot, counts = message.header.sequence_counter, self.clock, self._counter, self.counts
        time_ns = clock.time_of(message, receive_ns)
        steps = robot.steps(counter)
        self._steps = steps or 1
        order = robot.judge(counter, in_time=clock.admits(steps, time_ns))
        self.gap = robot.gap
        if order == Order.NEXT:
            clock.note(steps, time_ns, period_ms)
            self.moment = clock.moment(0, time_ns, counter)
            counts.missing += robot.gap
            return _FRESH
        if order == Order.RESTARTED:
            clock.reset()
            clock.note(0, time_ns, period_ms)
            self.moment = Moment(time_ns, time_ns, counter)
            counts.restarts += 1
            self._latch(DropReason.COUNTER_RESTART, self.state, counter, robot.expected_before_restart)
            return _FRESH
        if order == Order.REPEATED:
            counts.duplicates += 1
            return int(Disposition.DUPLICATE)
        if order == Order.DOUBTFUL:
            return self._refuse(Refusal.COUNTER, 0, counter)
        counts.stale += 1
        if order == Order.BELATED:
            counts.missing = max(0, counts.missing - 1)
        return int(Disposition.STALE)

    def _note_leaving(self, quality: int) -> None:
        """Of a session that goes back before a motion began: from where and how good it was; its close comes after."""
        before, after = self.previous_state, self.state
        if after >= _COMMANDING_WAIT:
            self.left = ""
        elif before >= _COMMANDING_WAIT or (after == _IDLE and not self.left):
            names = f"{name_of(SessionState, before)} for {name_of(SessionState, after)}"
            self.left = (
                f"the robot left {names} at quality {name_of(ConnectionQuality, quality)}, before a motion began"
            )

    # What is refused.

    def _refuse(self, why: Refusal, joint: int = 0, value: float = 0.0) -> int:
        self.counts.refused += 1
        self.refusal, self.refusal_joint, self.refusal_value = why, joint, value
        return int(Disposition.REFUSED)

    def _refuse_for_lack_of(self, monitor: MonitorData | None, info: ConnectionInfo | None) -> int:
        if monitor is None:
            return self._refuse(Refusal.NO_MONITOR_DATA)
        return self._refuse(Refusal.NO_CONNECTION_INFO if info is None else Refusal.NO_MEASURED_POSITION)

    def _find_wrong(self, arrays: NamedArrays, largest: float) -> bool:
        for reason, values in arrays:
            for joint, value in enumerate(values or (), start=1):
                if not -largest <= value <= largest:
                    self._refuse(reason, joint, value)
                    return True
        return False

    # The latch.

    def _latch(self, reason: DropReason, state: int, value: float | None, limit: float | None, joint: int = 0) -> None:
        if self._terms is None or self.drop is not None:
            return
        before = self.previous_state if self.state_changed else self.state
        if reason in (DropReason.SILENCE, DropReason.COUNTER_RESTART):
            before = self.state
        self.drop = SessionDrop(
            reason=reason,
            state_before=before,
            state_after=state,
            cycle=self.counts.fresh,
            value=float(-1 if value is None else value),
            limit=float(-1 if limit is None else limit),
            joint=joint,
            quality=self.quality,
            motion_s=(self.moment.time_ns - self._begun_ns) / 1e9,
        )
