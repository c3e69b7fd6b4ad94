"""The proof of the closed loop: sealed cases that are recorded on request, investigated by three arms of equal motion.

Ours chooses its motions; the second drives random admissible ones; the third repeats the shipped excitation. All three
begin with the same two recordings and have the same minutes after them. The label stays in the process that plays the
robot until the last arm has given its answer. Simulated time: nothing here waits.
"""

from __future__ import annotations

import contextlib
import itertools
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np

from daemon.investigate.account import Account, Motion, Recorded, Step, read_account
from daemon.investigate.loop import Drive, Investigation, Tell
from daemon.investigate.motions import FIRST_PERIODS, SECOND_PERIODS
from daemon.investigate.states import State
from daemon.investigate.story import write_story
from daemon.motion.preparation import check_table
from daemon.proof.prove import LineProcess, page_name
from daemon.seal import opened
from identification.excitation import (
    Trajectory,
    default_trajectory,
    iiwa_limits,
    load_trajectory,
    validation_trajectory,
)
from identification.fitting.settings import silent
from identification.investigation.actions import Action
from identification.investigation.equivalences import INVISIBLE
from identification.investigation.experiments import PERIOD_S, Room, experiment

ROBOT = "iiwa14"
Arm = Literal["chosen", "random", "repeated"]
ARMS: tuple[Arm, ...] = ("chosen", "random", "repeated")
FURTHER_S = 120.0
_ONE_MOTION = 4
TOLD_APART = 100.0
"""Odds at which one of a pair is out, as they let a name stand alone (docs/mismatch.md)."""
MASS_KG, MASS_PLACE_M = 2.0, (0.02, 0.0, 0.05)


@dataclass(frozen=True, slots=True)
class Answer:
    """What one arm says in the end. named: the hidden effect, alone, with its joint; where no motion tells, the right
    answer after the action that was asked for. wrong: names and answers that are not true.

    leader_right: whether the leading hypothesis stands out and is the hidden effect. told_apart: whether the form that
    looks like the hidden one is out, so that the pair is settled, with or without a name; None where there is no pair.
    seconds: of motion after the first two recordings. limits_broken: at the robot's side, over all its motions.
    """

    arm: Arm
    named: bool
    wrong: tuple[str, ...]
    leader_right: bool
    told_apart: bool | None
    seconds: float
    state: str
    limits_broken: int


@dataclass(frozen=True, slots=True)
class LoopCase:
    """One case: what was known before, the answers of the arms, and (forecast, came true) of each chosen motion."""

    index: int
    commitment: str
    label: dict[str, Any]
    before: Answer
    answers: tuple[Answer, ...]
    forecasts: tuple[tuple[float, bool], ...]


class _RequestDriver:
    """Drives motions by asking the process that plays the robot; the preflight is the true one."""

    def __init__(self, robot: LineProcess) -> None:
        self._robot = robot
        self.broken = 0

    def objection(self, trajectory: Path) -> str:
        return check_table(load_trajectory(trajectory).table(), ROBOT).objection

    def drive(self, motion: Motion, trajectory: Path, folder: Path) -> Drive:
        out = self.record(load_trajectory(trajectory), motion.periods, folder)
        return Drive("recorded", out, "")

    def stated(self) -> None:
        return None

    def ended(self, folder: Path) -> Drive | None:
        del folder
        return None

    def act(self, action: Action) -> None:
        """Have the operator do something to the arm."""
        mass = {"mass_kg": MASS_KG, "place_m": MASS_PLACE_M} if action is Action.ADD_MASS else {}
        self._robot.ask({"act": action.value, "with": mass})

    def record(self, trajectory: Trajectory, periods: int, folder: Path) -> Path:
        """One recording in a folder."""
        folder.mkdir(parents=True, exist_ok=True)
        table, out = folder / "table.npy", folder / "recording.npz"
        np.save(table, trajectory.table())
        answer = self._robot.ask({"record": str(table), "periods": periods, "out": str(out)})
        self.broken = int(answer["limits_broken"])
        return out


def prove_closed_loop(
    seed: int, indices: Sequence[int], scratch: Path, *, tell: Tell, pages: Path | None = None
) -> list[LoopCase]:
    """Investigate cases of a seed. scratch: folder for what is recorded. pages: folder that keeps each case's story.

    Raises SealBrokenError, ProofProcessError.
    """
    cases = []
    with contextlib.closing(LineProcess(("-m", "fixtures.cases", "--serve-requests", "--seed", str(seed)))) as robot:
        for index in indices:
            folder = scratch / f"case-{index:03d}"
            cases.append(_one_case(robot, seed, index, folder, tell))
            account = read_account(folder / "chosen")
            if pages is not None and account is not None:
                pages.mkdir(parents=True, exist_ok=True)
                shutil.move(write_story(folder / "chosen", account), pages / page_name(index))
            shutil.rmtree(folder)
    return cases


def _one_case(robot: LineProcess, seed: int, index: int, folder: Path, tell: Tell) -> LoopCase:
    driver = _RequestDriver(robot)
    first, second = default_trajectory(ROBOT), validation_trajectory(ROBOT)
    folder.mkdir(parents=True)
    np.save(folder / "first.npy", first.table())
    begun = robot.ask({"begin": index, "table": str(folder / "first.npy"), "periods": FIRST_PERIODS})
    tell(f"case {index}: label sealed, sha256 {begun['commitment']}")
    recordings = tuple(
        Recorded(file=str(driver.record(motion, periods, folder / name)))
        for motion, periods, name in ((first, FIRST_PERIODS, "first"), (second, SECOND_PERIODS, "second"))
    )
    question = begun["question"]
    wanted = (question,) if question in INVISIBLE else ()
    start = Account(robot=ROBOT, seed=seed + index, budget_s=FURTHER_S, recordings=recordings, wanted=wanted)
    accounts, broken = {}, {}
    # What no motion settles is no race of motions. What an operator does to the arm stays done, and who chooses asks.
    driven: list[Arm] = ["chosen"] if question else sorted(ARMS, key=lambda arm: arm == "chosen")
    for arm in driven:
        before = driver.broken
        accounts[arm] = _ARMS[arm](start, driver, folder / arm, tell)
        broken[arm] = driver.broken - before
    seal = robot.ask({"open": index})
    label = opened(str(index), begun["commitment"], seal)
    answers = tuple(
        answer_of(arm, accounts[arm], accounts[arm].steps[-1], label, broken[arm]) for arm in ARMS if arm in accounts
    )
    chosen = accounts["chosen"]
    known_before = answer_of("chosen", start, chosen.steps[0], label, 0)
    return LoopCase(index, begun["commitment"], label, known_before, answers, forecasts_of(chosen, label))


def _chosen(start: Account, driver: _RequestDriver, folder: Path, tell: Tell) -> Account:
    """Goes on until it rests, the operator doing what is asked for, each thing once."""
    account = start
    for _ in range(len(Action)):
        loop = Investigation(folder, account, driver, ask=lambda _: True, tell=tell, progress=silent)
        if account.state is State.NEEDS_ACTION:
            loop.resume(acted=account.asks[0])
        account = loop.run()
        if account.state is not State.NEEDS_ACTION or not account.asks:
            break
        action = account.asks[0]
        tell(f"The operator does what is asked for: {action.value}")
        driver.act(action)
        if action is Action.ADD_MASS:
            account = msgspec.structs.replace(account, added_mass=(MASS_KG, *MASS_PLACE_M))
    return account


def _random(start: Account, driver: _RequestDriver, folder: Path, tell: Tell) -> Account:
    """Random Fourier motions that the preflight accepts, as many as there is time for, and one diagnosis of them."""
    random = np.random.default_rng([start.seed, 7])
    room = Room(iiwa_limits(ROBOT), default_trajectory(ROBOT).offset)
    account = start
    while account.left_s >= _ONE_MOTION * PERIOD_S:
        trajectory = experiment(random, room, "fourier", None).trajectory(ROBOT)
        if not check_table(trajectory.table(), ROBOT).safe:
            continue
        out = driver.record(trajectory, _ONE_MOTION, folder / f"random-{len(account.recordings)}")
        account = _with_recording(account, out, "random", _ONE_MOTION)
    return _known(account, driver, folder, tell)


def _repeated(start: Account, driver: _RequestDriver, folder: Path, tell: Tell) -> Account:
    """The shipped excitation again for all the time there is."""
    periods = int(start.budget_s / PERIOD_S)
    out = driver.record(default_trajectory(ROBOT), periods, folder / "repeated")
    return _known(_with_recording(start, out, "repeated", periods), driver, folder, tell)


_ARMS: dict[Arm, Callable[[Account, _RequestDriver, Path, Tell], Account]] = {
    "chosen": _chosen,
    "random": _random,
    "repeated": _repeated,
}


def _known(account: Account, driver: _RequestDriver, folder: Path, tell: Tell) -> Account:
    """What is known of an account's recordings when no motion more is asked for."""
    loop = Investigation(folder, account, driver, ask=lambda _: None, tell=tell, progress=silent)
    return loop.know()


def _with_recording(account: Account, file: Path, kind: str, periods: int) -> Account:
    motion = Motion(number=0, kind=kind, purpose=kind, trajectory="", periods=periods, seconds=periods * PERIOD_S)
    return msgspec.structs.replace(account, recordings=(*account.recordings, Recorded(file=str(file), motion=motion)))


def answer_of(arm: Arm, account: Account, step: Step, label: dict[str, Any], broken: int) -> Answer:
    """What an arm says after a step, held against the label. broken: limits that its motions broke."""
    truths = _truths(label)
    named = all(
        any(f.effect in names and f.joint == joint and not f.alternatives for f in step.findings)
        for names, joint in truths
    )
    wrong = tuple(
        f"{f.effect} at joint {f.joint}"
        for f in step.findings
        if not any(({f.effect, *f.alternatives} & names) and f.joint == joint for names, joint in truths)
    )
    used = account.used_s if account.recordings else 0.0
    if label.get("answer"):
        told = {item.answer for item in account.told if item.settled}
        named = label["answer"] in told
        wrong += tuple(f"{item} for {label['answer']}" for item in sorted(told - {label["answer"]}))
    apart = _told_apart(step, label) if label.get("rival") else None
    return Answer(arm, named and not wrong, wrong, _leads(step, label), apart, used, account.state.value, broken)


def _truths(label: dict[str, Any]) -> list[tuple[set[str], int | None]]:
    """Of each hidden effect: the names that are right for it, and its joint."""
    return [(set(item["acceptable"]) | {item["effect"]}, item["joint"]) for item in label["effects"]]


def _leads(step: Step, label: dict[str, Any]) -> bool:
    """Whether what is settled or leads is what was hidden."""
    known = {(item.effect, item.joint) for item in step.findings if not item.alternatives}
    if not label["effects"]:
        return not known and step.alive[0].effect is None
    truths = _truths(label)
    leader = (step.alive[0].effect, step.alive[0].joint)
    seen = known | ({leader} if step.stands_out else set())
    return all(any(effect in names and joint == place for effect, place in seen) for names, joint in truths)


def _told_apart(step: Step, label: dict[str, Any]) -> bool:
    """Whether the hidden form has its name, or may be there, 100 times as likely as the one that looks like it."""
    ((names, joint),), rival = _truths(label), label["rival"]
    said = [item for item in step.findings if item.joint == joint]
    if any(rival in (item.effect, *item.alternatives) for item in said):
        return False
    right, wrong = (
        max((item.probability for item in step.alive if item.joint == joint and item.effect in ours), default=0.0)
        for ours in (names, {rival})
    )
    return any(item.effect in names for item in said) or (right > 0.0 and right >= TOLD_APART * wrong)


def forecasts_of(account: Account, label: dict[str, Any]) -> tuple[tuple[float, bool], ...]:
    """Forecast of each motion that had one, and whether the truth had its name after it, or was rightly nothing.

    Where the truth had its name before, the forecast is of what is left, which is nothing.
    """
    steps = {step.recordings: step for step in account.steps}
    answers = {count: answer_of("chosen", account, step, {**label, "answer": ""}, 0) for count, step in steps.items()}
    found = []
    for number, recorded in enumerate(account.recordings, start=1):
        if recorded.motion is not None and recorded.motion.forecast is not None and number in steps:
            step, answer = steps[number], answers[number]
            before = answers.get(number - 1)
            nothing_left = step.stands_out and step.alive[0].effect is None
            came = answer.leader_right and step.stands_out
            if label["effects"]:
                came = answer.named and (nothing_left or before is None or not before.named)
            found.append((recorded.motion.forecast, came))
    return tuple(found)


def reliability(forecasts: Sequence[tuple[float, bool]]) -> list[tuple[str, int, float, float]]:
    """Per bin of forecasts: its range, how many, their mean, and the share that came true."""
    table = []
    for low, high in itertools.pairwise((0.0, 0.5, 0.8, 0.95, 1.0)):
        inside = [(p, came) for p, came in forecasts if low <= p < high or p == high == 1.0]
        if inside:
            mean, share = (float(np.mean([item[k] for item in inside])) for k in (0, 1))
            table.append((f"{100 * low:.0f} to {100 * high:.0f} %", len(inside), mean, share))
    return table
