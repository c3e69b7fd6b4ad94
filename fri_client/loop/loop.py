"""The 1 kHz loop: receive, decode, judge, decide, encode, answer, hand over. One channel, one thread, one robot.

Here: the order of these steps in one tick, the polls for a stop, the time-outs, and the end. Not here: what each
step does (`codec`, `session`, `pilot`, `gate`, `handover`, `link_statistics`), real-time settings, processes, files.

Rules of a tick: the blocking receive paces it, with a finite time-out and no sleep; no log line, no disk, no lock;
nothing is kept but counters, so nothing grows; the answer leaves before the sample is handed over.

After a stall of this process the kernel holds a backlog of old messages. All of it is taken out and judged before
anything is decided, and only the newest message is answered: an answer to an older one would come too late to count,
and would reach the arm in the cycle of the newest. The others are recorded without an answer and without a place in a
period, and counted late.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NamedTuple

from fri_client.errors import CodecError
from fri_client.handover.last_samples import read_last_samples
from fri_client.handover.motion_phase import MotionPhase
from fri_client.handover.ring import Disposition, EventCode, HandoverRing
from fri_client.loop.answer_ahead import AnswerAhead
from fri_client.loop.channel import Address, Channel
from fri_client.loop.ending import MOST_FAULTS, Ending
from fri_client.loop.gate import CommandGate
from fri_client.loop.journal import Journal
from fri_client.loop.link_statistics import LinkStatistics
from fri_client.loop.peer import Peer
from fri_client.loop.pilot import Answer, Pilot
from fri_client.loop.rehearsal import Rehearsal
from fri_client.loop.result import LoopResult, LoopSettings, Outcome
from fri_client.loop.stop_watch import RecorderPatience, StopWatch
from fri_client.loop.version_evidence import VersionEvidence
from fri_client.messages import COMMAND_IDENTIFIER, CommandMessage, FriVersion, MessageHeader, MonitoringMessage
from fri_client.motion.program import MotionProgram, StopReason
from fri_client.session.session import Session
from fri_client.wire.codec import Codec
from safety.guard import Judged

_MOST_AT_ONCE = 256
"""Datagrams taken out of the channel before something is decided; its buffer holds fewer unless somebody floods it."""

_WAITING, _HOLD = int(MotionPhase.WAITING), int(MotionPhase.HOLD)
_LATCHED, _DONE = int(MotionPhase.LATCHED), int(MotionPhase.DONE)
_ENDINGS = (_WAITING, _LATCHED, _DONE)
_FRESH, _UNDECODABLE = int(Disposition.FRESH), int(Disposition.UNDECODABLE)


class _Newest(NamedTuple):
    """The newest message that may be answered: its bytes, its sender, its Disposition, when it was received, ns.

    due: an answer belongs to it, or to one before it that it stands for.
    """

    message: MonitoringMessage
    datagram: bytes
    address: Address
    disposition: int
    receive_ns: int
    due: bool


class FriLoop:
    """One run: construct, `run`, read the result; `stop_from_signal` may be called from a signal handler at any
    time.
    """

    def __init__(
        self,
        channel: Channel,
        version: FriVersion,
        make_motion: Callable[[float, int], MotionProgram],
        ring: HandoverRing,
        settings: LoopSettings,
        clock_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        """make_motion(command_period_s, samples_per_command) builds the motion; it may raise FriError or
        SafetyError. clock_ns: CLOCK_MONOTONIC, or a simulated one.
        """
        self._channel = channel
        self._clock_ns = clock_ns
        self._codec = Codec(version, learn_later=True)
        self._codec.warm_up()
        self._ring = ring
        self._settings = settings
        self._stop_watch = StopWatch(ring, settings.supervisor_timeout_s)
        self._journal = Journal(ring)
        self.session = Session()
        self.statistics = LinkStatistics()
        self._gate = CommandGate(channel, self.session.clock, clock_ns)
        self._peer = Peer(settings.robot_host)
        self._pilot = Pilot(make_motion, version, self.session, self._gate, ring.gate, self._peer, settings)
        self._buffer = bytearray(2048)
        self._view = memoryview(self._buffer)
        self._ahead = AnswerAhead(self._codec)
        self._rehearsal = Rehearsal(channel, self.session, self._gate, self._ahead, self._stop_watch, clock_ns)
        self._restarts = 0
        self._unanswered = 0
        self._silence_told = False
        self._unusable_ns = 0  # when the last message came that was refused or could not be read
        self._told_hindrance = ""
        self._versions = VersionEvidence(version)
        self._ending = Ending(self._pilot, self.session, self._gate, settings, self._journal, self._versions)
        self._faults = 0
        self._received: tuple[int, int] = (0, 0)  # bytes of the last datagram in the buffer, and when, ns
        self._recorder_patience = RecorderPatience(ring)

    def stop_from_signal(self, signal_number: int, frame: object = None) -> None:
        """A signal handler that asks for the stop ramp and returns."""
        del frame
        self._stop_watch.signal_number = signal_number

    @property
    def motion(self) -> MotionProgram:
        """The motion that is driven; another one once the robot has said its period."""
        return self._pilot.motion

    @property
    def refusal_exit_code(self) -> int | None:
        """Exit code of the error that made the motion impossible; None where there was none."""
        return None if self._pilot.refused is None else self._pilot.refused.exit_code

    def run(self) -> LoopResult:
        """Run until the motion is done, latched or never began; never raises for what a robot or an operator does.

        The ring stays open: its producer says `finish` once the report is written, so the recorder finds it.
        """
        receive, buffer, clock = self._channel.receive_into, self._buffer, self._clock_ns
        started = clock()
        outcome: Outcome | None = None
        while outcome is None:
            try:
                if self._ahead.is_ready:
                    size, received_ns = self._received
                    self._rehearsal.wait(self._view[:size], received_ns)
                size, address = receive(buffer)
            except BlockingIOError:
                now = clock()
                self._idle(now)
            else:
                now = clock()
                self._received = size, now
                try:
                    self._receive(size, address, now)
                except Exception as error:  # an arm in motion must not be abandoned for a bug in here
                    self._survive(error)
            if self.motion.phase in _ENDINGS or self._pilot.refused is not None or self._faults > MOST_FAULTS:
                unusable = self._unusable_ns > self.session.last_fresh_ns
                outcome = self._ending.outcome(now, started, self._faults, silent=self._silence_told, unusable=unusable)
        return self._conclude(outcome, started)

    # One tick.

    def _receive(self, size: int, address: Address, receive_ns: int) -> None:
        if address == self._peer.address:
            datagram = bytes(self._view[:size])
            command = self._ahead.command_for(datagram)
            if (
                command is not None
                and not self._stop_watch.is_asked
                and not self._channel.is_waiting()
                and self._answer_ahead(datagram, command, address, receive_ns)
            ):
                return
        self._receive_all(size, address, receive_ns)

    def _answer_ahead(self, datagram: bytes, command: bytes, address: Address, receive_ns: int) -> bool:
        """Send the answer that was made ready; False where this message has to go the whole way."""
        session, foreseen = self.session, self._ahead.foreseen
        if foreseen is None:
            return False
        message = None
        if session.clock.simulated:
            message = self._codec.decode_monitoring(datagram)
            moment = session.clock.next_moment(session.clock.time_of(message, receive_ns), self._ahead.counter)
            send_ns = None if moment is None else self._gate.send(foreseen.judged, command, address, moment)
        else:
            send_ns = self._gate.send_expected(command, address, receive_ns)
        if send_ns is None:
            return False
        # All that the answer did not have to wait for, and the proof that it was the right one.
        if send_ns:
            session.sent()
            self._pilot.take(foreseen, self._ahead.counter)
        message = message or self._codec.decode_monitoring(datagram)
        session.take_foreseen(message, receive_ns)
        self._journal.tick += 1
        self._journal.note_session(session, receive_ns)
        self._finish(_Newest(message, datagram, address, _FRESH, receive_ns, due=True), send_ns, command)
        return True

    def _receive_all(self, size: int, address: Address, receive_ns: int) -> None:
        """The datagram in the buffer and all that waits behind it; then one answer, to the newest message."""
        reason = self._stop_watch.poll(receive_ns)
        if reason is not None:
            self.motion.stop(reason)
        self._ahead.forget()
        newest: _Newest | None = None
        taken = 0
        while True:
            taken += 1
            newest = self._judge(bytes(self._view[:size]), address, receive_ns, newest)
            if not self._channel.is_waiting() or taken >= _MOST_AT_ONCE:
                break
            waiting = self._channel.receive_waiting_into(self._buffer)
            if waiting is None:
                break
            size, address = waiting
            receive_ns = self._clock_ns()
            self._received = size, receive_ns
        if newest is None:
            self._idle(receive_ns)
        elif taken >= _MOST_AT_ONCE:
            self._finish(newest, 0, None)
        else:
            self._answer(newest)
        self._codec.catch_up()

    def _judge(self, datagram: bytes, address: Address, receive_ns: int, before: _Newest | None) -> _Newest | None:
        """The newest message that may be answered, after this datagram; `before` is the one before it."""
        session = self.session
        peer = self._peer
        if not peer.may_be(address):
            return before
        try:
            message = self._codec.decode_monitoring(datagram)
        except CodecError as error:
            self._undecodable(datagram, error, receive_ns)
            return before
        if peer.address is None:
            session.clock.simulated = message.is_simulated_time
        disposition = session.judge(message, receive_ns)
        if disposition != _FRESH and not session.answer_due:
            self._not_fresh(disposition, datagram, receive_ns)
            return before
        peer.heard(address)  # whoever sends a whole message with seven positions that an arm can have
        if before is not None:
            self._unanswered += before.due
            self._finish(before, 0, None)
        self._journal.tick += 1
        self._journal.note_session(session, receive_ns)
        if session.drop is not None and self.motion.phase < _LATCHED:
            self._drop(receive_ns)
        due = session.answer_due or (before is not None and before.due)
        return _Newest(message, datagram, address, disposition, receive_ns, due)

    def _answer(self, newest: _Newest) -> None:
        session, codec, message = self.session, self._codec, newest.message
        counter = message.header.sequence_counter
        answer: Answer = None
        command: bytes | None = None
        send_ns = 0
        if newest.due:
            answer = self._pilot.decide(message, usable=newest.disposition == _FRESH)
        is_held_back = newest.due and answer is None and session.begun
        if answer is not None:
            position = answer.command if isinstance(answer, Judged) else answer.position
            if position is None:
                header = MessageHeader(COMMAND_IDENTIFIER, session.own_counter, counter)
                command = codec.encode_command(CommandMessage(header))
            else:
                command = codec.encode_position_command(session.own_counter, counter, position)
            if isinstance(answer, Judged):
                left_ns = self._gate.send(answer, command, newest.address, session.moment)
                send_ns, is_held_back = left_ns or 0, left_ns is None
            else:
                send_ns = self._gate.send_header(command, newest.address)
        if send_ns:
            session.sent()
            self._pilot.went_out(answer, counter)
        self._journal.held_back += is_held_back and session.drop is None
        self._finish(newest, send_ns, command)
        if newest.disposition == _FRESH:
            self._versions.note_readable(newest.datagram)
            self._ahead.learn(memoryview(newest.datagram), message)

    def _finish(self, newest: _Newest, send_ns: int, command: bytes | None) -> None:
        """The rest of a tick once the robot has its answer: book it, hand it over, and get ready for the next one."""
        session, journal, motion, message = self.session, self._journal, self.motion, newest.message
        receive_ns = newest.receive_ns
        counter = message.header.sequence_counter
        usable = newest.disposition == _FRESH
        phase, (period, sample) = motion.phase, self._pilot.label(counter) if usable else (-1, -1)
        if not usable:
            self._unusable_ns = receive_ns
            self._journal.refused(self.session)
            self._judge_silence(receive_ns)
        if session.counts.restarts != self._restarts:
            self._restarts = session.counts.restarts
            self.statistics.restart()
        self.statistics.observe(counter, receive_ns, send_ns, session.send_period_ms)
        journal.note_motion(motion, phase, period)
        sent = command if send_ns else None
        journal.record(receive_ns, send_ns, phase, period, sample, newest.datagram, sent, newest.disposition)
        if phase >= _HOLD and message.monitor_data is not None:
            motion.observe(message.monitor_data.measured_joint_position or ())
        self._publish(receive_ns)
        if session.clock.simulated:
            self._recorder_patience.wait()
        reason = self._stop_watch.poll(receive_ns)
        if reason is not None:
            motion.stop(reason)
        if usable and send_ns:
            self._ahead.prepare(session, motion, counter)
            if self._ahead.foreseen is not None and self._ahead.is_ready:
                self._gate.expect(self._ahead.foreseen.judged, self._ahead.counter)

    # Drops, faults, silence, and what is not fresh.

    def _drop(self, now: int) -> None:
        self._ahead.forget()
        clock = self.session.clock
        self.motion.latch(at_rest=self._gate.robot_stands(self.session.moment.cycle_ns if clock.simulated else now))
        self._journal.dropped(self.session, now)

    def _survive(self, error: Exception) -> None:
        self._faults += 1
        self._ahead.forget()
        sentence = f"Internal error in the loop ({type(error).__name__}: {error})."
        # The plainest stop there is: what failed may be what the other one needs.
        self.motion.stop(StopReason(EventCode.FAULT, sentence, path_is_good=False))

    def _idle(self, now: int) -> None:
        self._ahead.forget()
        reason = self._stop_watch.poll(now)
        if reason is not None:
            self.motion.stop(reason)
        self._judge_silence(now)
        self._journal.note_motion(self.motion, self.motion.phase, -1)
        self._journal.record_events(now, self.motion.phase)
        self._publish(now)

    def _judge_silence(self, now: int) -> None:
        session = self.session
        limit = self._settings.silence_s(simulated=session.clock.simulated)
        silence_ns = now - session.last_fresh_ns
        if not session.last_fresh_ns or silence_ns <= limit * 1e9:
            self._silence_told = False
            return
        # Nobody answers to a stop ramp in silence, so a stop that was asked for ends here as well.
        if self._silence_told:
            return
        self._silence_told = True
        session.note_silence(silence_ns / 1e9, limit)
        self.statistics.restart()
        self._journal.event(EventCode.SILENCE, 0, silence_ns / 1e9, limit)
        if session.drop is None:
            self._peer.release()  # before a motion
        elif self.motion.phase < _LATCHED:
            self._drop(now)

    def _not_fresh(self, disposition: int, datagram: bytes, now: int) -> None:
        session = self.session
        if disposition == Disposition.REFUSED:
            self._unusable_ns = now
            self._journal.refused(session)
        self._judge_silence(now)
        self._journal.record(now, 0, self.motion.phase, -1, -1, datagram, None, disposition)
        self._publish(now)

    def _undecodable(self, datagram: bytes, error: CodecError, now: int) -> None:
        self.statistics.observe_undecodable()
        self._unusable_ns = now
        self._versions.note_unreadable(datagram, error)
        self._judge_silence(now)
        self._journal.event(EventCode.UNDECODABLE, 0, len(datagram))
        self._journal.record(now, 0, self.motion.phase, -1, -1, datagram, None, _UNDECODABLE)
        self._publish(now)

    def _publish(self, now: int) -> None:
        if self._pilot.hindrance != self._told_hindrance:
            self._told_hindrance = self._pilot.hindrance
            self._ring.publish_hindrance(self._told_hindrance)
        late = self.statistics.late + self._unanswered
        self._journal.publish(now, self.session, self.motion, self.statistics, late, self._peer.foreign)

    # The end.

    def _conclude(self, outcome: Outcome, started_ns: int) -> LoopResult:
        now = self._clock_ns()
        result = self._ending.result(outcome, now, started_ns, self._peer.foreign)
        result.late = self.statistics.late + self._unanswered
        result.held_back = self._journal.held_back
        result.message_spacing_ms = None if self.session.clock.simulated else self.statistics.spacing_ms
        result.undecodable = self.statistics.undecodable
        if outcome != "completed":
            result.keep_last_samples(read_last_samples(self._ring, self._codec))
        self._ring.publish_reason(result.sentence)
        self._publish(now)
        return result
