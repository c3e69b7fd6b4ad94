"""The long-running service: hears clients, keeps the queue, drives the state table. One thread decides everything.

Here: `Service`, whose `run` is the control thread: requests in, results of the working threads in, actions of the state
table out. Not here: the table (`service_states`), the sockets (`control_socket`), the files (`job_store`), waiting
(`job_work`). The control thread never touches the disk and never waits for a run, a check or a client: between asking
for a stop and the word in the ring lies one turn of its loop.

When this thread hangs, the run's heartbeat ceases with it and the loop ends the motion by its ramp: an operator who
cannot be heard must not have a moving arm. When the process is killed, the same happens.
"""

from __future__ import annotations

import contextlib
import os
import queue
import signal
import threading
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType

from daemon.api import RunEvent
from daemon.config import DaemonConfig
from daemon.errors import sentence_of
from daemon.host import own_version
from daemon.queue import control_api as api
from daemon.queue.control_api import RefusedRequestError
from daemon.queue.control_socket import ControlSocket, ServerKeys
from daemon.queue.investigation_step import StepEnded, start_step
from daemon.queue.investigations import Investigations
from daemon.queue.job_queue import JobQueue
from daemon.queue.job_work import (
    Checked,
    Checker,
    FitEnded,
    FitStarted,
    Posted,
    Prepared,
    RunEnded,
    Stored,
    start_fit,
    start_run,
)
from daemon.queue.service_log import ServiceLog
from daemon.queue.service_states import Action, Event, State, transition
from daemon.queue.systemd_notify import SystemdNotifier
from daemon.runtime_folder import default_endpoint, lock_port
from daemon.signals import handled
from daemon.stop_handle import StopHandle
from daemon.times import now_text
from daemon.words import counted
from fri_client.handover.ring import EventCode

POLL_S = 0.05
UNHEARD_S = 2.0
"""Without a turn of the control thread for so long, the run's heartbeat ceases."""


class Service:
    """The service of one UDP port; `run` serves until SIGTERM or SIGINT and returns when the arm is at rest."""

    def __init__(self, config: DaemonConfig, *, tell: Callable[[str], None]) -> None:
        """tell: one line for the log. Raises LogIOError when the folder for jobs cannot be used."""
        self._config = config
        self._log = ServiceLog(tell)
        self._tell = self._log.tell
        self._port = config.fri.bind_port
        self._needs_confirmation = not config.is_simulation
        self._state = State.IDLE
        self._posted: queue.SimpleQueue[Posted] = queue.SimpleQueue()
        self._progress = RunEvent(kind="", sentence="")
        self._stop = StopHandle()
        self._prepared: Prepared | None = None
        self._run_id: str | None = None
        self._run_thread: threading.Thread | None = None
        self._ended_run = ""
        self._fit_id: str | None = None
        self._step_id: str | None = None
        self._signals = 0
        self._started_at = now_text()
        self._version = own_version()
        self._notifier = SystemdNotifier()

    def run(self) -> None:
        """Serve. Raises PortInUseError, ConfigurationError, MissingInputError, LogIOError before anything is served."""
        control = self._config.control
        keys = None
        if control.server_key is not None and control.authorised_clients is not None:
            keys = ServerKeys(Path(control.server_key), Path(control.authorised_clients))
        with contextlib.ExitStack() as stack:
            stack.callback(self._log.close)
            stack.enter_context(lock_port(self._config.fri.bind_host, self._port))
            self._jobs = JobQueue(self._config, self._tell)
            stack.callback(self._jobs.close)
            self._investigations = Investigations(self._config, self._jobs.store)
            self._checker = Checker(self._posted.put)
            stack.callback(self._checker.close)
            self._socket = stack.enter_context(ControlSocket(control.endpoint or default_endpoint(self._port), keys))
            stack.callback(self._notifier.close)
            stack.enter_context(self._handled_signals())
            stack.callback(self._end_motion)
            self._investigations.recover()
            for job in self._jobs.recover():
                self._checker.check(self._jobs.check_of(job))
            self._tell(f"Serving UDP port {self._port} of {self._config.robot}; spoken to at {self._socket.endpoint}.")
            self._notifier.ready(self._sentence())
            while self._state is not State.CLOSED:
                self._turn()
            self._notifier.stopping()

    def _turn(self) -> None:
        """Once round: everything that came in, then what waits."""
        self._stop.tick()
        self._notifier.beat()
        for address, data in self._socket.receive(POLL_S):
            self._answer(address, data)
        while self._signals:
            self._signals = 0
            self._tell("The service was asked to end.")
            self._happen(Event.TERMINATE)
        with contextlib.suppress(queue.Empty):
            while True:
                self._take(self._posted.get_nowait())
        self._investigations.follow()
        if self._state is State.IDLE and self._jobs.next_run() is not None:
            self._happen(Event.RUN_READY)
        self._begin_fit()
        self._begin_step()
        self._notifier.status(self._sentence())

    # ---- requests

    def _answer(self, address: list[bytes], data: bytes) -> None:
        """A mistake in here costs one answer, never the service."""
        reply: api.ControlReply | None
        try:
            reply = self._handle(api.decode_request(data), address)
        except RefusedRequestError as error:
            self._socket.malformed += error.code in ("bad_request", "too_long", "unsupported_version")
            reply = api.ErrorReply(code=error.code, sentence=str(error), exit_code=error.exit_code)
        except Exception as error:
            self._tell(f"A request failed: {''.join(traceback.format_exception(error))}")
            reply = api.ErrorReply(
                code="internal", sentence=f"The service failed: {type(error).__name__}.", exit_code=70
            )
        if reply is not None:
            self._socket.reply(address, reply)

    def _handle(self, request: api.ControlRequest, address: list[bytes]) -> api.ControlReply | None:
        match request:
            case api.StopMotion():
                return self._stop_motion()
            case api.Ping():
                return api.Pong(pid=os.getpid(), software_version=self._version)
            case api.GetStatus():
                return self._status()
            case api.GetJobs():
                listed = self._jobs.views(request.limit, request.job_id, held=request.held)
                return api.JobsReply(jobs=listed, total=len(self._jobs.store.jobs))
            case api.SubmitRun() | api.SubmitInvestigation():
                # Answered when it is on the disk.
                self._submit(request, address)
                return None
            case api.ResumeQueue():
                self._require_confirmation(request.confirmed)
                released = self._jobs.release(request.jobs)
                turns = "takes its turn" if released == 1 else "take their turn"
                sentence = f"{counted(released, 'held run')} {turns} again."
                return api.Resumed(released=released, sentence=sentence)
            case api.CancelJob():
                return api.Cancelled(job_id=request.job_id, sentence=self._jobs.cancel(request.job_id))

    def _stop_motion(self) -> api.Stopped:
        before, already, run = self._state, self._stop.requested, self._run_id
        self._happen(Event.STOP)
        moving = run is not None
        if moving:
            done = "The stop had been asked for before" if already else "The stop ramp was asked for"
            sentence = f"{done}; run {run} ends with a confirmed standstill or says that it is not confirmed."
        elif before is State.PREPARING:
            sentence = "Nothing was moving; the run about to begin was broken off."
        else:
            sentence = "Nothing was moving."
        held = self._jobs.held()
        if held:
            sentence += f" {counted(held, 'run')} {'waits' if held == 1 else 'wait'} for `iiwa-ident resume`."
        self._tell(sentence)
        return api.Stopped(was_moving=moving, already=moving and already, run=run, held=held, sentence=sentence)

    def _submit(self, request: api.SubmitRun | api.SubmitInvestigation, address: list[bytes]) -> None:
        if self._state in (State.CLOSING, State.CLOSED):
            raise RefusedRequestError("closing", "The service is about to end; nothing is taken any more.", 69)

        def stored(job_id: str, error: OSError | None) -> None:
            self._posted.put(Stored(job_id, address, error))

        if isinstance(request, api.SubmitRun):
            self._require_confirmation(request.confirmed)
            self._jobs.add(request, stored)
            return
        # Moves nothing by itself: each of its motions waits for a confirmed `resume`.
        if request.unasked and self._needs_confirmation:
            raise RefusedRequestError("not_confirmed", "A real arm asks before each motion of an investigation.", 2)
        self._investigations.add(request, stored)

    def _require_confirmation(self, confirmed: bool) -> None:
        if self._needs_confirmation and not confirmed:
            raise RefusedRequestError(
                "not_confirmed",
                "The arm will move when the queue comes to it, and nobody will be asked again: confirm that "
                "(`--confirm`).",
                2,
            )

    def _status(self) -> api.StatusReply:
        progress = RunEvent(kind="", sentence="") if self._run_id is None else self._progress
        return api.StatusReply(
            state=self._state.value,
            sentence=self._sentence(),
            pid=os.getpid(),
            software_version=self._version,
            started_at=self._started_at,
            robot=self._config.robot,
            bind=f"{self._config.fri.bind_host}:{self._port}",
            fri_version=self._config.fri.version,
            needs_confirmation=self._needs_confirmation,
            run=self._run_id,
            fit=self._fit_id,
            investigation=self._step_id,
            waiting=self._jobs.waiting(),
            held=self._jobs.held(),
            motion_phase=progress.phase,
            period=progress.period,
            periods=progress.periods,
            samples=progress.samples,
            missing=progress.missing,
            lost_in_handover=progress.lost_in_handover,
            malformed=self._socket.malformed,
            recent=self._log.recent,
        )

    def _sentence(self) -> str:
        doing = {
            State.IDLE: "Nothing moves",
            State.PREPARING: "The next run's motion is checked once more",
            State.RUNNING: f"Run {self._run_id}: {self._progress.sentence or 'starting'}",
            State.STOPPING: "A stop was asked for; the arm comes to rest",
            State.CLOSING: "The service ends; the arm comes to rest",
            State.CLOSED: "The service has ended",
        }[self._state]
        return f"{doing.rstrip('.')}; {self._jobs.waiting()} waiting, {self._jobs.held()} held."

    # ---- what the working threads say

    def _take(self, posted: Posted) -> None:
        match posted:
            case Stored():
                if posted.error is not None:
                    self._jobs.store.forget(posted.job_id)
                    text = f"The job could not be stored and is not in the queue: {sentence_of(posted.error)}"
                    self._socket.reply(posted.address, api.ErrorReply(code="not_stored", sentence=text, exit_code=74))
                    return
                job = self._jobs.store.jobs[posted.job_id]
                what = "its motion is being checked" if job.kind == "run" else "it asks before each motion"
                text = f"Job {posted.job_id} is in the queue; {what}."
                self._socket.reply(posted.address, api.Submitted(job_id=posted.job_id, sentence=text))
                if job.kind == "run":
                    self._checker.check(self._jobs.check_of(job))
            case Checked():
                self._jobs.checked(posted.job_id, posted.verdict)
            case Prepared():
                self._prepared = posted
                if posted.request is None:
                    self._jobs.not_prepared(posted.job_id, posted.verdict)
                self._happen(Event.REFUSED if posted.request is None else Event.PREPARED)
            case RunEnded():
                self._run_thread = None
                self._run_id = None
                completed = self._jobs.run_ended(posted)
                self._tell(f"Run {posted.job_id}: {posted.sentence}")
                self._ended_run = posted.job_id
                self._happen(Event.COMPLETED if completed else Event.FAILED)
            case RunEvent():
                self._progress = posted
                self._tell(f"[{posted.kind}] {posted.sentence}")
            case FitStarted():
                self._jobs.fit_started(posted.job_id, posted.pid)
            case FitEnded():
                self._fit_id = None
                self._jobs.fit_ended(posted)
                self._tell(f"Fit {posted.job_id}: {posted.sentence}")
            case StepEnded():
                self._step_id = None
                self._investigations.step_ended(posted)
                self._tell(f"Investigation {posted.job_id}: {posted.answer.sentence}")

    def _begin_fit(self) -> None:
        job = None if self._fit_id else self._jobs.next_fit()
        if job is not None and self._state is not State.CLOSING:
            self._fit_id = job.job_id
            start_fit(job, self._posted.put)

    def _begin_step(self) -> None:
        job = None if self._step_id else self._investigations.next_step()
        if job is not None and self._state is not State.CLOSING:
            self._step_id = job.job_id
            start_step(job.job_id, self._investigations.step_of(job), self._posted.put)

    # ---- the state table

    def _happen(self, event: Event) -> None:
        self._state, actions = transition(self._state, event)
        for action in actions:
            self._act(action)

    def _act(self, action: Action) -> None:
        match action:
            case Action.SET_STOP_FLAG:
                self._stop.request(EventCode.SIGNAL_STOP if self._state is State.CLOSING else EventCode.OPERATOR_STOP)
            case Action.PREPARE_NEXT:
                job = self._jobs.next_run()
                assert job is not None
                self._checker.prepare(self._jobs.preparation_of(job))
            case Action.START_RUN:
                prepared = self._prepared
                assert prepared is not None
                assert prepared.request is not None
                self._jobs.run_started(prepared.job_id)
                self._stop = StopHandle(watched_by_s=UNHEARD_S)
                self._progress = RunEvent(kind="starting", sentence="starting")
                self._run_id = prepared.job_id
                self._run_thread = start_run(
                    prepared.job_id, prepared.request, self._stop, self._jobs.store, self._posted.put
                )
            case Action.HOLD_PREPARED:
                if self._prepared is not None:
                    self._jobs.hold(self._prepared.job_id)
            case Action.BREAK_OFF_PREPARATION:
                self._checker.break_off()
            case Action.HOLD_WAITING:
                self._jobs.hold_waiting()
            case Action.QUEUE_FIT:
                self._jobs.queue_fit(self._ended_run)

    # ---- the rest

    @contextlib.contextmanager
    def _handled_signals(self) -> Iterator[None]:
        """The end of the service goes through the state table like everything else."""

        def end(number: int, frame: FrameType | None) -> None:
            del number, frame
            self._signals += 1

        with handled((signal.SIGINT, signal.SIGTERM, signal.SIGHUP), end):
            yield

    def _end_motion(self) -> None:
        """However this thread leaves its loop: no motion without it."""
        self._stop.request(EventCode.SIGNAL_STOP)
        thread = self._run_thread
        if thread is not None:
            while thread.is_alive():
                self._stop.tick()
                thread.join(POLL_S)
