"""The recorder process: drains the ring, decodes, writes the log; `python -m daemon.run.recorder --request FILE ...`.

Here: the loop from ring to file, gap counting, what to do when the disk refuses, when to end. Not here: MCAP (`log`),
the ring (`fri_client.handover.ring`), who starts it (`service`).

Nothing is lost silently:
  - a slot of the ring is released only when its sample is with the operating system, so a recorder that is killed
    leaves to its replacement exactly what is not in its file (at worst a few samples stand in both files);
  - a full disk is answered with the reserve that was allocated at the start, and reported, so that the supervisor ends
    the run by a stop ramp; when that is used up too, the recorder stops draining, tries again and finally says which
    sample is the first that is not in the file: the ring still holds it;
  - a recorder whose supervisor is gone goes on until the loop says it is finished, or is silent for good;
  - once its file is closed it stays until run.json is written, and writes it where supervisor and loop are both gone.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import zmq

from daemon.api import EXIT_CODES, REPORT_NAME, RUN_NAME, LoopReport, RecorderJob, RunRequest
from daemon.children import processes_of
from daemon.circles import look_for_none_at_the_end
from daemon.control_messages import (
    ControlMessage,
    RecorderFailed,
    RecorderFinished,
    RecorderProgress,
    RecorderReady,
    RecorderTrouble,
)
from daemon.errors import DaemonError, LogIOError
from daemon.json_files import read_json
from daemon.live.broadcast import LiveBroadcast
from daemon.live.event_text import event_name, event_sentence
from daemon.log.cdr import LoggedEvent, SampleLabels
from daemon.log.stream import DiskReserve, is_full
from daemon.log.writer import LogWriter, has_non_finite
from daemon.run.account import leave_outcome
from daemon.run.link_diagnostics import diagnostics_of
from daemon.run.log_inputs import attachments_of, closing_attachments_of, description_of, metadata_of
from daemon.run.outcome import keep_last_samples, loop_report_without_loop
from daemon.run.spare_folder import find_run_file
from daemon.run.supervision import Supervision, silence_s
from fri_client.errors import CodecError
from fri_client.handover.ring import Disposition, EventCode, HandoverRecord, HandoverRing
from fri_client.messages import CommandMessage, FriVersion
from fri_client.session.refusal import UNREADABLE, Refusal
from fri_client.session.replayed_counter import ReplayedCounter
from fri_client.wire.codec import Codec

BATCH = 512
IDLE_SLEEP_S = 0.002
PROGRESS_S = 0.5
DIAGNOSTICS_S = 1.0
RESERVE_BYTES = 8 * 1024 * 1024
"""Room for about five seconds of samples at 1 kHz uncompressed and for the closing of the file."""
ORPHAN_PATIENCE_S = 15.0
DISK_PATIENCE_S = 5.0
ACCOUNT_POLL_S = 0.2
RETRY_S = 0.2
MAXIMUM_UNDECODABLE_TEXTS = 1000

UNDECODABLE = 1001
DISK_TROUBLE = 1002
RECORDING_ENDED = 1003

Report = Callable[[ControlMessage], None]


class Recorder:
    """One recording: `run` drains the ring until the loop has finished and returns the process' exit code."""

    def __init__(
        self,
        job: RecorderJob,
        ring: HandoverRing,
        report: Report,
        live: LiveBroadcast | None = None,
        supervision: Supervision | None = None,
    ) -> None:
        """Open the file and report ready; live: who is shown what is recorded; supervision: None where this process'
        parent is the supervisor. Raises LogIOError when the disk refuses already.
        """
        self._live = live
        self._job = job
        self._began_s = time.monotonic()
        self._ring = ring
        self._report = report
        self._codec = Codec(FriVersion.parse(job.request.fri_version))
        path = Path(job.path)
        self._reserve = DiskReserve(path.parent, f".{path.name}.reserve", RESERVE_BYTES)
        try:
            self._writer = LogWriter(
                path, metadata=metadata_of(job), attachments=attachments_of(job), robot_description=description_of(job)
            )
        except LogIOError:
            self._reserve.give_back()
            raise
        self._epoch_offset_ns = ring.epoch_offset_ns
        self._supervision = supervision or Supervision(ring, os.getppid())
        self._expected_index: int | None = None
        self._counter = ReplayedCounter()
        self._last_index = -1
        self._samples_in_periods = 0
        self._handover_gaps = 0
        self._undecodable = 0
        self._next_progress = 0.0
        self._next_diagnostics = time.monotonic() + DIAGNOSTICS_S
        report(RecorderReady(part=job.part))

    def run(self) -> int:
        """Drain until the loop has finished and everything is in the file. Returns 0, or 74 when the disk refused."""
        try:
            while True:
                finished = self._ring.finished
                records = self._ring.read_batch(BATCH)
                for record in records:
                    self.take(record)
                self._keep_safe(final=False)
                self._tell()
                if not records:
                    if finished or self.is_abandoned:
                        break
                    time.sleep(IDLE_SLEEP_S)
            return self._close()
        except _DiskRefusedError as refusal:
            self._report(RecorderFailed(part=self._job.part, sentence=str(refusal.error)))
            return refusal.error.exit_code
        finally:
            self._reserve.give_back()

    def take(self, record: HandoverRecord) -> None:
        """Write one record of the ring: its sample, its event, or both."""
        if self._expected_index is not None:
            self._handover_gaps += max(0, record.index - self._expected_index)
        elif self._job.part == 0:
            self._handover_gaps += record.index
        self._expected_index = record.index + 1
        self._last_index = record.index
        receive_ns = record.receive_ns + self._epoch_offset_ns
        if record.event_code:
            self._write_event(record, receive_ns)
        if record.disposition != Disposition.EVENT_ONLY:
            self._take_sample(record, receive_ns)
        if record.event_code == EventCode.SILENCE:
            self._counter.resynchronise()  # as the session does

    def _take_sample(self, record: HandoverRecord, receive_ns: int) -> None:
        try:
            message = self._codec.decode_monitoring(record.monitoring)
        except CodecError as error:
            self._write_undecodable(record, receive_ns, error)
            return
        command = self._command(record)
        refusal = record.event_limit if record.event_code == EventCode.REFUSED else 0
        is_forged = refusal == Refusal.COUNTER
        if refusal in UNREADABLE:
            self._counter.refuse(message.header.sequence_counter)
        else:
            self._counter.take(message.header.sequence_counter, believed=not is_forged)
        labels = SampleLabels(
            receive_ns,
            record.send_ns + self._epoch_offset_ns if record.send_ns else 0,
            record.index,
            record.phase,
            record.period,
            record.sample_in_period,
            record.command is not None,
            record.disposition == Disposition.DUPLICATE,
            record.disposition == Disposition.STALE or is_forged,
            has_non_finite(message),
        )
        self._writer.write_sample(message, command, labels)
        if self._live is not None and not labels.non_finite:
            self._live.sample(message, command, record, receive_ns)
        if record.period >= 0 and record.disposition == Disposition.FRESH:
            self._samples_in_periods += 1

    def _command(self, record: HandoverRecord) -> CommandMessage | None:
        with contextlib.suppress(CodecError):
            return None if record.command is None else self._codec.decode_command(record.command)
        return None

    def _write_event(self, record: HandoverRecord, time_ns: int) -> None:
        sentence = event_sentence(record, self._ring.reason)
        if self._live is not None:
            self._live.event(sentence)
        self._writer.write_event(
            LoggedEvent(
                record.event_code, event_name(record.event_code), sentence, time_ns, record.index, record.event_joint,
                record.event_value, record.event_limit,
            )
        )  # fmt: skip

    def _write_undecodable(self, record: HandoverRecord, time_ns: int, error: CodecError) -> None:
        """Keep the bytes themselves, for the first thousand; count all."""
        self._undecodable += 1
        if self._undecodable <= MAXIMUM_UNDECODABLE_TEXTS:
            sentence = f"{error} Datagram of {len(record.monitoring)} bytes: {record.monitoring.hex()}"
            self._writer.write_event(LoggedEvent(UNDECODABLE, "UNDECODABLE", sentence, time_ns, record.index))

    def _keep_safe(self, *, final: bool) -> None:
        """Hand over what is due; when the disk refuses, open the reserve, then try again for DISK_PATIENCE_S."""
        deadline: float | None = None
        while True:
            try:
                if final:
                    self._writer.flush()
                    flushed = True
                else:
                    flushed = self._writer.flush_when_due()
                if flushed:
                    self._ring.release()
                return
            except LogIOError as error:
                if deadline is None:
                    deadline = time.monotonic() + DISK_PATIENCE_S
                self._handle_trouble(error)
                if time.monotonic() > deadline:
                    raise _DiskRefusedError(error) from error
                final = True

    def _handle_trouble(self, error: LogIOError) -> None:
        helped = is_full(error) and self._reserve.give_back()
        self._report(RecorderTrouble(part=self._job.part, sentence=str(error), reserve_opened=helped))
        if helped:
            self._writer.write_event(LoggedEvent(DISK_TROUBLE, "DISK_TROUBLE", str(error), time.time_ns()))
        else:
            time.sleep(RETRY_S)

    def _tell(self) -> None:
        if self._live is not None:
            self._live.tick()
        now = time.monotonic()
        if now >= self._next_progress:
            self._next_progress = now + PROGRESS_S
            self._report(RecorderProgress(part=self._job.part, samples=self._writer.samples))
        if now >= self._next_diagnostics:
            self._next_diagnostics = now + DIAGNOSTICS_S
            self._require_place()
            statuses = diagnostics_of(self._ring, self._writer.samples)
            self._writer.write_diagnostics(statuses, self._job.request.robot, time.time_ns())

    def _require_place(self) -> None:
        """A file that has no name takes every write, and is gone with this process: patience is of no use.

        Before the first record nothing is lost by it, and the loop says by itself that its folder is gone.
        """
        if self._last_index < 0:
            return
        try:
            self._writer.require_place()
        except LogIOError as error:
            raise _DiskRefusedError(error) from error

    @property
    def is_abandoned(self) -> bool:
        """True when the supervisor is gone and the loop has been silent for ORPHAN_PATIENCE_S, also one that has still
        to say its first word: it is being started, and will answer the robot.
        """
        if not self._supervision.is_orphan:
            return False
        return silence_s(self._ring.status.time_ns, self._began_s) > ORPHAN_PATIENCE_S

    def _close(self) -> int:
        if not self._ring.finished:
            keep_last_samples(self._ring, self._job.request, None)
            sentence = "The recording ended because the supervisor and the loop were gone."
            self._writer.write_event(LoggedEvent(RECORDING_ENDED, "RECORDING_ENDED", sentence, time.time_ns()))
        for attachment in closing_attachments_of(self._job):
            self._writer.add_attachment(attachment)
        self._keep_safe(final=True)
        self._require_place()
        self._reserve.give_back()
        end = {
            "sequence_gaps": str(self._counter.missing),
            "handover_gaps": str(self._handover_gaps),
            "undecodable": str(self._undecodable),
            "samples_in_periods": str(self._samples_in_periods),
            "reason": self._ring.reason,
        }
        deadline = time.monotonic() + DISK_PATIENCE_S
        while True:
            try:
                self._writer.finish(end)
                break
            except LogIOError as error:
                if time.monotonic() > deadline:
                    raise _DiskRefusedError(error) from error
                time.sleep(RETRY_S)
        self._report(
            RecorderFinished(
                part=self._job.part,
                samples=self._writer.samples,
                samples_in_periods=self._samples_in_periods,
                last_index=self._last_index,
                sequence_gaps=self._counter.missing,
                handover_gaps=self._handover_gaps,
            )
        )
        return 0


class _DiskRefusedError(Exception):
    """The disk refused for DISK_PATIENCE_S, or the file lost its place; carries the last refusal."""

    def __init__(self, error: LogIOError) -> None:
        self.error = error
        super().__init__(str(error))


def see_to_the_account(request: RunRequest, ring: HandoverRing, supervision: Supervision) -> None:
    """Stay until run.json is written; write it where nobody else is left to say how the run ended.

    The loop's process does so where the supervisor was gone at its end. It leaves where the supervisor lived, which may
    be killed any moment later. A loop that never said that it had finished, and is silent for good, writes nothing.
    """
    folder = Path(request.out_dir)
    while not find_run_file(request, RUN_NAME).is_file():
        if supervision.is_orphan and not (ring.finished and processes_of("daemon.run.loop_process", folder)):
            report = loop_report_without_loop(request, ring, None, "")
            with contextlib.suppress(DaemonError):
                report = read_json(find_run_file(request, REPORT_NAME), LoopReport)
            leave_outcome(request, report, EXIT_CODES[report.outcome], writer="the recorder", ring=ring)
            return
        time.sleep(ACCOUNT_POLL_S)


def main(arguments: list[str] | None = None) -> int:
    """Entry of the process. Exit code: 0, 74 disk, 78 request, 70 otherwise; last words on stderr."""
    parser = argparse.ArgumentParser(prog="python -m daemon.run.recorder", description="Write the ring to a log.")
    parser.add_argument("--request", required=True, help="JSON file of a RecorderJob")
    parser.add_argument("--ring-fd", required=True, type=int, help="inherited descriptor of the ring")
    parser.add_argument("--endpoint", help="ZeroMQ endpoint of the supervisor (ipc://...)")
    parser.add_argument("--supervisor", type=int, default=os.getppid(), help="process number of who started this")
    options = parser.parse_args(arguments)
    # The recorder ends when the loop has ended, not when somebody presses a key.
    for each in (signal.SIGINT, signal.SIGHUP, signal.SIGTERM):
        signal.signal(each, signal.SIG_IGN)
    context: zmq.Context[Any] = zmq.Context()
    socket = context.socket(zmq.PUSH)
    # Long enough for the last report; a supervisor that is gone must not keep this process.
    socket.linger = 1000
    socket.sndhwm = 1000
    if options.endpoint:
        socket.connect(options.endpoint)

    def report(message: ControlMessage) -> None:
        with contextlib.suppress(zmq.Again):  # also where there is no endpoint, and so nobody to tell
            socket.send(msgspec.json.encode(message), zmq.NOBLOCK)

    try:
        job, ring = read_json(options.request, RecorderJob), HandoverRing.attach(options.ring_fd)
        with LiveBroadcast(job.request, ring, context) as live:
            supervision = Supervision(ring, options.supervisor)
            code = Recorder(job, ring, report, live, supervision).run()
        # A supervisor replaces one that the disk refuses; one without an endpoint has nobody who would end it.
        if supervision.is_orphan or (options.endpoint and not code):
            see_to_the_account(job.request, ring, supervision)
        return code
    except DaemonError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    finally:
        socket.close()
        context.term()


if __name__ == "__main__":
    look_for_none_at_the_end()
    sys.exit(main())
