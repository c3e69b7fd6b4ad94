"""The rules of investigations in the queue: steps that think, and runs between them that wait for the operator.

Here: `Investigations`, used by the control thread of `server` alone, beside `JobQueue`. Not here: how a step is taken
(`investigation_step`), and the run itself, which every rule of the queue holds for: its motion is checked once more,
a stop holds it, a restart holds it, and the gate and the ladder stand where they stand for every run.

    investigation:  queued -> running (a step) -> held (its motion waits) -> running (is driven) -> queued -> ...
                    running -> done | stopped | failed;  queued or held -> cancelled;  ended -> queued (gone on with)
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import msgspec

from daemon.config import DaemonConfig
from daemon.queue.control_api import JobPhase, RefusedRequestError, SubmitInvestigation
from daemon.queue.investigation_step import Order, StepEnded
from daemon.queue.job_store import ENDED, MAXIMUM_WAITING, Job, JobStore
from daemon.run.ladder import RUNGS
from daemon.times import new_job_id

_NOT_DRIVEN: frozenset[JobPhase] = frozenset({"checking", "queued", "held", "preparing"})


class Investigations:
    """All investigations of one service, and what becomes of them."""

    def __init__(self, config: DaemonConfig, store: JobStore) -> None:
        self._config, self._store = config, store
        self._output = Path(config.output).absolute()

    def recover(self) -> None:
        """A step that was under way is taken again: it moves nothing. What waits for the operator goes on waiting."""
        for job in self._store.all("investigation", "running"):
            if job.thinking:
                self._store.change(job.job_id, "queued", "Thinks again after a restart.", thinking=False)

    # ---- requests

    def add(self, request: SubmitInvestigation, done: Callable[[str, OSError | None], None]) -> None:
        """Take one in, or go on with one that rests; `done` is called once it is stored. Raises RefusedRequestError."""
        if request.done is not None and request.added_mass is not None:
            reason = "--done and --added-mass are two actions, and one motion shows what one of them does."
            raise RefusedRequestError("two_actions", reason, 2)
        if request.job_id is not None:
            self._go_on(request, request.job_id)
            done(request.job_id, None)
            return
        if request.budget_minutes is None:
            raise RefusedRequestError(
                "no_budget", "Say how many minutes of motion may be recorded at most (--budget).", 2
            )
        if request.done is not None:
            reason = "--done answers what an investigation asked for, and this one only begins."
            raise RefusedRequestError("nothing_asked", reason, 2)
        if len(self._store.all("investigation", "queued", "running", "held")) >= MAXIMUM_WAITING:
            raise RefusedRequestError("queue_full", f"{MAXIMUM_WAITING} investigations are open already.", 69)
        runs = [self._store.jobs.get(number) for number in request.recordings]
        for number, run in zip(request.recordings, runs, strict=True):
            if run is None or run.kind != "run":
                raise RefusedRequestError("no_such_job", f"There is no run {number} here.", 66)
        job_id = new_job_id(self._store.jobs)
        folder, run_settings = str(self._output / job_id), self._config.run
        order = Order(
            folder=folder,
            robot=self._config.robot,
            workspace_file=run_settings.workspace_file,
            tool=run_settings.tool,
            serial=run_settings.serial or "",
            gravity_m_s2=run_settings.gravity_m_s2,
            budget_s=60.0 * request.budget_minutes,
            recordings=tuple(run.folder for run in runs if run is not None),
        )
        job = Job(
            job_id=job_id,
            kind="investigation",
            phase="queued",
            sentence="Waits to think about its first motion.",
            name="investigation",
            folder=folder,
            order=_asked(order, request),
            unasked=request.unasked,
        )
        self._store.add(job, None, lambda error: done(job_id, error))

    def _go_on(self, request: SubmitInvestigation, job_id: str) -> None:
        job = self._store.jobs.get(job_id)
        if job is None or job.order is None:
            raise RefusedRequestError("no_such_job", f"There is no investigation {job_id} here.", 66)
        if job.phase not in ENDED:
            raise RefusedRequestError(
                "not_at_rest", f"Investigation {job_id} is {job.phase}; it can be gone on with once it rests.", 1
            )
        budget = None if request.budget_minutes is None else 60.0 * request.budget_minutes
        # The run that was told of last is asked once more where nobody knew how it had ended.
        order = msgspec.structs.replace(
            _next_order(job.order), goes_on=True, budget_s=budget, run=job.order.run, rung=job.order.rung
        )
        self._store.change(
            job_id, "queued", "Goes on.", order=_asked(order, request), unasked=request.unasked, exit_code=None
        )

    # ---- steps

    def next_step(self) -> Job | None:
        """The investigation whose turn it is to think."""
        return self._store.first("investigation", "queued")

    def step_of(self, job: Job) -> Order:
        """The step to take, which is under way from now on."""
        assert job.order is not None
        self._store.change(job.job_id, "running", "Weighs what the recordings say.", thinking=True)
        return job.order

    def step_ended(self, ended: StepEnded) -> None:
        """A motion to ask for, or rest. One that was cancelled meanwhile stays so."""
        job = self._store.jobs[ended.job_id]
        answer = ended.answer
        if job.phase != "running" or not job.thinking:
            return
        if answer.trajectory is not None:
            job = self._store.change(
                job.job_id, "held", answer.sentence, asks=answer.sentence, thinking=False, number=answer.number,
                periods=answer.periods, added_mass=answer.added_mass, trajectory=answer.trajectory,
            )  # fmt: skip
            self._ask_for(job, RUNGS[-1] if self._config.is_simulation else RUNGS[0])
            return
        phase: JobPhase = "stopped" if answer.moved_badly else "done" if answer.exit_code in (0, 1) else "failed"
        self._store.change(job.job_id, phase, answer.sentence, thinking=False, exit_code=answer.exit_code)

    def _ask_for(self, job: Job, amplitude: float) -> None:
        """Put the next motion, or the next rung of its ladder, into the queue, where it waits for the operator."""
        motions = job.motions + 1
        whole = amplitude >= RUNGS[-1]
        run_id = _run_of(job.job_id, motions)
        waits = (
            "Takes its turn by itself."
            if job.unasked
            else f"It waits for `iiwa-ident resume`; `cancel {run_id}` declines it."
        )
        rung = f"Motion {job.number} " + ("" if whole else f"at amplitude {amplitude:g} first, one period ")
        self._store.change(job.job_id, "held", f"{job.asks} {waits}", motions=motions)
        run = Job(
            job_id=run_id,
            kind="run",
            phase="queued" if job.unasked else "held",
            sentence=waits,
            name=f"{rung}of {job.job_id}",
            folder=str(Path(job.folder) / f"motion-{motions:02d}"),
            periods=job.periods if whole else 1,
            amplitude=amplitude,
            suffix=".json",
            trajectory=job.trajectory,
            asked_by=job.job_id,
            added_mass=job.added_mass,
        )
        self._store.add(run, None)

    def follow(self) -> None:
        """What became of the motions that were asked for; called in every turn."""
        for job in self._store.all("investigation", "held", "running"):
            run = self._store.jobs.get(_run_of(job.job_id, job.motions))
            if job.thinking or (run is not None and run.phase in _NOT_DRIVEN):
                continue
            if run is not None and run.phase == "running":
                if job.phase == "held":
                    self._store.change(job.job_id, "running", f"{job.asks} It is driven as {run.job_id}.")
            elif run is not None and run.phase == "done" and run.amplitude < RUNGS[-1]:
                self._ask_for(job, next(rung for rung in RUNGS if rung > run.amplitude))
            else:
                self._tell_of(job, run)

    def _tell_of(self, job: Job, run: Job | None) -> None:
        """Have the next step told how the motion ended. run: None where its record is lost."""
        assert job.order is not None
        order = _next_order(job.order)
        if run is not None and run.phase == "cancelled":
            order = msgspec.structs.replace(order, number=job.number, declined=True)
        else:
            folder = str(Path(job.folder) / f"motion-{job.motions:02d}")
            said = ("The record of its run is lost.", 1) if run is None else (run.sentence, run.exit_code or 1)
            rung = not self._config.is_simulation if run is None else run.amplitude < RUNGS[-1]
            order = msgspec.structs.replace(
                order, number=job.number, run=folder, rung=rung, run_sentence=said[0], run_exit_code=said[1]
            )
        self._store.change(job.job_id, "queued", "Waits to weigh what was recorded.", order=order)


def _run_of(job_id: str, motions: int) -> str:
    return f"{job_id}-motion-{motions:02d}"


def _asked(order: Order, request: SubmitInvestigation) -> Order:
    """With what an operator says on beginning or going on."""
    return msgspec.structs.replace(
        order, settle=request.settle, done=request.done, added_mass=request.added_mass, after_drop=request.after_drop
    )


def _next_order(order: Order) -> Order:
    """The order of a step that follows one: the same arm, and nothing that was said for that one."""
    return Order(
        folder=order.folder,
        robot=order.robot,
        workspace_file=order.workspace_file,
        tool=order.tool,
        serial=order.serial,
        gravity_m_s2=order.gravity_m_s2,
        seed=order.seed,
    )
