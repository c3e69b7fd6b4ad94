"""One step of an investigation in the service's queue: `python -m daemon.investigate.queued --order FILE`.

The loop is that of the command (`loop`), and so are its states and its account. Only driving is another's: a motion is
asked for by ending the step in PLANNED; the service has it driven as a run of its queue, once the operator says
`resume`; the next step is told how that run ended and goes on from there.
"""

from __future__ import annotations

import argparse
import fcntl
import sys
from pathlib import Path

import msgspec

from daemon.circles import look_seldom
from daemon.errors import exit_code_of, sentence_of
from daemon.investigate.account import Account, Motion, read_account, save
from daemon.investigate.begin import begun, exit_code
from daemon.investigate.driver import ended_in
from daemon.investigate.loop import Drive, Investigation
from daemon.investigate.motions import describe_motion
from daemon.investigate.same_arm import Stated
from daemon.investigate.states import RESTING, State
from daemon.investigate.story import write_story
from daemon.json_files import read_json, write_json
from daemon.motion.preparation import prepare_motion
from daemon.motion.tool import FastenedMass, fastened, read_tool
from daemon.motion.workspace import load_surroundings
from daemon.queue.investigation_step import ANSWER_NAME, Order, StepAnswer
from identification.fitting.settings import silent
from identification.investigation.actions import Action
from identification.robots import Installation
from identification.robots.installation import ON_THE_FLOOR


class _QueueDriver:
    """Drives nothing: says how the queue's run ended that drove the pending motion."""

    def __init__(self, order: Order, robot: str, added_mass: FastenedMass | None) -> None:
        self._order, self._robot, self._added_mass = order, robot, added_mass

    def objection(self, trajectory: Path) -> str:
        order = self._order
        return prepare_motion(
            trajectory,
            robot=self._robot,
            workspace=None if order.workspace_file is None else Path(order.workspace_file),
            tool=read_tool(order.tool, is_name=True),
            added_mass=self._added_mass,
            installation=None if order.gravity_m_s2 is None else Installation(order.gravity_m_s2),
        ).preflight.objection

    def drive(self, motion: Motion, trajectory: Path, folder: Path) -> Drive:
        del motion, trajectory
        return self.ended(folder) or Drive("stopped", None, self._order.run_sentence, self._order.run_exit_code)

    def stated(self) -> Stated:
        order, tool = self._order, read_tool(self._order.tool, is_name=True)
        around = load_surroundings(order.robot, order.workspace_file, tool, self._added_mass)
        gravity = order.gravity_m_s2
        return Stated(order.serial, around.tool.describe(), ON_THE_FLOOR if gravity is None else Installation(gravity))

    def ended(self, folder: Path) -> Drive | None:
        del folder
        drive = None if self._order.run is None else ended_in(Path(self._order.run))
        completed = drive is not None and drive.outcome == "recorded"
        return None if completed and self._order.rung else drive  # a completed rung is no end of the motion


def step(order: Order) -> Account:
    """Go on until the investigation rests. Raises the errors of `begun` and of the loop."""
    folder = Path(order.folder)
    account = read_account(folder)
    began = account is None
    if account is None:
        given = [Path(file) for file in order.recordings]
        account = begun(given, order.robot, order.budget_s or 0.0, order.seed)
    elif order.budget_s is not None:
        account = msgspec.structs.replace(account, budget_s=order.budget_s)
    if order.settle:
        wanted = tuple(dict.fromkeys((*account.wanted, *order.settle)))
        account = msgspec.structs.replace(account, wanted=wanted)
    acted = None if order.done is None else Action(order.done)
    mass = fastened(order.added_mass, account.added_mass)
    if order.added_mass is not None and mass is not None:
        acted = Action.ADD_MASS
    if began:
        account = msgspec.structs.replace(account, added_mass=mass)
    account = save(folder, account)
    answers = _answers(order, account)
    if account.state in RESTING and not (began or order.goes_on or answers):
        return account  # this step was taken already, by a process that was killed before it could say so

    def ask(motion: Motion) -> bool | None:
        return answers.pop(motion.number, None)

    loop = Investigation(
        folder, account, _QueueDriver(order, account.robot, mass), ask=ask, tell=_tell, progress=silent
    )
    if not began:
        loop.resume(after_drop=order.after_drop, acted=acted, added_mass=order.added_mass)
    return loop.run()


def _answers(order: Order, account: Account) -> dict[int, bool]:
    """The operator's answer on the motion that was asked for last, as long as nothing came of it yet."""
    waits = account.state in (State.PLANNED, State.ASKING, State.RECORDING)
    pending = account.pending
    if not waits or pending is None or pending.number != order.number:
        return {}
    return {order.number: not order.declined} if order.declined or order.run is not None else {}


def answer_of(folder: Path, account: Account) -> StepAnswer:
    """What the service is told of an account that rests."""
    motion = account.pending if account.state is State.PLANNED else None
    sentence = " ".join([account.sentence, *account.actions]) if motion is None else describe_motion(motion)
    return StepAnswer(
        sentence=sentence,
        exit_code=exit_code(account),
        moved_badly=account.state in (State.INTERRUPTED, State.DROPPED, State.DECLINED),
        trajectory=None if motion is None else str(folder / motion.trajectory),
        number=0 if motion is None else motion.number,
        periods=0 if motion is None else motion.periods,
        added_mass=account.added_mass,
    )


def main(arguments: list[str] | None = None) -> int:
    """Entry of the process."""
    parser = argparse.ArgumentParser(
        prog="python -m daemon.investigate.queued", description="One step of an investigation in the queue."
    )
    parser.add_argument("--order", required=True, help="JSON file of an Order")
    order = read_json(parser.parse_args(arguments).order, Order)
    folder = Path(order.folder)
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # a step that outlived its service goes first
        try:
            account = step(order)
            write_story(folder, account)
            answer = answer_of(folder, account)
        except Exception as error:
            answer = StepAnswer(sentence=sentence_of(error), exit_code=exit_code_of(error))
        write_json(folder / ANSWER_NAME, answer)
    return answer.exit_code


def _tell(sentence: str) -> None:
    print(sentence, flush=True)


if __name__ == "__main__":
    look_seldom()
    sys.exit(main())
