"""The 1 kHz loop: receive, decode, judge, decide, encode, answer, hand over. One socket, one thread, one robot.

Here: the order of these steps in one tick, the polls for a stop, the time-outs, and the end. Not here: what each
step does (`codec`, `session`, `motion`, `handover`, `link_statistics`), real-time settings, processes, files. The
loop process calls `FriLoop.run` once.

Rules of a tick: the blocking receive paces it, with a finite time-out and no sleep; no log line, no disk, no lock;
nothing is kept but counters, so nothing grows; the answer leaves before the sample is handed over.

After a stall of this process the kernel holds a backlog of old messages. Each is answered, in order, because
answers are what the robot grades the connection by; but only the newest advances the path. The robot applies the
last command that reached it in a cycle, so an advance per queued message would reach it as one large step. The
answers to the older ones repeat the last command, are counted late, and their samples carry no place in a period.
"""

from __future__ import annotations

import select
import socket
import struct
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from fri_client.codec import MAXIMUM_DATAGRAM_BYTES, Codec
from fri_client.errors import CodecError, FriError
from fri_client.handover import Disposition, EventCode, HandoverRing
from fri_client.link_statistics import LinkStatistics
from fri_client.messages import (
    COMMAND_IDENTIFIER,
    CommandMessage,
    FriVersion,
    MessageHeader,
    MonitoringMessage,
    SessionState,
)
from fri_client.motion import MotionPhase, MotionProgram, StopReason
from fri_client.session import Session
from fri_client.session_drop import DropReason
from safety.errors import SafetyError

__all__ = ["FriLoop", "LoopOutcome", "LoopResult", "LoopSettings", "PhaseTicks", "open_socket"]

RECEIVE_BUFFER_BYTES = 64 * 1024
"""Of the socket: some 50 messages, 50 ms at 1 kHz. More would only keep what is too old to be worth an answer."""

_POLL_S = 0.05
"""Longest single wait in the receive, so that signals and requests are seen while the robot is silent."""

_DRAIN_S = 1.0
"""After a drop the loop listens on for a confirmed standstill, but not beyond this silence."""

_CONSUMER_PATIENCE_S = 2.0

_WAITING, _HOLD = int(MotionPhase.WAITING), int(MotionPhase.HOLD)
_LATCHED, _DONE = int(MotionPhase.LATCHED), int(MotionPhase.DONE)
_FRESH = int(Disposition.FRESH)
_ACTIVE = int(SessionState.COMMANDING_ACTIVE)
_COMMANDING_WAIT = int(SessionState.COMMANDING_WAIT)


class LoopOutcome:
    """How a run of the loop ended; the texts are those of the loop report."""

    COMPLETED = "completed"
    STOPPED = "stopped"
    DROPPED = "dropped"
    NO_ROBOT = "no_robot"
    NOT_STARTED = "not_started"
    VERSION_MISMATCH = "version_mismatch"
    REFUSED = "refused"
    FAULT = "fault"


@dataclass(frozen=True, slots=True)
class LoopSettings:
    """Time-outs in s and whom to listen to.

    receive_timeout_s: silence that drops a moving session. start_timeout_s: wait for the first message.
    command_timeout_s: from there to COMMANDING_ACTIVE. supervisor_timeout_s: age of the supervisor's heartbeat that
    stops the motion, 0: not watched. robot_host: the only address listened to; None: that of the first message.
    expected_period_s: command period the motion is prepared for before the robot has said its own.
    simulated_time: the robot waits for each answer, so the loop may wait for a recorder that falls behind.
    """

    receive_timeout_s: float = 0.5
    start_timeout_s: float = 30.0
    command_timeout_s: float = 60.0
    supervisor_timeout_s: float = 2.0
    robot_host: str | None = None
    expected_period_s: float = 0.001
    maximum_ipo_distance_rad: float = 0.1
    simulated_time: bool = False


@dataclass(slots=True)
class PhaseTicks:
    """A stretch of ticks (handed-over records of fresh samples) in one phase and period."""

    phase: int
    period: int
    first_tick: int
    last_tick: int


@dataclass(slots=True)
class LoopResult:
    """How the loop ended: outcome (LoopOutcome), the event behind it, one sentence, its joint (from 1) and numbers."""

    outcome: str
    reason: str
    sentence: str
    joint: int | None = None
    value: float | None = None
    limit: float | None = None
    tick: int | None = None
    standstill_confirmed: bool = False
    late: int = 0
    foreign: int = 0
    undecodable: int = 0
    duration_s: float = 0.0
    phases: list[PhaseTicks] = field(default_factory=list)


def open_socket(host: str, port: int) -> socket.socket:
    """A bound UDP socket for the loop. Raises OSError (EADDRINUSE when another program holds the port)."""
    channel = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        channel.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
        # The kernel's own time-out leaves the socket blocking: one system call per receive instead of poll and receive.
        seconds, fraction = divmod(_POLL_S, 1.0)
        channel.setsockopt(
            socket.SOL_SOCKET, socket.SO_RCVTIMEO, struct.pack("@ll", int(seconds), int(fraction * 1_000_000))
        )
        channel.bind((host, port))
    except BaseException:
        channel.close()
        raise
    return channel


class FriLoop:
    """One run: construct, `run`, read the result; `stop_from_signal` may be called from a signal handler at any
    time.
    """

    def __init__(
        self,
        channel: socket.socket,
        version: FriVersion,
        make_motion: Callable[[float, int], MotionProgram],
        ring: HandoverRing,
        settings: LoopSettings,
    ) -> None:
        """make_motion(command_period_s, samples_per_command) builds the motion; it may raise FriError or
        SafetyError.
        """
        self._channel = channel
        self._codec = Codec(version)
        self._make_motion = make_motion
        self._ring = ring
        self._settings = settings
        self.session = Session(version)
        self.statistics = LinkStatistics()
        self.motion = make_motion(settings.expected_period_s, 1)
        self._prepared_for = (settings.expected_period_s, 1)
        self._buffer = bytearray(2048)
        self._view = memoryview(self._buffer)
        self._robot: tuple[str, int] | None = None
        self._signal = 0
        self._faults = 0
        self._tick = 0
        self._restarts = 0
        self._repeated = 0
        self._foreign = 0
        self._last_receive_ns = 0
        self._last_position: Sequence[float] | None = None
        self._known_stop: StopReason | None = None
        self._stop_tick: int | None = None
        self._silence_told = False
        self._phase_seen = _WAITING
        self._span = PhaseTicks(-1, -1, 0, 0)
        self._spans: list[PhaseTicks] = []  # one per phase and period: bounded by the request
        self._events: list[tuple[int, int, float, float]] = []
        self._hindrance = ""
        self._undecodable_sample = b""
        self._undecodable_error = ""
        self._refused: FriError | SafetyError | None = None
        self._poll = select.poll()
        self._poll.register(channel, select.POLLIN)
        self._patience_spent_at = -1

    def stop_from_signal(self, signal_number: int, frame: object = None) -> None:
        """A signal handler that asks for the stop ramp and returns."""
        del frame
        self._signal = signal_number

    def run(self) -> LoopResult:
        """Run until the motion is done, latched or never began; never raises for what a robot or an operator does."""
        channel, buffer = self._channel, self._buffer
        clock = time.monotonic_ns
        started = clock()
        first_message_ns = 0
        settings = self._settings
        start_limit = int(settings.start_timeout_s * 1e9)
        command_limit = int(settings.command_timeout_s * 1e9)
        outcome: str | None = None
        while outcome is None:
            try:
                size, address = channel.recvfrom_into(buffer)
            except BlockingIOError:
                now = clock()
                self._idle(now)
            else:
                now = clock()
                try:
                    self._receive(size, address, now)
                except Exception as error:  # an arm in motion must not be abandoned for a bug in here
                    self._survive(error)
            if self._refused is not None:
                outcome = LoopOutcome.REFUSED
            elif self._faults > 1:
                outcome = LoopOutcome.FAULT
            elif self.motion.phase == _WAITING:
                if not first_message_ns:
                    first_message_ns = self.session.last_fresh_ns
                if not first_message_ns:
                    if now - started > start_limit:
                        outcome = LoopOutcome.VERSION_MISMATCH if self._undecodable_sample else LoopOutcome.NO_ROBOT
                elif now - first_message_ns > command_limit:
                    outcome = LoopOutcome.NOT_STARTED
            elif self.motion.phase == _DONE:
                outcome = LoopOutcome.COMPLETED if self.motion.stop_reason is None else LoopOutcome.STOPPED
            elif self.motion.phase == _LATCHED and self._latched_long_enough(now):
                outcome = LoopOutcome.DROPPED
        return self._conclude(outcome, started)

    # One tick.

    def _receive(self, size: int, address: tuple[str, int], receive_ns: int) -> None:
        if address != self._robot and not self._is_robot(address):
            self._foreign += 1
            return
        datagram = self._view[:size]
        session, statistics = self.session, self.statistics
        self._poll_stops(receive_ns)
        try:
            message = self._codec.decode_monitoring(datagram)
        except CodecError as error:
            self._undecodable(datagram, error, receive_ns)
            return
        if self._robot is None:
            self._robot = address
        disposition = session.judge(message, receive_ns)
        if disposition != _FRESH:
            self._not_fresh(disposition, message, datagram, receive_ns)
            return
        self._tick += 1
        motion = self.motion
        queued = self._is_queued(receive_ns)
        command: bytes | None = None
        send_ns = 0
        label_period = label_sample = -1
        if session.drop is not None and motion.phase != _LATCHED and motion.phase != _DONE:
            self._drop()
        if session.answer_due:
            wanted = self._decide(message, queued)
            chosen = session.answer_position(message, wanted)
            counter = message.header.sequence_counter
            if chosen is not None:
                command = self._codec.encode_position_command(session.own_counter, counter, chosen)
            else:
                command = self._codec.encode_command(
                    CommandMessage(MessageHeader(COMMAND_IDENTIFIER, session.own_counter, counter))
                )
            try:
                self._channel.sendto(command, address)
            except OSError:
                command = None  # the network refused this one; the robot counts it as lost, and so does the log
            else:
                send_ns = time.monotonic_ns()
                session.sent()
        elif motion.phase != _WAITING:
            motion.skip()
        motion = self.motion
        if not queued:
            label_period, label_sample = motion.period, motion.sample_in_period
        phase = motion.phase
        if session.counts.restarts != self._restarts:
            self._restarts = session.counts.restarts
            statistics.restart()
        statistics.observe(message.header.sequence_counter, receive_ns, send_ns, session.send_period_ms)
        self._note_changes(phase, label_period)
        monitor = message.monitor_data
        if monitor is not None and monitor.measured_joint_position is not None:
            motion.observe(monitor.measured_joint_position)
        self._push(receive_ns, send_ns, phase, label_period, label_sample, datagram, command, _FRESH)
        self._publish(receive_ns)
        if self._settings.simulated_time:
            self._wait_for_consumer()

    def _decide(self, message: MonitoringMessage, queued: bool) -> Sequence[float] | None:
        """What the motion wants to send; None: the session's mirror."""
        session, motion = self.session, self.motion
        phase = motion.phase
        monitor, ipo = message.monitor_data, message.ipo_data
        if monitor is None or monitor.measured_joint_position is None:
            return None
        measured = monitor.measured_joint_position
        if phase == _WAITING:
            if not self._adapt() or session.state < _COMMANDING_WAIT or ipo is None or ipo.joint_position is None:
                return None
            try:
                self.motion.prepare(ipo.joint_position)
                if session.state != _ACTIVE or queued:
                    return None
                self._hindrance = session.obstacle(message) or self._far_from_ipo(measured, ipo.joint_position)
                if self._hindrance:
                    return None
                session.begin_motion(message)
                self.motion.begin(ipo.joint_position)
            except (FriError, SafetyError) as error:
                self._refused = error
                return None
        elif session.state != _ACTIVE:
            return None
        motion = self.motion
        if phase == _LATCHED:
            wanted = motion.tick_latched(measured) if session.may_ramp_down else None
        elif queued or phase == _DONE:
            return self._last_position
        else:
            wanted = motion.tick(measured, monitor.external_torque)
        self._last_position = wanted
        return wanted

    def _adapt(self) -> bool:
        """Build the motion for the command period the robot states, where it is not the one expected."""
        session = self.session
        if session.command_period_ms is None or session.send_period_ms is None or not session.send_period_ms:
            return True
        wanted = (session.command_period_ms / 1000.0, session.command_period_ms // session.send_period_ms)
        if wanted != self._prepared_for:
            try:
                self.motion = self._make_motion(*wanted)
            except (FriError, SafetyError) as error:
                self._refused = error
                return False
            self._prepared_for = wanted
        return True

    def _far_from_ipo(self, measured: Sequence[float], ipo: Sequence[float]) -> str:
        limit = self._settings.maximum_ipo_distance_rad
        for joint, (here, there) in enumerate(zip(measured, ipo, strict=True), start=1):
            if abs(here - there) > limit:
                return (
                    f"joint {joint} is {abs(here - there):.3f} rad away from its IPO position ({limit:g} rad allowed)"
                )
        return ""

    def _is_queued(self, receive_ns: int) -> bool:
        """True when another datagram waits already, so that this one is late. Asked only after an uneven interval."""
        interval = receive_ns - self._last_receive_ns
        self._last_receive_ns = receive_ns
        period = (self.session.send_period_ms or 1) * 1_000_000
        if 6 * period < 10 * interval < 15 * period or not self._poll.poll(0):
            return False
        self._repeated += 1
        return True

    # Stops and drops.

    def _poll_stops(self, now: int) -> None:
        ring = self._ring
        if self._signal and self.motion.stop_reason is None:
            self.motion.stop(
                StopReason(EventCode.SIGNAL_STOP, f"Signal {self._signal} asked for a stop.", 0, self._signal)
            )
        request = ring.stop_request
        if request:
            self._stop_on_request(request)
        heartbeat = ring.heartbeat_ns
        limit = self._settings.supervisor_timeout_s
        if heartbeat and limit and now - heartbeat > limit * 1e9:
            age = (now - heartbeat) / 1e9
            self.motion.stop(
                StopReason(
                    EventCode.SUPERVISOR_LOST,
                    f"The supervising process gave no sign of life for {age:.1f} s ({limit:g} s allowed).",
                    0,
                    age,
                    limit,
                )
            )
        if ring.consumer_stalled:
            self.motion.stop(
                StopReason(
                    EventCode.RECORDER_LOST,
                    f"The recorder is {ring.backlog} of {ring.slots} records behind, so samples would soon be lost.",
                    0,
                    ring.backlog,
                    ring.slots * 0.8,
                )
            )

    def _stop_on_request(self, request: int) -> None:
        try:
            code = EventCode(request)
        except ValueError:
            code = EventCode.OPERATOR_STOP
        if not code.is_stop_reason:
            code = EventCode.OPERATOR_STOP
        self.motion.stop(StopReason(code, _REQUEST_SENTENCES.get(code, f"A stop was asked for ({code.name}).")))

    def _drop(self) -> None:
        drop = self.session.drop
        assert drop is not None
        self.motion.latch(at_rest=drop.reason in (DropReason.SILENCE, DropReason.COUNTER_RESTART))
        self._stop_tick = self._tick
        self._events.append((EventCode.SESSION_DROP, drop.joint, float(drop.reason), float(drop.state_after)))
        self._ring.publish_reason(drop.sentence())

    def _latched_long_enough(self, now: int) -> bool:
        standstill = self.motion.standstill
        return standstill.confirmed or standstill.gave_up or now - self.session.last_fresh_ns > _DRAIN_S * 1e9

    def _survive(self, error: Exception) -> None:
        self._faults += 1
        self.motion.stop(StopReason(EventCode.FAULT, f"Internal error in the loop: {type(error).__name__}: {error}."))
        self._ring.publish_reason(f"Internal error in the loop: {type(error).__name__}: {error}.")

    # Silence and what is not fresh.

    def _idle(self, now: int) -> None:
        self._poll_stops(now)
        self._judge_silence(now)
        if self._events or self.motion.phase != self._phase_seen:
            self._note_changes(self.motion.phase, -1)
            self._push(now, 0, self.motion.phase, -1, -1, b"", None, int(Disposition.EVENT_ONLY))
        self._publish(now)

    def _judge_silence(self, now: int) -> None:
        session = self.session
        silence = now - session.last_fresh_ns
        limit = self._settings.receive_timeout_s
        if not session.last_fresh_ns or silence <= limit * 1e9:
            self._silence_told = False
            return
        if self._silence_told:
            return
        self._silence_told = True
        session.note_silence(silence / 1e9, limit)
        self.statistics.restart()
        self._events.append((EventCode.SILENCE, 0, silence / 1e9, limit))
        if session.drop is not None and self.motion.phase not in (_LATCHED, _DONE):
            self._drop()
        elif session.drop is None:
            self._robot = None  # before a motion the robot may come back from another port

    def _not_fresh(self, disposition: int, message: MonitoringMessage, datagram: memoryview, now: int) -> None:
        session = self.session
        if disposition == Disposition.REFUSED:
            self._events.append((EventCode.REFUSED, session.refusal_joint, session.refusal_value, 0.0))
        else:
            self.statistics.observe(message.header.sequence_counter, now, 0, session.send_period_ms)
        self._judge_silence(now)
        self._push(now, 0, self.motion.phase, -1, -1, datagram, None, disposition)
        self._publish(now)

    def _undecodable(self, datagram: memoryview, error: CodecError, now: int) -> None:
        self.statistics.observe_undecodable()
        if not self._undecodable_sample:
            self._undecodable_sample = bytes(datagram[:MAXIMUM_DATAGRAM_BYTES])
            self._undecodable_error = str(error)
        self._judge_silence(now)
        self._events.append((EventCode.UNDECODABLE, 0, float(len(datagram)), 0.0))
        self._push(now, 0, self.motion.phase, -1, -1, datagram, None, int(Disposition.UNDECODABLE))
        self._publish(now)

    def _is_robot(self, address: tuple[str, int]) -> bool:
        """Whether an address that is not the robot's known one may be it: none is known yet, and the host fits."""
        host = self._settings.robot_host
        return self._robot is None and (host is None or address[0] == host)

    # Records and status.

    def _note_changes(self, phase: int, period: int) -> None:
        """Turn what changed in this tick into events, and keep the list of phases."""
        session, events = self.session, self._events
        if session.state_changed and session.last_fresh_ns == self._last_receive_ns:
            events.append((EventCode.STATE_CHANGE, 0, float(session.previous_state), float(session.state)))
        if session.quality_changed and session.last_fresh_ns == self._last_receive_ns:
            events.append((EventCode.QUALITY_CHANGE, 0, float(session.previous_quality), float(session.quality)))
        if session.gap and session.last_fresh_ns == self._last_receive_ns:
            events.append((EventCode.GAP, 0, float(session.gap), 0.0))
        reason = self.motion.stop_reason
        if reason is not None and reason is not self._known_stop:
            self._known_stop = reason
            if self._stop_tick is None:
                self._stop_tick = self._tick
            events.append((reason.code, reason.joint, float(reason.value), float(reason.limit)))
            self._ring.publish_reason(reason.sentence)
        if phase != self._phase_seen:
            events.append((EventCode.PHASE_CHANGE, 0, float(self._phase_seen), float(phase)))
            self._phase_seen = phase
        span = self._span
        if phase != span.phase or (period != span.period and period >= 0):
            self._span = PhaseTicks(phase, period, self._tick, self._tick)
            self._spans.append(self._span)
        else:
            span.last_tick = self._tick

    def _push(
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
        """Hand one record over; the first event rides in it, further ones follow in records of their own."""
        events = self._events
        if not events:
            self._ring.push(receive_ns, send_ns, phase, period, sample, datagram, command, disposition=disposition)
            return
        self._ring.push(receive_ns, send_ns, phase, period, sample, datagram, command, *events[0], disposition)
        for event in events[1:]:
            self._ring.push(receive_ns, 0, phase, -1, -1, b"", None, *event, int(Disposition.EVENT_ONLY))
        events.clear()

    def _publish(self, now: int) -> None:
        session, statistics, motion = self.session, self.statistics, self.motion
        counts = session.counts
        reason = motion.stop_reason
        self._ring.publish_status(
            (
                now,
                self._tick,
                motion.phase,
                motion.period,
                session.state,
                session.quality,
                counts.received,
                counts.answered,
                statistics.late + self._repeated,
                counts.missing,
                counts.duplicates,
                counts.stale,
                counts.refused,
                statistics.undecodable,
                EventCode.SESSION_DROP if session.drop is not None else 0 if reason is None else reason.code,
                self._foreign,
            )
        )

    def _wait_for_consumer(self) -> None:
        """In simulated time only: let the recorder catch up when the ring is half full, unless it does not move at
        all.
        """
        ring = self._ring
        half = ring.slots // 2
        backlog = ring.backlog
        if backlog <= half or ring.produced - backlog == self._patience_spent_at:
            return
        consumed = ring.produced - backlog
        deadline = time.monotonic() + _CONSUMER_PATIENCE_S
        while (backlog := ring.backlog) > half:
            if time.monotonic() > deadline:
                now_consumed = ring.produced - backlog
                if now_consumed == consumed:
                    self._patience_spent_at = now_consumed
                    return
                consumed, deadline = now_consumed, time.monotonic() + _CONSUMER_PATIENCE_S
            time.sleep(0.001)

    # The end.

    def _conclude(self, outcome: str, started_ns: int) -> LoopResult:
        now = time.monotonic_ns()
        motion, session = self.motion, self.session
        confirmed = motion.standstill.confirmed
        if motion.phase in (_DONE, _LATCHED) and motion.standstill.observed:
            code = EventCode.STANDSTILL_CONFIRMED if confirmed else EventCode.STANDSTILL_NOT_CONFIRMED
            self._events.append((code, 0, motion.standstill.spread, motion.standstill.threshold_rad))
        elif outcome in (LoopOutcome.NO_ROBOT, LoopOutcome.NOT_STARTED, LoopOutcome.VERSION_MISMATCH):
            self._events.append((EventCode.START_TIMEOUT, 0, (now - started_ns) / 1e9, 0.0))
        self._note_changes(motion.phase, -1)
        if self._events:
            self._push(now, 0, motion.phase, -1, -1, b"", None, int(Disposition.EVENT_ONLY))
        result = self._explain(outcome)
        result.standstill_confirmed = confirmed
        result.tick = self._stop_tick
        result.late = self.statistics.late + self._repeated
        result.foreign = self._foreign
        result.undecodable = self.statistics.undecodable
        result.duration_s = (now - started_ns) / 1e9
        result.phases = self._spans
        if motion.phase in (_DONE, _LATCHED) and session.counts.fresh and motion.commanded and not confirmed:
            result.sentence += " The stop is NOT confirmed: no standstill was seen in fresh samples; look at the arm."
        self._ring.publish_reason(result.sentence)
        self._publish(now)
        self._ring.finish()
        return result

    def _explain(self, outcome: str) -> LoopResult:
        motion, session, settings = self.motion, self.session, self._settings
        reason = motion.stop_reason
        if outcome == LoopOutcome.COMPLETED:
            return LoopResult(
                outcome, outcome, f"All periods were driven ({motion.periods_completed}); the arm was stopped by ramp."
            )
        if outcome == LoopOutcome.DROPPED and session.drop is not None:
            drop = session.drop
            return LoopResult(outcome, drop.reason.name, drop.sentence(), drop.joint or None, drop.value, drop.limit)
        if self._refused is not None:
            error = self._refused
            return LoopResult(outcome, type(error).__name__, str(error))
        if outcome in (LoopOutcome.STOPPED, LoopOutcome.FAULT) and reason is not None:
            after = " The arm was stopped by ramp." if motion.commanded else " Nothing had moved."
            return LoopResult(
                outcome, reason.code.name, reason.sentence + after, reason.joint or None, reason.value, reason.limit
            )
        if outcome == LoopOutcome.VERSION_MISMATCH:
            return LoopResult(outcome, outcome, self._version_sentence())
        if outcome == LoopOutcome.NOT_STARTED:
            state = SessionState(session.state).name
            why = self._hindrance or f"the session stands in {state}"
            return LoopResult(
                outcome, outcome, f"The robot gave no command within {settings.command_timeout_s:g} s: {why}."
            )
        return LoopResult(
            outcome,
            outcome,
            f"No FRI message arrived within {settings.start_timeout_s:g} s: "
            "start the FRI application on the robot and check the address it sends to.",
        )

    def _version_sentence(self) -> str:
        mine = self._codec.version
        for version in (FriVersion.V1_15, FriVersion.V2_5, FriVersion.V2_7):
            if version.is_framed == mine.is_framed and version.major == mine.major:
                continue
            try:
                Codec(version).decode_monitoring(self._undecodable_sample)
            except CodecError:
                continue
            return f"The robot speaks FRI {version}, but this run was told FRI {mine}: choose --fri-version {version}."
        return f"Datagrams arrive, but none is a message of FRI {mine}: {self._undecodable_error}"


_REQUEST_SENTENCES = {
    EventCode.OPERATOR_STOP: "The operator asked for a stop.",
    EventCode.RECORDER_LOST: "The recorder was lost.",
    EventCode.DISK_FULL: "The disk refused further samples.",
    EventCode.SUPERVISOR_LOST: "The supervising process was lost.",
}
