"""The proof: concealed cases are drawn, sealed, diagnosed blind, and opened when the last diagnosis is in.

One lane a processor: each has a process that draws cases and keeps their labels, and a process that diagnoses what it
is pointed at. This one carries paths from the one to the other, publishes each label's salted hash before its
recordings are diagnosed, and checks it when the label is opened.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import secrets
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

from daemon.errors import ProofProcessError
from daemon.proof.score import CaseScore, score_case
from daemon.seal import opened

GENERATOR = ("-m", "fixtures.cases", "--serve")
WORKER = ("-m", "daemon.proof.worker")
_KEPT_OF_DIAGNOSIS = (
    "verdict", "baseline", "findings", "classes", "class_model", "data_faults", "heldout", "not_identifiable_here",
    "remaining",
)  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class ProvenCase:
    """One case from seal to score. name: what the diagnosing side saw of it, the random name of its folder."""

    index: int
    name: str
    commitment: str
    label: dict[str, Any]
    diagnosis: dict[str, Any] | None
    score: CaseScore
    error: str | None = None


class LineProcess:
    """A child that answers one JSON line with one JSON line."""

    def __init__(self, arguments: Sequence[str]) -> None:
        self._arguments = arguments
        self._closed = False
        self._begin()

    def _begin(self) -> None:
        self._child = subprocess.Popen(
            [sys.executable, *self._arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
            start_new_session=True,  # Ctrl-C is for this process, which then ends its children
        )

    def ask(self, request: dict[str, Any]) -> dict[str, Any]:
        """The child's answer. Raises ProofProcessError when it has gone."""
        assert self._child.stdin is not None
        assert self._child.stdout is not None
        with contextlib.suppress(BrokenPipeError):
            self._child.stdin.write(json.dumps(request) + "\n")
            self._child.stdin.flush()
        line = self._child.stdout.readline()
        if not line.endswith("\n"):  # nothing, or what it had written when it was killed
            raise ProofProcessError(" ".join(self._arguments), self._child.wait())
        answer: dict[str, Any] = json.loads(line)
        return answer

    def close(self) -> None:
        """End the child at once: the answer that it is at is not waited for."""
        self._closed = True
        self._end()

    def _end(self) -> None:
        self._child.kill()
        with contextlib.suppress(BrokenPipeError), self._child:
            pass  # its pipes are closed, and it is waited for


class _Diagnoser(LineProcess):
    """The process that diagnoses; started anew when it has gone, and the case it was on is answered by that."""

    def ask(self, request: dict[str, Any]) -> dict[str, Any]:
        """The diagnosis, or {"error": …}. Raises ProofProcessError once it is closed."""
        try:
            return super().ask(request)
        except ProofProcessError as error:
            if self._closed:
                raise
            self._end()
            self._begin()
            return {"error": str(error)}


@dataclass(frozen=True, slots=True)
class Source:
    """Where cases come from: world and seed; sealed: the world's sealed families; recordings: folder of real ones."""

    seed: int
    world: str = "library"
    sealed: bool = False
    recordings: Path | None = None

    @property
    def arguments(self) -> tuple[str, ...]:
        """Of the process that draws the cases."""
        return (
            *GENERATOR, "--seed", str(self.seed), "--world", self.world,
            *(("--sealed",) if self.sealed else ()),
            *(() if self.recordings is None else ("--recordings", str(self.recordings))),
        )  # fmt: skip


def select_cases(source: Source, cases: int, only: str | None) -> list[int]:
    """Numbers of a source's first `cases` cases; only: of one group, one family in it, or one family: 'single/gain'."""
    if only is None:
        return list(range(cases))
    group, _, family = only.partition("/")
    chosen: list[int] = []
    with contextlib.closing(LineProcess(source.arguments)) as generator:
        for index in range(200 * cases + 1000):
            plan = generator.ask({"plan": index})
            names = (*plan["families"], plan["kind"])
            if group in ("", plan["group"]) and (not family or family in names):
                chosen.append(index)
            if len(chosen) == cases:
                break
    return chosen


def prove(
    source: Source,
    indices: Sequence[int],
    *,
    jobs: int,
    worker: Sequence[str] = WORKER,
    report: bool = False,
    pages: Path | None = None,
    publish: Callable[[str, str], None],
    progress: Callable[[int, int], None] | None = None,
    minutes: float = math.inf,
) -> list[ProvenCase]:
    """Diagnose cases of a source blind and score them, in the order of their numbers.

    minutes: after which no further case is begun; those that are done are opened and scored. report: each diagnosis is
    also written as a report, within the time of its case. pages: folder that keeps them, each as `page_name` says;
    given, there are reports. A case without a diagnosis (an error, or a process that was
    killed, which is started anew) is wrong in every count.
    publish(name, commitment) is called for each case before its recordings are diagnosed. worker: arguments of the
    Python process that diagnoses. Raises SealBrokenError when an opened label is not the sealed one, ProofProcessError
    when the process that keeps the labels has gone.
    """
    end = time.monotonic() + 60.0 * minutes
    waiting: SimpleQueue[int] = SimpleQueue()
    for index in indices:
        waiting.put(index)
    lanes = max(1, min(jobs, len(indices)))
    count = iter(range(1, len(indices) + 1))
    with (
        tempfile.TemporaryDirectory(prefix="iiwa-ident-prove-") as scratch,
        ThreadPoolExecutor(lanes) as pool,
        contextlib.ExitStack() as stack,
    ):
        processes = [
            (
                stack.enter_context(contextlib.closing(LineProcess(source.arguments))),
                stack.enter_context(contextlib.closing(_Diagnoser(worker))),
            )
            for _ in range(lanes)
        ]

        def run_lane(generator: LineProcess, diagnoser: _Diagnoser) -> list[dict[str, Any]]:
            done = []
            for index in _drain(waiting, end):
                done.append(_diagnose_blind(generator, diagnoser, index, Path(scratch), publish, report, pages))
                if progress is not None:
                    progress(next(count), len(indices))
            return done

        blind = [future.result() for future in [pool.submit(run_lane, *pair) for pair in processes]]
        # Not before the last diagnosis is in: now the labels are opened.
        known = [
            (case, opened(case["name"], case["commitment"], generator.ask({"open": case["index"]})))
            for (generator, _), lane in zip(processes, blind, strict=True)
            for case in lane
        ]
    bare = {label["recording"]: case["answer"].get("diagnosis") for case, label in known if label["group"] == "bare"}
    proven = [_scored(case, label, bare.get(label.get("recording"))) for case, label in known]
    return sorted(proven, key=lambda case: case.index)


def page_name(index: int) -> str:
    """File name of a case's page, by the case's number."""
    return f"case-{index:04d}.html"


def _drain(waiting: SimpleQueue[int], end: float) -> Iterator[int]:
    while time.monotonic() < end:
        try:
            yield waiting.get_nowait()
        except Empty:
            return


def _diagnose_blind(
    generator: LineProcess,
    diagnoser: _Diagnoser,
    index: int,
    scratch: Path,
    publish: Callable[[str, str], None],
    report: bool,
    pages: Path | None,
) -> dict[str, Any]:
    name = secrets.token_hex(8)  # the folder's name tells nothing of the case
    folder = scratch / name
    drawn = generator.ask({"draw": index, "folder": str(folder)})
    publish(name, drawn["commitment"])
    request: dict[str, Any] = {"recordings": drawn["recordings"], "heldout": drawn["heldout"]}
    if report or pages is not None:
        request["report"] = str(folder / "report.html")
    answer = diagnoser.ask(request)
    page = folder / "report.html"
    if pages is not None and page.is_file():
        shutil.move(page, pages / page_name(index))
    shutil.rmtree(folder)
    return {"index": index, "name": name, "commitment": drawn["commitment"], "answer": answer}


def _scored(case: dict[str, Any], label: dict[str, Any], bare: dict[str, Any] | None) -> ProvenCase:
    answer = case["answer"]
    diagnosis = answer.get("diagnosis")
    error = answer.get("error")
    score = score_case(label, diagnosis, float(answer.get("seconds", 0.0)), error, bare)
    kept = {name: diagnosis[name] for name in _KEPT_OF_DIAGNOSIS if name in diagnosis} if diagnosis else None
    return ProvenCase(case["index"], case["name"], case["commitment"], label, kept, score, error)
