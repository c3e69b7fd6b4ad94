"""The rules of the queue: what a submitted run becomes, what waits, what a restart makes of each job.

Here: `JobQueue`, used by the control thread of `server` alone. Not here: files (`job_store`) and waiting (`job_work`).

    run:  checking -> queued -> preparing -> running -> done | stopped | failed
          checking or preparing -> refused;  queued <-> held;  waiting -> cancelled;  running -> interrupted
    fit:  queued -> running -> done | failed

After a restart no motion begins by itself: runs that waited are held, a run that was under way is interrupted. Fits go
on: one whose process still lives is watched again, any other is begun anew.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from daemon.api import RunOutcome
from daemon.config import DaemonConfig
from daemon.errors import EXIT_INTERRUPTED, DaemonError
from daemon.json_files import read_json
from daemon.queue.control_api import JobPhase, JobView, RefusedRequestError, SubmitRun
from daemon.queue.job_preparation import PreparationJob, Verdict
from daemon.queue.job_store import MAXIMUM_WAITING, Job, JobStore
from daemon.queue.job_work import FitEnded, RunEnded, fit_is_alive
from daemon.times import new_job_id

_MAXIMUM_ATTEMPTS = 2
_REFUSALS = (1, 65, 66, 78)
"""Exit codes of a run that was not begun because of what was asked for: the ladder, the data, a file, a setting."""
_HELD = "Waits for `iiwa-ident resume`: no motion follows a stop, a failed run or a restart by itself."


class JobQueue:
    """All jobs of one service, and what becomes of them."""

    def __init__(self, config: DaemonConfig, tell: Callable[[str], None]) -> None:
        """Read what an earlier service left. Raises LogIOError, and UnicodeEncodeError for a folder that no job and no
        answer to a client could name.
        """
        self._config = config
        self._output = Path(config.output).absolute()
        str(self._output).encode()
        self.store = JobStore(self._output / f"jobs-{config.fri.bind_port}")
        self._hold_when_checked: set[str] = set()
        for sentence in self.store.unreadable:
            tell(f"A job could not be read and is left out: {sentence}")

    def recover(self) -> list[Job]:
        """Settle what an earlier service left under way; the jobs whose motion is still to be checked."""
        for job in self.store.all("run", "queued", "preparing"):
            self.hold(job.job_id)
        for job in self.store.all("run", "running"):
            self._settle(job)
        for job in self.store.all("fit", "running"):
            if job.worker_pid is None or not fit_is_alive(job.worker_pid, Path(job.folder)):
                self._begin_again(job)
        self._ask_from_now_on()  # the arm behind this address may be another one, and a real one
        unchecked = self.store.all("run", "checking")
        self._hold_when_checked.update(job.job_id for job in unchecked)
        return unchecked

    def _settle(self, job: Job) -> None:
        """A run whose supervisor closed its books has ended; any other one was interrupted."""
        try:
            outcome = read_json(Path(job.folder) / "run.json", RunOutcome)
        except DaemonError:
            outcome = None
        # The loop writes the account of a run whose supervisor, an earlier service, was lost.
        if outcome is None or (outcome.loop is not None and outcome.loop.reason == "SUPERVISOR_LOST"):
            self.store.change(
                job.job_id,
                "interrupted",
                "The service ended during this run, whereupon the loop stops the arm by itself. What was recorded is "
                f"in {job.folder}; `iiwa-ident recover` makes a broken-off log whole.",
                exit_code=EXIT_INTERRUPTED,
            )
        else:
            ended = RunEnded(job.job_id, outcome, " ".join(outcome.sentences), outcome.exit_code)
            if self.run_ended(ended):
                self.queue_fit(job.job_id)

    def _begin_again(self, job: Job) -> None:
        if job.attempts >= _MAXIMUM_ATTEMPTS:
            self.store.change(
                job.job_id, "failed", f"The fit was begun {job.attempts} times and never ended.", exit_code=70
            )
        else:
            self.store.change(job.job_id, "queued", "Waits to be fitted again.", worker_pid=None)

    # ---- runs

    def add(self, request: SubmitRun, done: Callable[[str, OSError | None], None]) -> None:
        """Take a run in; `done` is called once it is stored. Raises RefusedRequestError when too many wait."""
        if self.waiting() + self.held() >= MAXIMUM_WAITING:
            raise RefusedRequestError("queue_full", f"{MAXIMUM_WAITING} runs wait already; none is taken any more.", 69)
        job_id, run = new_job_id(self.store.jobs), self._config.run
        job = Job(
            job_id=job_id,
            kind="run",
            phase="checking",
            sentence="Its motion is being checked.",
            name=request.name,
            folder=str(self._output / job_id),
            periods=run.periods if request.periods is None else request.periods,
            amplitude=run.amplitude if request.amplitude is None else request.amplitude,
            confirmed=request.confirmed,
            suffix=None if request.trajectory is None else request.suffix,
            fit=run.fit if request.fit is None else request.fit,
        )
        self.store.add(job, request.trajectory, lambda error: done(job_id, error))

    def check_of(self, job: Job) -> PreparationJob:
        """The check at submission."""
        folder = self.store.folder_of(job.job_id)
        return self._preparation(job, folder / "checked", folder / "checked")

    def preparation_of(self, job: Job) -> PreparationJob:
        """The check before the run, which writes into the run's folder."""
        self.store.change(job.job_id, "preparing", "Its motion is checked once more.")
        return self._preparation(job, Path(job.folder), self.store.folder_of(job.job_id) / "run")

    def _preparation(self, job: Job, out_dir: Path, answer_dir: Path) -> PreparationJob:
        decided = self._config.request_fields()
        settings = {name: decided[name] for name in decided if name not in ("robot", "amplitude")}
        # The fit is a job of its own, so that a restart does not lose it.
        settings.update(periods=job.periods, fit=False, simulation=self._config.is_simulation)
        if job.added_mass is not None:
            settings["added_mass"] = job.added_mass
        trajectory = job.trajectory or self.store.folder_of(job.job_id) / f"trajectory{job.suffix}"
        return PreparationJob(
            job_id=job.job_id,
            trajectory_file=None if job.suffix is None else str(trajectory),
            robot=self._config.robot,
            amplitude=job.amplitude,
            out_dir=str(out_dir),
            answer_dir=str(answer_dir),
            settings=settings,
        )

    def checked(self, job_id: str, verdict: Verdict) -> None:
        """The check at submission has ended. A job cancelled meanwhile stays so."""
        hold = job_id in self._hold_when_checked
        self._hold_when_checked.discard(job_id)
        if self.store.jobs[job_id].phase != "checking" or verdict.exit_code == EXIT_INTERRUPTED:
            return
        if not verdict.safe:
            self.store.change(job_id, "refused", verdict.sentence, exit_code=verdict.exit_code)
        elif hold:
            self.hold(job_id)
        else:
            self.store.change(job_id, "queued", f"{verdict.sentence} Waits for its turn.")

    def not_prepared(self, job_id: str, verdict: Verdict) -> None:
        """The check before the run was broken off, or found against it."""
        if verdict.exit_code == EXIT_INTERRUPTED:
            self.hold(job_id)
        else:
            self.store.change(job_id, "refused", verdict.sentence, exit_code=verdict.exit_code)

    def run_started(self, job_id: str) -> None:
        """The acquisition begins."""
        self.store.change(job_id, "running", "The acquisition is under way.")

    def run_ended(self, ended: RunEnded) -> bool:
        """Note how a run ended; True when as planned."""
        outcome = ended.outcome.outcome if ended.outcome is not None else None
        completed = outcome == "completed" and not ended.exit_code
        phase: JobPhase = "done" if completed else "stopped" if outcome in ("stopped", "dropped") else "failed"
        if outcome is None and ended.exit_code in _REFUSALS:
            phase = "refused"
        self.store.change(ended.job_id, phase, ended.sentence, exit_code=ended.exit_code)
        return completed

    def next_run(self) -> Job | None:
        """The run whose turn it is."""
        return self.store.first("run", "queued")

    def hold(self, job_id: str) -> None:
        """Let a run wait for the operator's word."""
        self.store.change(job_id, "held", _HELD)

    def hold_waiting(self) -> None:
        """The same for every run that waits, and for what an investigation that is thinking now will ask for."""
        for job in self.store.all("run", "queued"):
            self.hold(job.job_id)
        self._ask_from_now_on()
        self._hold_when_checked.update(job.job_id for job in self.store.all("run", "checking"))

    def _ask_from_now_on(self) -> None:
        """Investigations whose motions waited for nobody wait for the operator's word from now on."""
        for job in self.store.all("investigation", "queued", "running", "held"):
            if job.unasked:
                self.store.change(job.job_id, job.phase, job.sentence, unasked=False)

    def release(self, only: Sequence[str] | None = None) -> int:
        """Held runs take their turn again, all or these alone; how many."""
        held = [job for job in self.store.all("run", "held") if only is None or job.job_id in only]
        for job in held:
            self.store.change(job.job_id, "queued", "Waits for its turn.", confirmed=True)
        checked = self._hold_when_checked if only is None else self._hold_when_checked.intersection(only)
        released = len(held) + len(checked)
        self._hold_when_checked -= checked
        return released

    def cancel(self, job_id: str) -> str:
        """Take a waiting job out. Raises RefusedRequestError for one that is not there or does not wait."""
        job = self.store.jobs.get(job_id)
        if job is None:
            raise RefusedRequestError("no_such_job", f"There is no job {job_id} here.", 66)
        if job.phase not in ("checking", "queued", "held"):
            way = "`iiwa-ident stop` ends a motion" if job.phase in ("preparing", "running") else "it has ended"
            if job.kind == "fit" and job.phase == "running":
                way = "it moves nothing and ends by itself"
            if job.thinking:
                way = "it weighs what was recorded and moves nothing; once it asks for a motion, `cancel` ends it"
            raise RefusedRequestError("not_waiting", f"Job {job_id} is {job.phase} and cannot be cancelled: {way}.", 1)
        motions = [run for run in self.store.all("run", "queued", "held", "preparing") if run.asked_by == job_id]
        if begins := next((run.job_id for run in motions if run.phase == "preparing"), None):
            raise RefusedRequestError(
                "not_waiting",
                f"Job {job_id} cannot be cancelled now: its motion {begins} is about to begin, and `iiwa-ident stop` "
                "holds it.",
                1,
            )
        for motion in motions:
            self.store.change(
                motion.job_id, "cancelled", "Its investigation was cancelled.", exit_code=EXIT_INTERRUPTED
            )
        said = "Cancelled; nothing of it will move."
        return self.store.change(job_id, "cancelled", said, exit_code=EXIT_INTERRUPTED).sentence

    # ---- fits

    def queue_fit(self, run_id: str) -> None:
        """A fit of a run that ended as planned, if one was asked for."""
        run = self.store.jobs[run_id]
        if not run.fit:
            return
        job = Job(
            job_id=f"{run_id}-fit",
            kind="fit",
            phase="queued",
            sentence="Waits to be fitted.",
            name=run.name,
            folder=run.folder,
        )
        self.store.add(job, None)

    def next_fit(self) -> Job | None:
        """The fit to begin, or to watch again after a restart."""
        return self.store.first("fit", "running") or self.store.first("fit", "queued")

    def fit_started(self, job_id: str, pid: int) -> None:
        """The fit's process runs."""
        attempts = self.store.jobs[job_id].attempts + 1
        self.store.change(job_id, "running", "The fit is under way.", worker_pid=pid, attempts=attempts)

    def fit_ended(self, ended: FitEnded) -> None:
        """Note how a fit ended."""
        phase: JobPhase = "failed" if ended.exit_code else "done"
        self.store.change(ended.job_id, phase, ended.sentence, exit_code=ended.exit_code)

    # ---- views

    def views(self, limit: int, job_id: str | None = None, *, held: bool = False) -> tuple[JobView, ...]:
        """The newest jobs first, or the one named; held: only those that `release` lets go."""
        if job_id is not None:
            job = self.store.jobs.get(job_id)
            if job is None:
                raise RefusedRequestError("no_such_job", f"There is no job {job_id} here.", 66)
            return (job.view(),)
        listed = [job for job in self.store.jobs.values() if not held or self._is_held(job)]
        return tuple(job.view() for job in reversed(listed[-limit:]))

    def _is_held(self, job: Job) -> bool:
        """Whether a run is held, or will be once its check has ended."""
        checked = job.phase == "checking" and job.job_id in self._hold_when_checked
        return job.kind == "run" and (job.phase == "held" or checked)

    def waiting(self) -> int:
        """Runs that will begin by themselves."""
        return len(self.store.all("run", "checking", "queued", "preparing"))

    def held(self) -> int:
        """Runs that wait for the operator's word."""
        return len(self.store.all("run", "held"))

    def close(self) -> None:
        """Write what is left."""
        self.store.close()
