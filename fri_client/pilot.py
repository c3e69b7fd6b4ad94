"""Which position goes into an answer: what the motion wants, the last one again, or none, so that the session mirrors.

Here: when a motion is prepared, when it may begin, and how many of the robot's cycles have passed since the last step.
Not here: bytes, sockets and time (`loop`), what a session state is answered with (`session`), the path (`motion`). The
loop asks for each message that it did not foresee, and tells what went out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from fri_client.errors import FriError
from fri_client.loop_result import LoopSettings
from fri_client.messages import MonitoringMessage, SessionState
from fri_client.motion import Foreseen, MotionProgram
from fri_client.motion_phase import MotionPhase
from fri_client.re_entry import BRIDGED_S
from fri_client.session import Session
from fri_client.start_gate import StartGate
from safety.errors import SafetyError

__all__ = ["Pilot"]

_WRAP = 0xFFFFFFFF
_WAITING, _LATCHED, _DONE = int(MotionPhase.WAITING), int(MotionPhase.LATCHED), int(MotionPhase.DONE)
_COMMANDING_WAIT, _ACTIVE = int(SessionState.COMMANDING_WAIT), int(SessionState.COMMANDING_ACTIVE)


class Pilot:
    """`decide` for a message, then `went_out` where the answer was sent; `take` does both for a foreseen one.

    motion: built for the period expected, anew for the one the robot states. hindrance: why no motion began in
    COMMANDING_ACTIVE. refused: the error that made the motion impossible.
    """

    def __init__(
        self,
        make_motion: Callable[[float, int], MotionProgram],
        session: Session,
        gate: StartGate,
        settings: LoopSettings,
    ) -> None:
        self._make_motion = make_motion
        self._session = session
        self._gate = gate
        self._maximum_ipo_distance_rad = settings.maximum_ipo_distance_rad
        self.motion = make_motion(settings.expected_period_s, 1)
        self._prepared_for = (settings.expected_period_s, 1)
        self._last_position: Sequence[float] | None = None
        self._advances = False
        self._advanced_at: int | None = None
        self.hindrance = ""
        self.refused: FriError | SafetyError | None = None

    def take(self, foreseen: Foreseen, counter: int, *, went_out: bool) -> None:
        """The foreseen command was the answer to the message of that counter."""
        self.motion.take(foreseen)
        self._last_position = foreseen.command
        if went_out:
            self._advanced_at = counter

    def went_out(self, counter: int) -> None:
        """What was decided last was sent in answer to the message of that counter."""
        if self._advances:
            self._advanced_at = counter

    def is_on_time(self, counter: int) -> bool:
        """Whether the robot has a new command for the message of that counter, so that the next step may follow."""
        return counter == self._advanced_at

    def robot_stands(self, counter: int) -> bool:
        """Whether more of the robot's cycles went by without a new command than it bridges, counted by its messages."""
        period_ms, command_ms = self._session.send_period_ms, self._session.command_period_ms
        if self._advanced_at is None or not period_ms or not command_ms:
            return False
        messages = counter - self._advanced_at & _WRAP
        return messages * period_ms - command_ms > BRIDGED_S * 1e3 and messages < 1 << 31

    def decide(self, message: MonitoringMessage, *, queued: bool, usable: bool) -> Sequence[float] | None:
        """The position the motion wants to send; None: what the session mirrors."""
        session, monitor = self._session, message.monitor_data
        if monitor is None or monitor.measured_joint_position is None:
            return None
        measured = monitor.measured_joint_position
        phase = self.motion.phase
        self._advances = False
        if phase == _WAITING:
            if not self._begin(message, measured, may_move=usable and not queued):
                return None
        elif session.state != _ACTIVE:
            return None
        elif queued or phase == _DONE:
            return self._last_position  # of a lost session too: its stop moves one step per cycle of the robot
        elif self.robot_stands(message.header.sequence_counter):
            self.motion.resume_from_rest()
        self._advances = True
        if phase == _LATCHED:
            self._last_position = self.motion.tick_latched(measured) if session.may_ramp_down else None
            return self._last_position
        self._last_position = self.motion.tick(measured, monitor.external_torque if usable else None)
        return self._last_position

    def _begin(self, message: MonitoringMessage, measured: Sequence[float], *, may_move: bool) -> bool:
        """Prepare the motion in COMMANDING_WAIT and begin it in COMMANDING_ACTIVE; True where it has begun."""
        session, ipo = self._session, message.ipo_data
        try:
            self._adapt()
            if session.state < _COMMANDING_WAIT or ipo is None or ipo.joint_position is None:
                return False
            self.motion.prepare(ipo.joint_position)
            cleared = self._gate.passes(ipo.joint_position, *self._prepared_for)
            if session.state != _ACTIVE or not may_move:
                return False
            self.hindrance = session.obstacle(message) or self._far_from_ipo(measured, ipo.joint_position)
            if not cleared and not self.hindrance:
                self.hindrance = "nobody has said yet that the start ramp is clear"
            if self.hindrance:
                return False
            session.begin_motion(message)
            self.motion.begin(ipo.joint_position)
        except (FriError, SafetyError) as error:
            self.refused = error
            return False
        return True

    def _adapt(self) -> None:
        """Build the motion for the command period the robot states, where it is not the one expected."""
        session = self._session
        if session.command_period_ms and session.send_period_ms:
            wanted = (session.command_period_ms / 1000.0, session.command_period_ms // session.send_period_ms)
            if wanted != self._prepared_for:
                self.motion = self._make_motion(*wanted)
                self._prepared_for = wanted

    def _far_from_ipo(self, measured: Sequence[float], ipo: Sequence[float]) -> str:
        """An arm that another client has led away from the IPO position would jump back to it."""
        limit = self._maximum_ipo_distance_rad
        for joint, (here, there) in enumerate(zip(measured, ipo, strict=True), start=1):
            if abs(here - there) > limit:
                return f"joint {joint} is {abs(here - there):.3f} rad from its IPO position ({limit:g} rad are allowed)"
        return ""
