"""Local searches in several processes: tasks go in, outcomes come back as they end, late ones are broken off.

Here: fresh processes with one BLAS thread each. Which searches are worth while is `design`'s.
"""

from __future__ import annotations

import multiprocessing
import os
import sys
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.synchronize import Event
from typing import Any

import numpy as np

from identification.arrays import FloatArray
from identification.excitation.local_search import Descent, LocalSearch, Problem

_LOOK_S = 0.25


@dataclass(frozen=True, slots=True)
class Task:
    """One local search to run: which start, by which descents, and from where (None: draw it)."""

    start: int
    descents: tuple[Descent, ...]
    coefficients: FloatArray | None
    disturbed: float = 0.0
    """Share of a random motion that is mixed in before the search."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a search ended with: its start, its objective and the coefficients (n, 2 h)."""

    start: int
    value: float
    coefficients: FloatArray


_Run = Callable[[Iterable[Task], float, Callable[[float], bool], Callable[[], bool]], Iterator[Outcome]]
"""Tasks, the share of the budget after which none begins, whether it is before such a share, and whether those under
way may search on.
"""


_worker_search: LocalSearch | None = None
_time_is_up: Callable[[], bool] | None = None


def _start_worker(problem: Problem, stop: Event) -> None:
    global _worker_search, _time_is_up
    _worker_search, _time_is_up = LocalSearch(problem), stop.is_set


def _work(task: Task, seed: int) -> Outcome:
    search = _worker_search
    assert search is not None, "worker processes begin with _start_worker"
    coefficients = task.coefficients
    if coefficients is None:
        coefficients = search.random_start(np.random.default_rng([seed, task.start]))
    elif task.disturbed:
        other = search.random_start(np.random.default_rng([seed, task.start]))
        coefficients = (1.0 - task.disturbed) * coefficients + task.disturbed * other
    value = np.inf
    for descent in task.descents:
        value, coefficients = search.improve(coefficients, descent, _time_is_up)
    return Outcome(task.start, value, coefficients)


@contextmanager
def workers(problem: Problem) -> Iterator[_Run]:
    """A function that runs tasks in fresh processes, one each, while it may begin more, and breaks off late ones.

    Also with a single process: with one BLAS thread, results depend on seed and starts and on nothing else.
    """
    settings = problem.settings
    # Fresh interpreters: a forked child of a process with BLAS or ZeroMQ threads may hang.
    context = multiprocessing.get_context("spawn")
    stop = context.Event()
    with (
        _one_blas_thread_each(),
        ProcessPoolExecutor(
            settings.processes, mp_context=context, initializer=_start_worker, initargs=(problem, stop)
        ) as executor,
    ):

        def run_in_processes(
            tasks: Iterable[Task],
            begin_before: float,
            is_before: Callable[[float], bool],
            is_searching_time: Callable[[], bool],
        ) -> Iterator[Outcome]:
            waiting = iter(tasks)
            pending: set[Future[Outcome]] = set()
            first = True
            while True:
                # The first of a stage always runs: there is then a result, however short the budget.
                while len(pending) < settings.processes and (first or (is_before(begin_before) and not stop.is_set())):
                    task = next(waiting, None)
                    if task is None:
                        break
                    with _main_module_unread():
                        pending.add(executor.submit(_work, task, settings.seed))
                    first = False
                if not pending:
                    return
                # Searches under way are broken off in time for the ranking and the check at 1 kHz.
                if not stop.is_set() and not is_searching_time():
                    stop.set()
                finished, pending = wait(pending, None if stop.is_set() else _LOOK_S, return_when=FIRST_COMPLETED)
                for future in finished:
                    yield future.result()

        yield run_in_processes


@contextmanager
def _main_module_unread() -> Iterator[None]:
    """Children started inside do not read the main module: all they need is here, and a script that calls without a
    guard around it would begin anew in each of them.
    """
    main = sys.modules["__main__"].__dict__
    before: dict[str, Any] = {name: main.pop(name) for name in ("__file__", "__spec__") if name in main}
    main["__spec__"] = None
    try:
        yield
    finally:
        main.pop("__spec__")
        main.update(before)


@contextmanager
def _one_blas_thread_each() -> Iterator[None]:
    """Children started inside use one BLAS thread each; matrices this small only lose time over more."""
    names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
    before = {name: os.environ.get(name) for name in names}
    os.environ.update(dict.fromkeys(names, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
