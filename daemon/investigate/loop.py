"""The loop: diagnose, choose, check, ask, record, until nothing is open, no motion tells more, or the time is used.

Here: what is done in each state, and the account after each. Not here: the table (`states`), how a motion is driven
(`Driver`, which a real link and the proof each have their own of), and the mathematics
(`identification.investigation`).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

import msgspec
import numpy as np

from daemon.errors import ConfigurationError
from daemon.investigate.account import Account, Alive, Motion, Named, Recorded, Step, save
from daemon.investigate.states import RESTING, Event, State, after
from identification.excitation import Trajectory, default_trajectory, iiwa_limits, validation_trajectory
from identification.investigation.added_mass import AddedMass
from identification.investigation.choice import ENOUGH, PERIODS, Choice
from identification.investigation.equivalences import twins_of
from identification.investigation.experiments import PERIOD_S, Experiment, Room
from identification.investigation.forecast import stands_out
from identification.investigation.study import Study, study
from identification.recordings import Recording
from identification.recordings.reader import inputs_of, read_recording
from identification.robots import RobotModel

__all__ = ["FIRST_PERIODS", "Drive", "Driver", "Investigation", "smallest_budget_s"]

Tell = Callable[[str], None]
Progress = Callable[[str, float], None]
Ask = Callable[[Motion], bool]

FIRST_PERIODS, SECOND_PERIODS = 8, 4
LEAST_GAIN = 0.02
"""Rise of the probability to tell below which a motion is not worth its time for what it tells."""
MOST_CONFIRMING = 2
"""Motions in a row that add evidence where hypotheses are told apart and the diagnosis gives no name yet."""


@dataclass(frozen=True, slots=True)
class Drive:
    """How a motion ended. recording: what was recorded, None: nothing that can be used. exit_code: of the run."""

    outcome: Literal["recorded", "stopped", "dropped"]
    recording: Path | None
    sentence: str
    exit_code: int = 1


class Driver(Protocol):
    """Checks and drives a motion of a file."""

    def objection(self, trajectory: Path) -> str:
        """Why the motion must not be driven; empty where the preflight finds it safe."""
        ...

    def drive(self, motion: Motion, trajectory: Path, folder: Path) -> Drive:
        """Drive it and record into a folder."""
        ...

    def finished(self, folder: Path) -> Path | None:
        """The whole recording in a folder that a killed loop left behind; None where it is not whole."""
        ...


def smallest_budget_s(recordings: int) -> float:
    """Seconds of motion without which nothing can be told: what must come first, and one short motion."""
    first = (FIRST_PERIODS, SECOND_PERIODS)[recordings:]
    return PERIOD_S * (sum(first) + PERIODS[0])


class Investigation:
    """One investigation in its folder; `run` goes on until it rests, and returns the account."""

    def __init__(
        self,
        folder: Path,
        account: Account,
        driver: Driver,
        *,
        ask: Ask,
        tell: Tell,
        progress: Progress,
        plan_only: bool = False,
        room: Room | None = None,
    ) -> None:
        self._folder = folder
        self.account = account
        self._driver = driver
        self._ask, self._tell, self._progress = ask, tell, progress
        self._plan_only = plan_only
        self._room = room
        self._study: Study | None = None
        self._choices: Sequence[tuple[Choice | None, Motion, Trajectory]] = ()

    def run(self) -> Account:
        """Go on from where the account stands until it rests."""
        doing = {
            State.DIAGNOSING: self._diagnose,
            State.CHOOSING: self._choose,
            State.CHECKING: self._check,
            State.ASKING: self._question,
            State.RECORDING: self._record,
        }
        while self.account.state not in RESTING:
            event = doing[self.account.state]()
            self._keep(state=after(self.account.state, event))
        return self.account

    def know(self) -> Account:
        """What the recordings at hand say, and nothing more is asked of the arm."""
        self._diagnose()
        return self.account

    def resume(self, *, after_drop: bool = False, acted: bool = False) -> None:
        """Stand where a person may be asked again. Raises ConfigurationError after a drop that nobody released.

        A motion whose recording is whole on disk is taken as recorded; one that was broken off is asked for anew.
        """
        state = self.account.state
        if state is State.RECORDING and self._take_finished():
            self._keep(state=after(state, Event.RECORDED))
            return
        if state is State.SETTLED:
            return
        if state is State.DROPPED and not after_drop:
            raise ConfigurationError(
                "the robot dropped out of the session during the last motion, and nothing moves again by itself: look "
                "at the arm and the cabinet, then add --after-drop.",
                file=str(self._folder),
            )
        if state is State.NEEDS_ACTION and not acted:
            return
        if state is State.NEEDS_ACTION:
            self._keep(state=after(state, Event.ACTED))
            return
        event = Event.RELEASED if state is State.DROPPED else Event.RESUMED
        self._keep(state=after(state, event))

    # ---- the states

    def _diagnose(self) -> Event:
        if len(self.account.recordings) < 2:
            return Event.OPEN
        found = self._studied()
        recordings = len(self.account.recordings)
        if not self.account.steps or self.account.steps[-1].recordings != recordings:
            self._keep(steps=(*self.account.steps, _step(found, recordings)))
            self._tell(f"After {recordings} recordings: {found.answer}")
            for question in found.questions:
                self._tell(f"Open: {question.sentence}")
        if found.settled:
            twins = twins_of([item.effect for item in found.diagnosis.findings])
            self._keep(sentence=f"Settled. {found.answer}", actions=tuple(item.sentence for item in twins))
            return Event.NOTHING_OPEN
        return Event.OPEN

    def _choose(self) -> Event:
        given = len(self.account.recordings)
        if given < 2:
            seconds = PERIOD_S * (FIRST_PERIODS, SECOND_PERIODS)[given]
            if seconds > self.account.left_s:
                return self._out_of_time()
            self._choices = (self._shipped(given),)
            return Event.CHOSEN
        found = self._studied()
        random = np.random.default_rng([self.account.seed, given])
        room = self._room or Room(iiwa_limits(self.account.robot), default_trajectory(self.account.robot).offset)
        design = found.chooser.choose(
            random, room, self.account.left_s, progress=lambda share: self._progress("choosing the next motion", share)
        )
        if not design.choices:
            return self._out_of_time()
        if design.equivalences:
            self._keep(
                sentence=f"No motion settles what is left. {found.answer}",
                actions=tuple(item.sentence for item in design.equivalences),
            )
            return Event.NO_MOTION_TELLS
        best = design.choices[0].forecast
        confirming = self.account.confirming + 1 if best.probability - best.now < LEAST_GAIN else 0
        if confirming > MOST_CONFIRMING:
            self._keep(sentence=f"No motion of this arm would tell more. {found.answer}")
            return Event.NOTHING_TELLS
        self._keep(confirming=confirming)
        self._choices = tuple(self._motion(choice, found) for choice in design.choices)
        return Event.CHOSEN

    def _check(self) -> Event:
        objection = ""
        for choice, motion, trajectory in self._choices:
            del choice
            file = self._folder / motion.trajectory
            file.write_text(json.dumps(trajectory.to_json()) + "\n", encoding="utf-8")
            objection = self._driver.objection(file)
            if not objection:
                self._keep(pending=motion)
                self._tell(describe_motion(motion))
                return Event.SAFE
        self._keep(
            sentence=f"Of the motions that would tell most ({len(self._choices)} tried) none is safe here: {objection} "
            "Give the arm more room (--workspace), or record a motion of your own and add it with --from."
        )
        return Event.UNSAFE

    def _question(self) -> Event:
        motion = self.account.pending
        assert motion is not None
        if self._plan_only:
            self._keep(sentence=f"Planned, not driven: {describe_motion(motion)}")
            return Event.ONLY_PLANNED
        if self._ask(motion):
            self._keep(attempts=self.account.attempts + 1)
            return Event.AGREED
        self._keep(sentence="The motion was declined; nothing moved.")
        return Event.REFUSED

    def _record(self) -> Event:
        motion = self.account.pending
        assert motion is not None
        drive = self._driver.drive(motion, self._folder / motion.trajectory, self._attempt)
        if drive.outcome == "recorded" and drive.recording is not None:
            self._take(motion, drive.recording)
            return Event.RECORDED
        self._keep(sentence=drive.sentence, exit_code=drive.exit_code)
        return Event.DROPPED if drive.outcome == "dropped" else Event.STOPPED

    # ---- what they need

    @property
    def _attempt(self) -> Path:
        return self._folder / f"motion-{self.account.attempts:02d}"

    def _take_finished(self) -> bool:
        motion = self.account.pending
        recording = self._driver.finished(self._attempt)
        if motion is None or recording is None:
            return False
        self._take(motion, recording)
        return True

    def _take(self, motion: Motion, recording: Path) -> None:
        taken = Recorded(file=str(recording), motion=motion, added_mass=self.account.added_mass)
        self._keep(recordings=(*self.account.recordings, taken), pending=None)
        self._study = None

    def _studied(self) -> Study:
        if self._study is None:
            recordings, robot = self._read()
            masses = [_mass(item.added_mass) for item in self.account.recordings]
            self._study = study(
                [recordings[0], *recordings[2:]],
                robot,
                heldout=recordings[1:2],
                masses=[masses[0], *masses[2:], *masses[1:2]],
                mass_now=_mass(self.account.added_mass),
                progress=self._progress,
            )
        return self._study

    def _read(self) -> tuple[Sequence[Recording], RobotModel]:
        read = [read_recording(item.file) for item in self.account.recordings]
        unloaded = [item for item, at in zip(read, self.account.recordings, strict=True) if at.added_mass is None]
        refuse_other_arms(unloaded)
        inputs = inputs_of(read)
        return inputs.recordings, inputs.robot

    def _shipped(self, given: int) -> tuple[None, Motion, Trajectory]:
        robot, number = self.account.robot, given + 1
        first = given == 0
        motion = Motion(
            number=number,
            kind="excitation" if first else "another excitation",
            purpose="the shipped excitation: the parameters of the arm, and what stands out from them"
            if first
            else "another excitation, on which every name is checked",
            trajectory=f"trajectory-{number:02d}.json",
            periods=FIRST_PERIODS if first else SECOND_PERIODS,
            seconds=PERIOD_S * (FIRST_PERIODS if first else SECOND_PERIODS),
        )
        return None, motion, default_trajectory(robot) if first else validation_trajectory(robot)

    def _motion(self, choice: Choice, found: Study) -> tuple[Choice, Motion, Trajectory]:
        number = len(self.account.recordings) + 1
        alive, pair = found.assessment.alive, choice.forecast.hardest
        experiment: Experiment = choice.experiment
        motion = Motion(
            number=number,
            kind=experiment.kind,
            purpose=experiment.purpose,
            trajectory=f"trajectory-{number:02d}.json",
            periods=choice.periods,
            seconds=choice.seconds,
            forecast=choice.forecast.probability,
            now=choice.forecast.now,
            tells=None if pair is None else (alive[pair.truth].name, alive[pair.rival].name),
        )
        return choice, motion, experiment.trajectory(self.account.robot)

    def _out_of_time(self) -> Event:
        leader = self.account.steps[-1].alive[0] if self.account.steps else None
        leads = "" if leader is None else f" What leads: {leader.name}, {100 * leader.probability:.0f} %."
        self._keep(
            sentence=f"Out of time: {self.account.used_s / 60.0:.1f} of {self.account.budget_s / 60.0:.1f} minutes of "
            "motion are used, and the rest is too short for a motion. Call again with a larger --budget to go on."
            + leads
        )
        return Event.NO_TIME

    def _keep(self, **changes: object) -> None:
        self.account = save(self._folder, msgspec.structs.replace(self.account, **changes))


def _mass(given: tuple[float, float, float, float] | None) -> AddedMass | None:
    return None if given is None else AddedMass(given[0], given[1:])


def describe_motion(motion: Motion) -> str:
    """What a motion is for and what it will tell, in one sentence."""
    what = f"Motion {motion.number}: {motion.purpose}, {motion.periods} periods"
    if motion.forecast is None or motion.tells is None:
        return f"{what}, {motion.seconds:.0f} s."
    truth, rival = motion.tells
    if (motion.now or 0.0) >= ENOUGH:
        return f"{what}, {motion.seconds:.0f} s. The hypotheses are told apart already; it adds evidence for a name."
    return (
        f"{what}. In {motion.seconds:.0f} s this tells {truth} from {rival} and all else alive with "
        f"{100 * motion.forecast:.0f} % (now {100 * (motion.now or 0.0):.0f} %)."
    )


def refuse_other_arms(recordings: Sequence[Recording]) -> None:
    """Raise ConfigurationError where two recordings say that they are of different arms or tools."""
    for name in ("serial", "tool"):
        said = {item.source.metadata[name]: item.source.path for item in recordings if item.source.metadata.get(name)}
        if len(said) > 1:
            (one, first), (other, second) = list(said.items())[:2]
            raise ConfigurationError(
                f"its {name} is '{other}', that of {first} is '{one}': recordings of one arm with one tool are needed.",
                file=second,
            )


def _step(found: Study, recordings: int) -> Step:
    diagnosis = found.diagnosis
    return Step(
        recordings=recordings,
        verdict=diagnosis.verdict,
        answer=found.answer,
        alive=tuple(
            Alive(
                name=item.name,
                effect=item.effect,
                joint=item.place.joint,
                probability=item.probability,
                log_odds=item.log_odds,
            )
            for item in found.assessment.alive
        ),
        questions=tuple(item.sentence for item in found.questions),
        findings=tuple(
            Named(
                effect=item.effect,
                joint=item.place.joint,
                alternatives=tuple(other.effect for other in item.alternatives),
            )
            for item in diagnosis.findings
        ),
        stands_out=stands_out(found.assessment.alive),
        remaining=diagnosis.remaining,
        agreements=found.agreements,
    )
