"""When a run of the loop is over, as what, and what is reported of it."""

from __future__ import annotations

from fri_client.handover.motion_phase import MotionPhase
from fri_client.handover.ring import EventCode
from fri_client.loop.gate import CommandGate
from fri_client.loop.journal import Journal
from fri_client.loop.pilot import Pilot
from fri_client.loop.result import SIMULATED_SILENCE_S, LoopResult, LoopSettings, Outcome, explain
from fri_client.loop.stop_watch import ENDED_BY_SOMEBODY
from fri_client.loop.version_evidence import VersionEvidence
from fri_client.messages import SessionState
from fri_client.session.session import Session
from fri_client.session.session_drop import DropReason

MOST_FAULTS = 1
"""Internal errors that a run survives: with the first the arm ramps down."""

_DRAIN_S = 1.0
"""After a drop the loop listens on for a confirmed standstill, but not beyond this silence: see `_drain_s`."""

_IDLE = int(SessionState.IDLE)
_WAITING, _DONE = int(MotionPhase.WAITING), int(MotionPhase.DONE)
_ENDINGS = (_WAITING, int(MotionPhase.LATCHED), _DONE)


class Ending:
    """Asked after every tick; reads session, motion and gate, and changes none of them."""

    def __init__(
        self,
        pilot: Pilot,
        session: Session,
        gate: CommandGate,
        settings: LoopSettings,
        journal: Journal,
        versions: VersionEvidence,
    ) -> None:
        self._pilot = pilot
        self._session = session
        self._gate = gate
        self._settings = settings
        self._journal = journal
        self._versions = versions

    def outcome(self, now: int, started: int, faults: int, *, silent: bool, unusable: bool) -> Outcome | None:
        """The outcome once there is one. now, started: ns; silent: no message for longer than the settings allow;
        unusable: messages came since the last one that can be used.
        """
        motion, settings = self._pilot.motion, self._settings
        if self._pilot.refused is not None:
            return "refused"
        if faults > MOST_FAULTS:
            return "fault"
        if motion.phase not in _ENDINGS:
            return None
        if motion.phase == _WAITING:
            first = self._session.first_fresh_ns
            if not first and now - started > settings.start_timeout_s * 1e9:
                return "version_mismatch" if self._versions.has_unreadable else "no_robot"
            if settings.monitor_only:
                return self._monitored(now, unusable=unusable) if first else None
            waited = first and self._waited_ns(now, silent) > settings.command_timeout_s * 1e9
            return "not_started" if waited else None
        if motion.phase == _DONE:
            if motion.stopping.reason is None or (settings.monitor_only and self._was_ended()):
                return "completed"
            return "fault" if faults else "stopped"
        standstill = motion.standstill
        quiet = now - max(self._session.last_fresh_ns, self._gate.last_send_ns) > self._drain_s() * 1e9
        return "dropped" if standstill.confirmed or standstill.gave_up or quiet else None

    def _drain_s(self) -> float:
        """A robot in simulated time waits for an answer that does not come after a drop, and only then sends the next
        message; one that has closed the session or fallen silent is not expected to.
        """
        session, drop = self._session, self._session.drop
        gone = session.state == _IDLE or (drop is not None and drop.reason is DropReason.SILENCE)
        return SIMULATED_SILENCE_S if session.clock.simulated and not gone else _DRAIN_S

    def _monitored(self, now: int, *, unusable: bool) -> Outcome | None:
        """How a run that only records ends by itself: the robot ended a session in which it was answered, or fell
        silent. One whose messages cannot be used any more is still there, and what was to be recorded is not.
        """
        session = self._session
        if session.counts.answered and session.state == _IDLE:
            return "completed"
        if now - session.last_fresh_ns <= self._settings.silence_s(simulated=session.clock.simulated) * 1e9:
            return None
        return "dropped" if unusable else "completed"

    def _was_ended(self) -> bool:
        """Whether a run that lasts until somebody ends it was ended so, after the first message."""
        reason = self._pilot.motion.stopping.reason
        return reason is not None and reason.code in ENDED_BY_SOMEBODY and self._session.first_fresh_ns > 0

    def _waited_ns(self, now: int, silent: bool) -> int:
        """Since the first message; where the robot's time is simulated, its cycles and its last silence."""
        session = self._session
        if not session.clock.simulated:
            return now - session.first_fresh_ns
        silence_ns = now - session.last_fresh_ns if silent else 0
        return session.counts.fresh * (session.send_period_ms or 1) * 1_000_000 + silence_ns

    def result(self, outcome: Outcome, now: int, started: int, foreign: int) -> LoopResult:
        """What is reported of the run: event, sentence, standstill, times. The last events go to the journal.

        foreign: datagrams of senders that are not the robot. Counts and last samples are the caller's to add.
        """
        motion, journal = self._pilot.motion, self._journal
        standstill = motion.standstill
        if standstill.observed:
            code = EventCode.STANDSTILL_CONFIRMED if standstill.confirmed else EventCode.STANDSTILL_NOT_CONFIRMED
            journal.event(code, 0, standstill.spread, standstill.threshold_rad)
        elif outcome in ("no_robot", "not_started", "version_mismatch"):
            journal.event(EventCode.START_TIMEOUT, 0, (now - started) / 1e9)
        journal.note_motion(motion, motion.phase, -1)
        journal.record_events(now, motion.phase)
        result = explain(
            outcome,
            motion,
            self._session,
            self._settings,
            hindrance=self._pilot.hindrance,
            refused=self._pilot.refused,
            version=self._versions.mismatch() if outcome == "version_mismatch" else "",
        )
        if motion.stopping.reason is not None and result.reason == motion.stopping.reason.code.name:
            result.criterion = motion.stopping.reason.criterion
        if outcome == "no_robot" and foreign:
            host = self._settings.robot_host
            only = f": only {host} is listened to" if host else ""
            result.sentence += f" {foreign} datagram{'s' * (foreign != 1)} came from elsewhere{only}."
        result.stop_kind, result.stop_duration_s = motion.stopping.kind, motion.stopping.duration_s
        result.overruled = motion.stopping.overruled
        if motion.commanded and not standstill.confirmed:
            result.sentence += " The stop is NOT confirmed: fresh samples showed no standstill; look at the arm."
        result.sentence += self._versions.doubt()
        result.standstill_confirmed = standstill.confirmed
        result.tick = journal.stop_tick
        result.foreign = foreign
        result.duration_s = (now - started) / 1e9
        result.phases = journal.spans
        return result
