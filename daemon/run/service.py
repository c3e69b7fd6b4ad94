"""The supervisor of one acquisition: starts recorder and loop, watches both, tells the operator, closes the books.

Here: `run_acquisition`, from a request to `run.json`. Not here: the loop (`loop_process`), the file (`recorder`), the
fit (`worker`), the command line. The supervisor is never in the way of a sample: loop and recorder share the ring, a
stop is one word in that ring, and both end properly when the supervisor is killed.

What happens when a child dies:
  - recorder: the loop is asked for a stop ramp, a second recorder takes over the same ring (which still holds all that
    is not safe) into a part of its own, and both parts are joined into recording.mcap; the broken one is kept too.
    When the disk is what failed, the part goes to the system's temporary folder.
  - loop: the robot gets no answers and brakes by itself; the recorder writes what is left. One held for STOPPED_S ends.
  - supervisor: the loop misses its heartbeat and stops by ramp, the recorder goes on until the loop has ended; the
    loop's process then writes run.json.
  - loop and supervisor, or the supervisor once the loop has ended: the recorder, which stays for that, writes run.json.
"""

from __future__ import annotations

import contextlib
import time
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import msgspec

from daemon.api import AUTO_VERSION, RUN_NAME, LoopReport, RecorderJob, RunEvent, RunOutcome, RunRequest
from daemon.children import Child
from daemon.control_messages import RecorderFailed, RecorderFinished, RecorderReady, RecorderTrouble
from daemon.doctor.load_check import with_load_check
from daemon.errors import (
    BadLogError,
    ChildProcessFailedError,
    DaemonError,
    FolderGoneError,
    LogIOError,
    MissingInputError,
)
from daemon.host import software_versions
from daemon.jobs.worker_start import start_worker
from daemon.json_files import read_json, write_json
from daemon.log.parts import join_parts, part_path
from daemon.run.commissioning import admit, held_to_modes, remember
from daemon.run.control import ControlInbox
from daemon.run.folder import make_room, prepare_folder
from daemon.run.judgement import judged
from daemon.run.ladder import tags
from daemon.run.narrator import Observer, RunNarrator, unfailing
from daemon.run.outcome import (
    digests_of,
    exit_code_of_run,
    keep_last_samples,
    lost_between,
    lost_messages,
    note_no_start,
    outcome_sentences,
    report_of_loop,
    stopped_nothing,
    tidy,
)
from daemon.run.spare_folder import find_run_file, spare_folder, write_run_file
from daemon.run.start_check import StartCheck
from daemon.run.supervision import silence_s
from daemon.run.version_search import hear_version
from daemon.runtime_folder import lock_port
from daemon.stop_handle import StopHandle
from daemon.times import now_text
from fri_client.handover.ring import EventCode, HandoverRing

RECORDER_START_S = 60.0
RECORDER_SILENCE_S = 120.0
STOPPED_S = 10.0
"""A child that a signal holds (SIGSTOP) for so long does not come back: what it holds is needed now."""
MAXIMUM_PARTS = 4
POLL_S = 0.05


def run_acquisition(
    request: RunRequest, *, observe: Observer, stop: StopHandle | None = None, port_is_locked: bool = False
) -> RunOutcome:
    """Run one acquisition in the calling thread and return how it ended; everything is in `request.out_dir`.

    SIGINT and SIGTERM ask for the stop ramp (in the main thread) and are then waited for; so does `stop`, from any
    thread at any time. Where the motion was over already, a KeyboardInterrupt follows once the books are closed.
    port_is_locked: the caller holds the lock of the UDP port already. Raises, before anything moves: MissingInputError,
    ConfigurationError (also for a folder that holds a recording already), PortInUseError, LogIOError, FolderGoneError,
    ChildProcessFailedError, LadderError, and where the version is "auto" those of `hear_version`. A run that was
    stopped, dropped or never began is an outcome, not an error.
    """
    observe = unfailing(observe)
    _tell_if(observe, admit(request))
    request = held_to_modes(request)
    with contextlib.nullcontext() if port_is_locked else lock_port(request.bind_host, request.bind_port):
        stop = stop or StopHandle()
        if request.fri_version == AUTO_VERSION:
            make_room(Path(request.out_dir))
            observe(RunEvent(kind="waiting", sentence="Listening which FRI version the robot speaks."))
            version, sentence = hear_version(request, stop)
            _tell_if(observe, sentence)
            request = msgspec.structs.replace(request, fri_version=version.value)
        acquisition = _Acquisition(prepare_folder(request), observe, stop)
        outcome = acquisition.run()
    motion = msgspec.structs.replace(outcome, exit_code=acquisition.motion_exit_code)
    _tell_if(observe, remember(request, motion))
    if stop.signals > acquisition.signals_in_motion and stopped_nothing(outcome):
        raise KeyboardInterrupt
    return outcome


def _tell_if(observe: Observer, sentence: str) -> None:
    if sentence:
        observe(RunEvent(kind="preflight", sentence=sentence))


class _Acquisition:
    """One run, from the ring to run.json; `run` is called once."""

    def __init__(self, request: RunRequest, observe: Observer, stop: StopHandle) -> None:
        self._request = request
        self._folder = Path(request.out_dir)
        self._observe = observe
        self._started_at = now_text()
        self._stop = stop
        self._parts: list[Path] = []
        self._finished: dict[int, RecorderFinished] = {}
        self._disk_failed = False
        self._recorder: Child | None = None
        self._ready_parts: set[int] = set()
        self.motion_exit_code = self.signals_in_motion = 0
        """Of the run without its fit, and how many signals came before its loop had ended; once `run` has returned."""

    def run(self) -> RunOutcome:
        """The whole acquisition."""
        with ControlInbox() as inbox, contextlib.ExitStack() as stack:
            self._inbox = inbox
            self._ring = HandoverRing.create(self._request.ring_slots)
            stack.callback(self._ring.close)
            self._narrator = RunNarrator(self._request, self._ring, self._observe)
            # Beaten before the loop starts: a supervisor that never beat is not watched.
            self._ring.beat()
            self._start_check = None if self._request.monitor_only else StartCheck(self._request, self._ring.gate)
            stack.enter_context(self._stop.attached(self._ring))
            stack.enter_context(self._stop.on_signals())
            self._narrator.tell("starting", f"Run {self._request.run_id}: recording into {self._folder}.")
            report = self._run_loop(self._start_children())
            self.signals_in_motion = self._stop.signals
            outcome = self._closed_by_loop()
            if outcome is None:
                self._finish_recording()
                try:
                    outcome = self._close_books(report)
                finally:
                    self._end_recorder()
            else:
                self.motion_exit_code = outcome.exit_code
            self._narrator.tell("finished", outcome.sentences[0])
            return outcome

    # ---- children

    def _start_children(self) -> Child:
        """The loop's process, after the recorder's. Raises LogIOError, FolderGoneError, ChildProcessFailedError."""
        try:
            self._start_recorder()
            self._wait_ready()
            arguments = ["--request", str(self._folder / "request.json")]
            return Child("loop", "daemon.run.loop_process", arguments, self._ring, self._folder)
        except (DaemonError, OSError) as error:
            self._ring.finish()  # no loop will: a recorder that was started is to close its file and go
            self._end_recorder(RECORDER_START_S)
            if not self._folder.is_dir():
                raise FolderGoneError(str(self._folder)) from error
            note_no_start(self._request, error, self._started_at)
            raise

    def _start_recorder(self) -> None:
        part = len(self._parts)
        folder = self._folder
        if part and not folder.is_dir():
            self._disk_failed = True
            self._narrator.remark(f"{folder} was moved or removed during the run; what stood there counts as lost.")
        if self._disk_failed:
            folder = spare_folder(self._request)
            self._narrator.remark(
                f"The rest of the recording goes to {folder}, because {self._folder} cannot be written."
            )
        path = part_path(folder, part)
        job_file = folder / f"recorder{part}.json"
        try:
            write_json(job_file, RecorderJob(request=self._request, path=str(path), part=part))
        except OSError as error:
            raise LogIOError(str(job_file), error) from error
        self._parts.append(path)
        arguments = ["--request", str(job_file), "--endpoint", self._inbox.endpoint]
        self._last_heard = time.monotonic()
        self._recorder = Child("recorder", "daemon.run.recorder", arguments, self._ring, folder)

    def _wait_ready(self) -> None:
        """Raises LogIOError or ChildProcessFailedError: nothing has moved yet."""
        deadline = time.monotonic() + RECORDER_START_S
        recorder = self._recorder
        assert recorder is not None
        while 0 not in self._ready_parts:
            self._listen(POLL_S)
            if not recorder.alive and 0 not in self._ready_parts:
                raise recorder.failed()
            if time.monotonic() > deadline:
                recorder.wait(0.0)
                raise ChildProcessFailedError("recorder", None, f"it was not ready within {RECORDER_START_S:g} s")

    def _run_loop(self, loop: Child) -> LoopReport:
        """Watch the loop and the recorder until it has ended; its report, or one made for it."""
        began_s = time.monotonic()
        host, port = self._request.bind_host, self._request.bind_port
        self._narrator.tell("waiting", f"Waiting for the robot on {host}:{port} (FRI {self._request.fri_version}).")
        # The start check takes seconds on a busy machine: here it would cost the heartbeat, and the loop would stop.
        checker = ThreadPoolExecutor(1, thread_name_prefix="start-check")
        start_check = self._start_check
        check: Future[str] | None = None
        load: Future[str] | None = None
        try:
            while loop.alive:
                # Where the operator's stop would not be heard any more, the loop is to stop by itself.
                if self._stop.alive:
                    self._ring.beat()
                self._listen(POLL_S)
                self._watch_recorder()
                self._narrator.follow()
                # The robot has long braked by itself; a loop that came back now would answer nobody.
                if silence_s(self._ring.status.time_ns, began_s) > STOPPED_S and loop.is_stopped:
                    loop.process.kill()
                if check is not None and check.done():
                    if (sentence := check.result()) and start_check is not None:
                        self._narrator.tell("preflight", sentence)
                        load = load or checker.submit(start_check.load_remark, self._ring)
                    check = None
                if load is not None and load.done() and load.result():
                    self._narrator.remark(load.result())
                # No start is allowed before the operator has read what the robot's messages say of its version.
                if check is None and self._narrator.has_judged_version() and start_check is not None:
                    check = checker.submit(start_check.poll, self._ring)
        finally:
            checker.shutdown()
            loop.close()
        if not self._ring.finished:
            # A killed loop can neither keep what it saw last nor say that no record will follow.
            keep_last_samples(self._ring, self._request, loop.process.returncode)
            self._ring.finish()
        report, self._loop_exit_code = report_of_loop(self._request, self._ring, loop)
        return report

    def _watch_recorder(self) -> None:
        """Replace a recorder that ended while the loop runs, and end the motion: what failed once may fail again."""
        recorder = self._recorder
        if recorder is None or recorder.alive:
            return
        self._listen(0.0)
        if len(self._parts) - 1 in self._finished or not recorder.process.returncode:  # then the loop is done as well
            return
        self._request_stop(EventCode.DISK_FULL if self._disk_failed else EventCode.RECORDER_LOST)
        self._replace_recorder(
            f"The recorder ended during the run (return code {recorder.process.returncode}); the motion was stopped "
            "and another recorder took over."
        )

    def _replace_recorder(self, remark: str) -> None:
        """By another one, unless there is nothing to record."""
        assert self._recorder is not None
        self._recorder.close()
        self._recorder = None
        if self._gone_unheard():
            return
        self._narrator.remark(remark)
        if len(self._parts) < MAXIMUM_PARTS:
            self._start_recorder()

    def _finish_recording(self) -> None:
        """Wait until the recorder has emptied the ring; replace one that dies meanwhile or does not go on (SIGSTOP)."""
        self._last_heard = time.monotonic()
        while self._recorder is not None:
            alive = self._recorder.alive
            self._listen(POLL_S)
            if len(self._parts) - 1 in self._finished:
                return
            if alive:
                patience_s = STOPPED_S if self._recorder.is_stopped else RECORDER_SILENCE_S
                if time.monotonic() - self._last_heard > patience_s:
                    self._recorder.wait(0.0)
                continue
            code = self._recorder.process.returncode
            if not code and time.monotonic() - self._last_heard < STOPPED_S:
                continue  # its last word is on its way to a supervisor that was held
            self._replace_recorder(f"A recorder ended before its file was closed (return code {code}).")

    def _end_recorder(self, patience_s: float = 0.0) -> None:
        """Once its file is closed it stays for the account alone; patience_s: how long that is waited for."""
        if self._recorder is not None:
            until_s = time.monotonic() + patience_s
            while not self._finished and self._recorder.alive and time.monotonic() < until_s:
                self._listen(POLL_S)
            self._recorder.wait(0.0)
            self._recorder.close()

    def _gone_unheard(self) -> bool:
        """Whether the folder went before any message of a robot came."""
        return not self._ring.status.received and not self._folder.is_dir()

    # ---- what is heard

    def _listen(self, timeout_s: float) -> None:
        for message in self._inbox.receive(timeout_s):
            self._last_heard = time.monotonic()
            if isinstance(message, RecorderReady):
                self._ready_parts.add(message.part)
            elif isinstance(message, RecorderFinished):
                self._finished[message.part] = message
            elif isinstance(message, RecorderTrouble):
                self._disk_failed = self._disk_failed or not message.reserve_opened
                self._request_stop(EventCode.DISK_FULL)
                self._narrator.remark(f"The recording has trouble: {message.sentence}")
            elif isinstance(message, RecorderFailed):
                self._disk_failed = True
                self._narrator.remark(message.sentence)

    def _request_stop(self, code: EventCode) -> None:
        if not self._ring.stop_request:
            self._ring.request_stop(code)

    # ---- the end

    def _closed_by_loop(self) -> RunOutcome | None:
        """The account that the loop's process wrote because this one was held (SIGSTOP) or hung; None: it did not."""
        with contextlib.suppress(MissingInputError):
            outcome = read_json(find_run_file(self._request, RUN_NAME), RunOutcome)
            self._end_recorder()
            tidy(self._folder)
            return outcome
        return None

    def _close_books(self, report: LoopReport) -> RunOutcome:
        first = self._finished.get(0)
        if first is not None:
            recording = self._parts[0]
            samples, in_periods, gaps = first.samples, first.samples_in_periods, first.sequence_gaps
            lost = lost_between(self._ring, first.handover_gaps, first.last_index + 1)
        else:
            recording, samples, in_periods, gaps, lost = self._join_parts()
        lost = lost_messages(lost, report, samples)
        for folder in {part.parent for part in self._parts}:
            tidy(folder)
        exit_code = exit_code_of_run(report, self._loop_exit_code, self._stop.signal_number)
        exit_code = exit_code or int(first is None or lost > 0)
        outcome = RunOutcome(
            run_id=self._request.run_id,
            outcome=report.outcome,
            exit_code=exit_code,
            sentences=outcome_sentences(report, self._request, samples, gaps, lost, self._narrator.remarks),
            out_dir=str(self._folder),
            recordings=(str(recording),),
            samples=samples,
            samples_in_periods=in_periods,
            sequence_gaps=gaps,
            handover_gaps=lost,
            loop=report,
            files=digests_of(self._folder, recording),
            software=software_versions(),
            request=self._request,
            started_at=self._started_at,
            finished_at=now_text(),
            commissioning=tags(self._request),
        )
        if self._request.fit and report.outcome == "completed" and not exit_code:
            outcome = start_worker(outcome)
            pid = outcome.worker_pid
            words = outcome.sentences[-1] if pid is None else f"The fit runs in a process of its own (pid {pid})."
            self._narrator.tell("worker", words)
        write_run_file(self._request, RUN_NAME, outcome)
        said, run_exit_code = len(outcome.sentences), outcome.exit_code
        outcome = with_load_check(judged(msgspec.structs.replace(outcome, exit_code=exit_code)))
        # Before that of a fit which the disk refused: it takes nothing from the motion.
        self.motion_exit_code = outcome.exit_code
        outcome = msgspec.structs.replace(outcome, exit_code=outcome.exit_code or run_exit_code)
        for sentence in outcome.sentences[said:]:
            self._narrator.remark(sentence)
        write_run_file(self._request, RUN_NAME, outcome)
        return outcome

    def _join_parts(self) -> tuple[Path, int, int, int, int]:
        """recording.mcap of what several recorders left (broken parts are kept): samples, in periods, gaps, losses."""
        existing = [part for part in self._parts if part.is_file()]
        if not existing and self._gone_unheard():
            return self._parts[0], 0, 0, 0, 0
        try:
            if not existing:
                raise MissingInputError(str(self._parts[0]), "the recording of this run")
            merged = join_parts(existing)
        except (BadLogError, LogIOError, MissingInputError) as error:
            self._narrator.remark(f"The parts of the recording could not be joined: {error}")
            return existing[-1] if existing else self._parts[0], 0, 0, 0, self._ring.lost + self._ring.backlog
        lost = lost_between(self._ring, merged.missing_in_handover, merged.next_index)
        return merged.recovered, merged.samples, merged.samples_in_periods, merged.missing, lost
