"""The loop's journal: which events belong to a tick, which phases it went through, and the records that say so.

Here: turning changes into events and packing them into hand-over records, at most one event a record. Not here: when a
tick happens and what is done in it (`loop`), the layout of a record (`handover`).
"""

from __future__ import annotations

from dataclasses import replace

from fri_client.handover.motion_phase import MotionPhase
from fri_client.handover.ring import Disposition, EventCode, HandoverRing
from fri_client.loop.link_statistics import LinkStatistics
from fri_client.loop.result import PhaseTicks
from fri_client.motion.program import MotionProgram, StopKind
from fri_client.motion.re_entry import BRIDGED_S
from fri_client.session.link_memory import LinkMemory
from fri_client.session.session import DropReason, Session

_EVENT_ONLY = int(Disposition.EVENT_ONLY)
_WAITING = int(MotionPhase.WAITING)


class Journal:
    """Keeps the events of the tick at hand and the list of phases; the list is bounded by phases and periods.

    tick counts fresh messages. stop_tick is the tick at which the motion was stopped or dropped, None before.
    held_back: answers of a motion that did not go out.
    """

    def __init__(self, ring: HandoverRing) -> None:
        self._ring = ring
        self._events: list[tuple[int, int, float, float]] = []
        self._phase = int(MotionPhase.WAITING)
        self._span = PhaseTicks(-1, -1, 0, 0)
        self._known_reason: object = None
        self._stop_kind: StopKind | None = None
        self._memory = LinkMemory()
        self._gap = self._told_held_back = 0
        self.held_back = 0
        self.spans: list[PhaseTicks] = []
        self.tick = 0
        self.stop_tick: int | None = None

    def event(self, code: EventCode, joint: int = 0, value: float = 0.0, limit: float = 0.0) -> None:
        """Note an event of this tick."""
        self._events.append((code, joint, float(value), float(limit)))

    def refused(self, session: Session) -> None:
        """Note that the message of this tick is refused; it rides in its record, before what was noted earlier."""
        why = (EventCode.REFUSED, session.refusal_joint, float(session.refusal_value), float(session.refusal or 0))
        self._events.insert(0, why)

    def stopped(self, sentence: str) -> None:
        """Note the tick and the sentence of a stop or a drop; of several the first tick stands."""
        if self.stop_tick is None:
            self.stop_tick = self.tick
        self._ring.publish_reason(sentence)

    def dropped(self, session: Session, now_ns: int) -> None:
        """Note the drop of the session, and put into it what the link did in the second before."""
        drop = session.drop
        assert drop is not None
        is_silence = drop.reason == DropReason.SILENCE
        gap = 0 if is_silence else session.gap  # the message that brought the drop is not in the memory yet
        recent = self._memory.recall(now_ns)
        # A silence is said already, and in lockstep this computer's clock tells nothing of the robot. Any other pause
        # that no robot spans is worth a word: of a computer that was held up nothing else tells.
        told = is_silence or session.clock.simulated or recent.pause_ms <= 1e3 * BRIDGED_S
        recent = replace(recent, missing=recent.missing + gap, pause_ms=0.0 if told else recent.pause_ms)
        drop = session.drop = replace(drop, recent=recent)
        self.event(EventCode.SESSION_DROP, drop.joint, drop.reason, drop.state_after)
        self.stopped(drop.sentence())

    def note_session(self, session: Session, receive_ns: int) -> None:
        """Events of a fresh message: changes of state and quality, messages missing before it."""
        self._gap = session.gap
        if session.state_changed:
            self.event(EventCode.STATE_CHANGE, 0, session.previous_state, session.state)
        if session.quality_changed:
            self.event(EventCode.QUALITY_CHANGE, 0, session.previous_quality, session.quality)
            self._memory.quality(receive_ns, session.previous_quality, session.quality)
        if session.gap:
            self.event(EventCode.GAP, 0, session.gap)

    def note_motion(self, motion: MotionProgram, phase: int, period: int) -> None:
        """Events of the motion: a new stop reason, a new phase; and the span of ticks each phase and period took."""
        reason = motion.stopping.reason
        if reason is not self._known_reason and reason is not None:
            self._known_reason = reason
            self.event(reason.code, reason.joint, reason.value, reason.limit)
            self.stopped(reason.sentence)
        if motion.stopping.kind is not self._stop_kind:
            self._stop_kind = motion.stopping.kind
            code = EventCode.STOP_ON_PATH if motion.stopping.kind == "path" else EventCode.STOP_IN_JOINT_SPACE
            self.event(code, 0, motion.stopping.duration_s, motion.stopping.rows)
        if phase != self._phase:
            self.event(EventCode.PHASE_CHANGE, 0, self._phase, phase)
            if self._phase == _WAITING:
                self._memory.forget_qualities()
            self._phase = phase
        span = self._span
        if phase != span.phase or (period != span.period and period >= 0):
            self._span = PhaseTicks(phase, period, self.tick, self.tick)
            self.spans.append(self._span)
        else:
            span.last_tick = self.tick

    def record(
        self,
        receive_ns: int,
        send_ns: int,
        phase: int,
        period: int,
        sample: int,
        datagram: memoryview | bytes,
        command: bytes | None,
        disposition: int,
    ) -> None:
        """Hand one record over; the first event rides in it, further ones follow in records without a datagram."""
        push, events = self._ring.push, self._events
        self._memory.tick(receive_ns, send_ns, self._gap, held_back=self.held_back - self._told_held_back)
        self._gap, self._told_held_back = 0, self.held_back
        if not events:
            push(receive_ns, send_ns, phase, period, sample, datagram, command, 0, 0, 0.0, 0.0, disposition)
            return
        push(receive_ns, send_ns, phase, period, sample, datagram, command, *events[0], disposition)
        for event in events[1:]:
            push(receive_ns, 0, phase, -1, -1, b"", None, *event, _EVENT_ONLY)
        events.clear()

    def record_events(self, now_ns: int, phase: int) -> None:
        """Hand over what is noted and belongs to no datagram."""
        if self._events:
            self.record(now_ns, 0, phase, -1, -1, b"", None, _EVENT_ONLY)

    def publish(
        self, now_ns: int, session: Session, motion: MotionProgram, statistics: LinkStatistics, late: int, foreign: int
    ) -> None:
        """Write the loop's status into the ring's header."""
        counts, reason = session.counts, motion.stopping.reason
        self._ring.publish_status(
            (
                now_ns,
                self.tick,
                motion.phase,
                motion.period,
                session.state,
                session.quality,
                counts.received,
                counts.answered,
                late,
                counts.missing,
                counts.duplicates,
                counts.stale,
                counts.refused,
                statistics.undecodable,
                EventCode.SESSION_DROP if session.drop is not None else 0 if reason is None else reason.code,
                foreign,
                motion.periods_completed,
            )
        )
