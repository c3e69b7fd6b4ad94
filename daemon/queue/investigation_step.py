"""One step of an investigation that the service keeps: from what is known to the next motion, in a process of its own.

Here: what is handed to `python -m daemon.investigate.queued --order FILE`, what it answers, and the thread that waits
for it, at low priority because a motion may be under way. Not here: the step (`daemon.investigate.queued`), and what
becomes of the motion: it is a run of the queue like any other, which waits for the operator's word.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import psutil

from daemon.api import Message
from daemon.children import how_ended, start_python
from daemon.errors import exit_code_of, sentence_of
from daemon.folders import make_folder
from daemon.json_files import read_json, write_json

ORDER_NAME, ANSWER_NAME = "step-order.json", "step-answer.json"
_NICENESS = 10


class Order(Message, frozen=True, kw_only=True):
    """What one step begins with. folder: of the investigation. serial: of the service's arm, empty: unknown.

    budget_s, recordings, seed: for one that begins; budget_s of one that goes on is a new one. run: folder of the run
    that drove motion `number`, or a rung of its ladder (rung), or the last one where it goes on; run_sentence,
    run_exit_code: how that ended where the folder does not say. declined: the operator did not want that motion.
    settle, done, added_mass, after_drop: see SubmitInvestigation.
    """

    folder: str
    robot: str
    workspace_file: str | None = None
    tool: str = "none"
    serial: str = ""
    gravity_m_s2: tuple[float, float, float] | None = None
    budget_s: float | None = None
    recordings: tuple[str, ...] = ()
    seed: int = 1
    goes_on: bool = False
    number: int = 0
    run: str | None = None
    rung: bool = False
    run_sentence: str = ""
    run_exit_code: int = 1
    declined: bool = False
    settle: tuple[str, ...] = ()
    done: str | None = None
    added_mass: tuple[float, float, float, float] | None = None
    after_drop: bool = False


class StepAnswer(Message, frozen=True, kw_only=True):
    """Where the investigation rests. exit_code: as of `investigate`. moved_badly: its motion did not end as planned.

    trajectory: file of the motion that is asked for; None where none is. number, periods: of it. added_mass: on the
    flange now.
    """

    sentence: str
    exit_code: int
    moved_badly: bool = False
    trajectory: str | None = None
    number: int = 0
    periods: int = 0
    added_mass: tuple[float, float, float, float] | None = None


@dataclass(frozen=True, slots=True)
class StepEnded:
    """A step has ended."""

    job_id: str
    answer: StepAnswer


def start_step(job_id: str, order: Order, post: Callable[[StepEnded], None]) -> None:
    """Begin a step in a thread of its own; its end is posted, whatever it is."""

    def work() -> None:
        try:
            answer = _answer_to(order)
        except Exception as error:
            answer = StepAnswer(sentence=sentence_of(error), exit_code=exit_code_of(error))
        post(StepEnded(job_id, answer))

    threading.Thread(target=work, name="investigation", daemon=True).start()


def _answer_to(order: Order) -> StepAnswer:
    folder = Path(order.folder)
    make_folder(folder)
    answer, file = folder / ANSWER_NAME, folder / ORDER_NAME
    answer.unlink(missing_ok=True)
    write_json(file, order)
    with (folder / "investigation.log").open("ab") as words:
        process = start_python("daemon.investigate.queued", ["--order", str(file)], words)
    psutil.Process(process.pid).nice(_NICENESS)
    code = process.wait()
    if not answer.is_file():
        return StepAnswer(
            sentence=f"The investigation's process {how_ended(code)}; everything recorded is kept, and "
            "investigation.log has its last words. Submit it again with its number to go on.",
            exit_code=70,
        )
    return read_json(answer, StepAnswer)
