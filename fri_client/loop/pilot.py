"""What goes into an answer: a position of the motion, the robot's own one again, a bare header, or no answer at all.

Here: what each session state is answered with, when a motion is prepared and begins, what may still be sent after a
drop. Not here: bytes and sockets (`loop`), whether it may go out in this cycle of the robot (`gate`), the path
(`motion`).

Answers by state (PROTOCOL section 8). COMMANDING_WAIT: the IPO position, judged by the guard like every other position.
COMMANDING_ACTIVE before the motion begins: the same, as long as it stands still where the arm was commanded to; else no
answer, for a step to it would be a command that nobody planned. MONITORING_*: 1.x: the commanded joint position that
the robot just sent, as the vendor's client does, as long as the robot never commanded; afterwards, and in 2.x, a bare
header, for a position in a forged message must not reach an arm that moves. IDLE: nothing.

After a drop of the motion's session nothing resumes. What may still be sent is decided anew for each message:
- COMMANDING_ACTIVE at the same IPO position, with no longer pause since our last command than the robot bridges: the
  motion's stop, then its last position. Also after a message that claimed another state in between.
- After a longer pause the robot stands on our last command, or has left and come back somewhere else. No position is
  ever sent again in this run, not even the IPO position: it is where the motion began, perhaps radians away.
- A monitoring state gets a bare header, once such a pause is over. Before it, and in COMMANDING_WAIT: no answer.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

from fri_client.errors import FriError, RealRobot
from fri_client.handover.start_gate import StartGate
from fri_client.loop.gate import CommandGate, Pace
from fri_client.loop.ipo_watch import STILL_RAD, IpoWatch
from fri_client.loop.peer import Peer
from fri_client.loop.result import LoopSettings
from fri_client.messages import FriVersion, MonitoringMessage, OperationMode, SessionState, name_of
from fri_client.motion.program import Foreseen, MotionProgram
from fri_client.motion.stop_reason import NO_EXTERNAL_TORQUE
from fri_client.session.robot_counter import WRAP
from fri_client.session.session import Session
from safety.errors import SafetyError
from safety.guard import Judged

_IDLE, _COMMANDING_WAIT, _ACTIVE = (
    int(state) for state in (SessionState.IDLE, SessionState.COMMANDING_WAIT, SessionState.COMMANDING_ACTIVE)
)

LEFT_RUN = 10
"""Messages in a row in a monitoring state that prove that a robot which commanded has left: one may be damaged or
forged while the robot goes on. Until then the last command stays the reference of the next one."""


@dataclass(frozen=True, slots=True)
class Echo:
    """The answer to a monitoring state, which moves nothing: the robot's commanded position, rad, or a bare header."""

    position: tuple[float, ...] | None = None


HEADER: Final = Echo()

Answer = Judged | Echo | None
"""A position that the guard judged; an answer that moves nothing; no answer."""


def monitoring_echo(message: MonitoringMessage, version: FriVersion) -> Echo:
    """What the vendor's client answers in MONITORING_WAIT and MONITORING_READY (PROTOCOL section 8)."""
    monitor = message.monitor_data
    if version.major != 1 or monitor is None or monitor.commanded_joint_position is None:
        return HEADER
    return Echo(monitor.commanded_joint_position)


class Pilot:
    """`decide` for a message; where that is a position that went out, `went_out`. `take` for a foreseen one.

    motion: built for the period expected, anew for the one the robot states. hindrance: why no motion began in
    COMMANDING_ACTIVE. refused: the error that made the motion impossible.
    """

    def __init__(
        self,
        make_motion: Callable[[float, int], MotionProgram],
        version: FriVersion,
        session: Session,
        gate: CommandGate,
        start_gate: StartGate,
        peer: Peer,
        settings: LoopSettings,
    ) -> None:
        self._make_motion = make_motion
        self._version = version
        self._session = session
        self._gate = gate
        self._start_gate = start_gate
        self._peer = peer
        self._settings = settings
        self._prepared_for = (settings.expected_period_s, 1)
        self.motion = make_motion(*self._prepared_for)
        gate.use(self.motion.guard, *self._prepared_for)
        self._ipo = IpoWatch()
        self._ipo_at_begin: tuple[float, ...] = ()
        self._commanded = False  # the robot was seen in COMMANDING_ACTIVE
        self._commands_now = False  # and has not surely left since
        self._in_monitoring_for = 0  # answered messages in a row
        self._never_again = False
        self._is_step = False
        self._advanced_at: int | None = None
        self.hindrance = ""
        self.refused: FriError | SafetyError | None = None

    def take(self, foreseen: Foreseen, counter: int) -> None:
        """The foreseen command went out in answer to the message of that counter."""
        self.motion.commit(foreseen.judged)
        self._advanced_at = counter

    def went_out(self, answer: Answer, counter: int) -> None:
        """What was decided last was sent in answer to the message of that counter."""
        if self._is_step and isinstance(answer, Judged):
            self.motion.commit(answer)
            self._advanced_at = counter

    def label(self, counter: int) -> tuple[int, int]:
        """Period, and sample in it, of the message of that counter: counted by the robot from the message that the last
        command of the motion went out to, up to the next one's turn; -1, -1 where it belongs to none.
        """
        motion = self.motion
        if self._advanced_at is None or motion.period < 0:
            return -1, -1
        later = counter - self._advanced_at & WRAP
        return (motion.period, motion.sample_in_period + later) if later < self._prepared_for[1] else (-1, -1)

    def decide(self, message: MonitoringMessage, *, usable: bool) -> Answer:
        """The answer to the newest message, which the session has just judged; usable: as a sample, too."""
        session, monitor = self._session, message.monitor_data
        self._is_step = False
        if session.state == _IDLE or monitor is None or monitor.measured_joint_position is None:
            return None
        is_adapted = session.begun or self._adapt()
        pace = self._gate.pace(session.moment)
        if pace == Pace.STANDS and session.drop is not None:
            self._never_again = True
        if session.state < _COMMANDING_WAIT:
            return self._in_monitoring(message, pace)
        ipo = message.ipo_data
        if ipo is None or ipo.joint_position is None or not is_adapted:
            return None
        self._in_monitoring_for = 0
        measured = monitor.measured_joint_position
        if session.state == _ACTIVE:
            self._commanded = self._commands_now = True
        if session.drop is not None:
            return self._after_drop(measured, ipo.joint_position, pace)
        if not session.begun:
            self._ipo.observe(ipo.joint_position, message.header.sequence_counter, (session.send_period_ms or 0) * 1e-3)
            begins = self.motion.waits and not self._settings.monitor_only
            if not (begins and self._begin(message, measured, ipo.joint_position, may_move=usable)):
                return self._mirror(ipo.joint_position, pace)
        elif pace == Pace.STANDS:
            self.motion.resume_from_rest()
        if pace == Pace.TOO_EARLY or pace == Pace.UNCLEAR:
            return None
        self._is_step = True
        if usable and self._unwatched(message):
            self.motion.stop(NO_EXTERNAL_TORQUE)
        return self.motion.propose(measured, monitor.external_torque if usable else None)

    def _in_monitoring(self, message: MonitoringMessage, pace: Pace) -> Answer:
        if self._session.begun:
            return HEADER if pace == Pace.STANDS or self._never_again else None
        self._in_monitoring_for += 1
        has_left = self._in_monitoring_for >= LEFT_RUN and pace in (Pace.FIRST, Pace.STANDS)
        if has_left or not self._commanded:
            self._commands_now = False
            self._gate.forget()
        self._ipo.reset()
        return HEADER if self._commanded else monitoring_echo(message, self._version)

    def _after_drop(self, measured: Sequence[float], ipo: tuple[float, ...], pace: Pace) -> Answer:
        """The stop of a motion whose session was lost, for as long as it is sure where the robot is."""
        session = self._session
        if self._never_again or session.state != _ACTIVE or ipo != self._ipo_at_begin or pace != Pace.NEXT:
            return None
        self._is_step = True
        return self.motion.propose(measured)

    def _mirror(self, ipo: tuple[float, ...], pace: Pace) -> Answer:
        """The IPO position as an answer, if the guard finds it good after the last command; None otherwise.

        Once commands move the arm, only if it is the position on which the arm was last commanded to stand.
        """
        guard = self.motion.guard
        if not guard.anchored or pace == Pace.FIRST or (pace == Pace.STANDS and not self._commanded):
            if self._commands_now and not self._ipo.is_still:
                return None
            guard.anchor(ipo)
        elif pace == Pace.STANDS:
            guard.come_to_rest()
        if self._commanded and not (guard.at_rest and guard.repeats(ipo, STILL_RAD)):
            return None
        judged = guard.examine(guard.command if self._commanded else ipo, None, stopping=True)
        return judged if isinstance(judged, Judged) else None

    def _begin(
        self, message: MonitoringMessage, measured: Sequence[float], ipo: tuple[float, ...], *, may_move: bool
    ) -> bool:
        """Prepare the motion in COMMANDING_WAIT and begin it in COMMANDING_ACTIVE; True where it has begun."""
        session, guard = self._session, self.motion.guard
        try:
            if self._settings.fake_robot_only and not message.is_of_fake_robot:
                raise RealRobot
            self.motion.prepare(ipo)
            cleared = self._start_gate.passes(ipo, *self._prepared_for)
            if session.state != _ACTIVE or not may_move:
                return False
            self.hindrance = (
                session.obstacle(message) or self._wrong_mode(message) or self._peer.doubt
                or self._unwatched(message) or self._ipo.clause() or self._far_from_ipo(measured, ipo)
            )  # fmt: skip
            if not self.hindrance and not (guard.anchored and guard.repeats(ipo, STILL_RAD)):
                self.hindrance = "the robot's own position (IPO) was not mirrored yet"
            if not session.clock.is_settled and not self.hindrance:
                self.hindrance = "too few messages came yet to know the robot's clock"
            if not cleared and not self.hindrance:
                self.hindrance = "the check of the start ramp is not done yet"
            if self.hindrance:
                return False
            only, never = self._settings.test_mode_only, bool(self._settings.too_fast_for_t1)
            session.begin_motion(message, test_mode_only=only, never_in_t1=never)
            self._ipo_at_begin = ipo
            self.motion.begin(ipo)
        except (FriError, SafetyError) as error:
            self.refused = error
            return False
        return True

    def _adapt(self) -> bool:
        """Build the motion for the command period the robot states, where it is another; False where there is none, or
        where the robot may stand on a position of ours: then it has not begun anew, whatever the message says.
        """
        session = self._session
        if session.command_period_ms and session.send_period_ms:
            wanted = (session.command_period_ms / 1000.0, session.command_period_ms // session.send_period_ms)
            if wanted != self._prepared_for:
                if self._gate.is_followed:
                    return False
                try:
                    self.motion = self._make_motion(*wanted)
                except (FriError, SafetyError) as error:
                    self.refused = error
                    return False
                self._gate.use(self.motion.guard, *wanted)
                self._prepared_for = wanted
        return True

    def _wrong_mode(self, message: MonitoringMessage) -> str:
        """The first run of a motion on an arm is one in T1, and none is that is too fast for it; a robot that does not
        say its mode cannot be held to it.
        """
        mode = None if message.robot_info is None else message.robot_info.operation_mode
        if mode == OperationMode.TEST_MODE_1:
            return self._settings.too_fast_for_t1
        if not self._settings.test_mode_only or mode is None:
            return ""
        return (
            f"the first run of a motion on an arm is driven in T1, and the robot is in {name_of(OperationMode, mode)}"
        )

    def _unwatched(self, message: MonitoringMessage) -> str:
        """A limit on external torque protects nothing where the robot sends none."""
        monitor = message.monitor_data
        if not self.motion.watches_external_torque or monitor is None or monitor.external_torque is not None:
            return ""
        return (
            "the robot sends no external torque, which is to be watched; without a watch a configuration says "
            "external_torque_limit: null"
        )

    def _far_from_ipo(self, measured: Sequence[float], ipo: Sequence[float]) -> str:
        """An arm that another client has led away from the IPO position would jump back to it."""
        limit = self._settings.maximum_ipo_distance_rad
        for joint, (here, there) in enumerate(zip(measured, ipo, strict=True), start=1):
            if abs(here - there) > limit:
                return f"joint {joint} is {abs(here - there):.3f} rad from its IPO position ({limit:g} rad are allowed)"
        return ""
