"""The loop: diagnose, choose, check, ask, record, until nothing is open, no motion tells more, or the time is used.

Here: what is done in each state, and the account after each. Not here: the table (`states`), how a motion is driven
(`Driver`, which a real link and the proof each have their own of), and the mathematics
(`identification.investigation`).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal, Protocol

import msgspec
import numpy as np

from daemon.errors import ConfigurationError
from daemon.investigate.account import Account, Motion, Recorded, Told, not_asked_for, save, without_its_mass
from daemon.investigate.motions import (
    FIRST_PERIODS,
    SAME_MOTION,
    SECOND_PERIODS,
    broken_off,
    chosen_motion,
    compared_with,
    describe_motion,
    same_motion,
    shipped_motion,
)
from daemon.investigate.same_arm import Stated, comparable, read_together, refuse_another_arm
from daemon.investigate.states import RESTING, Event, State, after
from daemon.investigate.steps import as_a_class, step_of
from daemon.motion.tool import FastenedMass, fastened
from daemon.words import counted
from identification.excitation import Trajectory, default_trajectory, iiwa_limits
from identification.investigation.actions import Action
from identification.investigation.added_mass import AddedMass
from identification.investigation.choice import PERIODS
from identification.investigation.equivalences import Equivalence, invisible, twins_of
from identification.investigation.experiments import PERIOD_S, Room
from identification.investigation.forecast import Forecast
from identification.investigation.study import Study, study, what_it_told
from identification.recordings.reader import inputs_of, read_recording

Tell = Callable[[str], None]
Progress = Callable[[str, float], None]
Ask = Callable[[Motion], bool | None]
"""Whether a motion may be driven; None: it is only planned."""

MOST_CONFIRMING = 2
"""Motions in a row without a gain in sight where no form of the library leads; where one does, all time is used."""


@dataclass(frozen=True, slots=True)
class Drive:
    """How a motion ended. recording: what was recorded, None: nothing that can be used. exit_code: of the run.

    outcome: "unsafe" where its check found against it, so that it was not begun; "unknown" where a recording was begun
    and nobody wrote down how it ended (recording: the folder of that run). recorded_s: of its periods, None: not known.
    """

    outcome: Literal["recorded", "stopped", "dropped", "unsafe", "unknown"]
    recording: Path | None
    sentence: str
    exit_code: int = 1
    recorded_s: float | None = 0.0


class Driver(Protocol):
    """Checks and drives a motion of a file."""

    def objection(self, trajectory: Path) -> str:
        """Why the motion must not be driven; empty where the preflight finds it safe."""
        ...

    def drive(self, motion: Motion, trajectory: Path, folder: Path) -> Drive:
        """Drive it and record into a folder."""
        ...

    def stated(self) -> Stated | None:
        """What the log of a motion will say of arm, tool and stand; None where nothing is known of them."""
        ...

    def ended(self, folder: Path) -> Drive | None:
        """How the motion ended that a killed loop left behind in a folder; None where nobody wrote that down."""
        ...


class Investigation:
    """One investigation in its folder; `run` goes on until it rests, and returns the account."""

    def __init__(
        self, folder: Path, account: Account, driver: Driver, *, ask: Ask, tell: Tell, progress: Progress
    ) -> None:
        self._folder = folder
        self.account = account
        self._driver = driver
        self._ask, self._tell, self._progress = ask, tell, progress
        self._study: Study | None = None
        self._choices: Sequence[tuple[Motion, Trajectory]] = ()

    def run(self) -> Account:
        """Go on from where the account stands until it rests.

        Raises ConfigurationError where its motions would be of another arm, tool or stand than its recordings.
        """
        self._refuse_another_arm()
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

    def resume(
        self, *, after_drop: bool = False, acted: Action | None = None, added_mass: FastenedMass | None = None
    ) -> None:
        """Stand where a person may be asked again. Raises ConfigurationError after a drop that nobody released, and for
        an action that nothing asks for: its motion would count as one of the arm as it was.

        acted: what the operator did to the arm since. added_mass: on the flange from now on, and not in a motion that
        was driven before; None: what was there; of 0 kg: none.

        A motion whose recording is whole on disk is taken as recorded; one that was broken off is asked for anew, one
        in which the robot dropped out is as if nobody had been killed.
        """
        expected = (None, Action.ADD_MASS, self.account.doing)
        if self.account.state is State.RECORDING:
            ended = self._driver.ended(self._attempt)
            if ended is not None and not (after_drop and ended.outcome == "unknown"):
                self._keep(state=after(self.account.state, self._came_of(ended)))
            if self.account.pending is not None:
                recorded_s = 0.0 if ended is None else ended.recorded_s
                self._tell(broken_off(self.account.pending, recorded_s, self._attempt))
        state, mass = self.account.state, fastened(added_mass, self.account.added_mass)
        if state is State.DROPPED and not after_drop:
            raise ConfigurationError(
                "in the last motion the robot dropped out of the session, or nobody saw the arm come to rest, and "
                "nothing moves again by itself: look at the arm and the cabinet, then add --after-drop.",
                file=str(self._folder),
            )
        asks = self.account.asks if state is State.NEEDS_ACTION else ()
        if asks and acted not in (None, Action.ADD_MASS, *asks):  # a mass is what is on the flange, asked for or not
            raise not_asked_for(acted, self.account, self._folder)
        if state in (State.NEEDS_ACTION, State.SETTLED):
            self._keep(added_mass=mass)
            if acted is not None:
                self._keep(state=after(state, Event.ACTED), doing=acted, actions=(), asks=())
            elif state is State.SETTLED and self.account.wanted:
                self._keep(state=after(state, Event.RESUMED))
            return
        if acted not in expected:
            raise not_asked_for(acted, self.account, self._folder)
        if self.account.doing is Action.ADD_MASS and mass is None:
            raise without_its_mass(self._folder)
        event = Event.RELEASED if state is State.DROPPED else Event.RESUMED
        self._keep(state=after(state, event), added_mass=mass)

    # ---- the states

    def _diagnose(self) -> Event:
        if len(self.account.recordings) < 2:
            return Event.OPEN
        found = self._studied()
        recordings = len(self.account.recordings)
        if not self.account.steps or self.account.steps[-1].recordings != recordings:
            self._keep(steps=(*self.account.steps, step_of(found, recordings)))
            self._tell(f"After {counted(recordings, 'recording')}: {found.answer}")
            for question in found.questions:
                self._tell(f"Open: {question.sentence}")
        self._hear(found)
        if not found.settled:
            return Event.OPEN
        twins = twins_of([item.effect for item in found.diagnosis.findings])
        if self._asks_for([*twins, *self._wanted]):
            self._keep(sentence=f"What motion can tell is known; what is left, no motion settles. {found.answer}")
            return Event.NO_MOTION_TELLS
        self._keep(sentence=f"Settled. {found.answer}{self._heard}", actions=())
        return Event.NOTHING_OPEN

    def _asks_for(self, equivalences: Sequence[Equivalence]) -> bool:
        """Ask for what settles these, where nobody did it yet; whether there is such a thing."""
        told = {item.action for item in self.account.told if item.settled}
        left = [item for item in equivalences if item.action not in told]
        asks = tuple(dict.fromkeys(item.action for item in left if item.action is not None))
        self._keep(actions=tuple(item.sentence for item in left), asks=asks)
        return bool(left)

    @property
    def _wanted(self) -> list[Equivalence]:
        """What an operator wants to be settled and no action told yet; time is kept for it."""
        told = {item.action for item in self.account.told if item.settled}
        return [item for item in map(invisible, self.account.wanted) if item.action not in told]

    @property
    def _heard(self) -> str:
        """What actions told, as the end of a sentence."""
        return "".join(f" {item.sentence}" for item in self.account.told if item.settled)

    def _hear(self, found: Study) -> None:
        """What the last recording after an action told."""
        last = self.account.recordings[-1]
        done = len([item for item in self.account.recordings if item.action is not None])
        if last.action is None or done == self.account.heard:
            return
        # Of one arm that gets warmer and warmer all recordings say the same thing.
        together = last.action is Action.WARM_UP
        own = [
            item for item in self.account.recordings
            if item is last or (together and (item.action, item.added_mass) == (last.action, last.added_mass))
        ]  # fmt: skip
        earlier = self.account.recordings[: self.account.recordings.index(own[0])]
        before = compared_with(earlier, last)
        if before is None:
            self._tell("Another mass was on the flange when this motion was driven before: it tells nothing yet.")
            self._keep(heard=done)
            return
        inputs = inputs_of([read_recording(item.file) for item in (before, *own)], robot=self.account.robot)
        first, *after_it = inputs.recordings
        outcomes = what_it_told(last.action, first, after_it, found, inputs.robot, _mass(last.added_mass))
        told = tuple(Told(**asdict(item), recording=len(self.account.recordings)) for item in outcomes)
        for item in told:
            self._tell(item.sentence)
        self._keep(told=(*self.account.told, *told), heard=done)

    def _choose(self) -> Event:
        given = len(self.account.recordings)
        if given < 2:
            seconds = PERIOD_S * (FIRST_PERIODS, SECOND_PERIODS)[given]
            if seconds > self.account.left_s:
                return self._out_of_time()
            self._choices = (shipped_motion(self.account.robot, given),)
            return Event.CHOSEN
        if self.account.doing is not None:
            self._choices = (same_motion(self.account, self._folder),)
            late = self._choices[0][0].seconds > self.account.left_s
            return self._out_of_time() if late else Event.CHOSEN
        found = self._studied()
        random = np.random.default_rng([self.account.seed, given])
        room = Room(iiwa_limits(self.account.robot), default_trajectory(self.account.robot).offset)
        # Where no time is left, what one motion more would tell is still worth knowing.
        left_s = self.account.left_s - PERIOD_S * SECOND_PERIODS * len(self._wanted)
        left = max(left_s, PERIODS[0] * PERIOD_S)
        design = found.chooser.choose(
            random, room, left, progress=lambda share: self._progress("choosing the next motion", share)
        )
        if design.equivalences:
            if self._asks_for(design.equivalences):
                self._keep(sentence=f"No motion settles what is left. {found.answer}")
                return Event.NO_MOTION_TELLS
            self._keep(sentence=f"Settled. {found.answer}{self._heard}")
            return Event.KNOWN
        best = design.choices[0].forecast
        useless = not best.worth_driving
        no_time = left_s < PERIODS[0] * PERIOD_S
        confirming = self.account.confirming + 1 if useless else 0
        nameless = found.assessment.alive[0].effect is None
        # A torque that has two names is open, however sure the hypotheses are.
        names_open = any(item.alternatives for item in found.diagnosis.findings)
        if useless and not names_open and (no_time or (nameless and confirming > MOST_CONFIRMING)):
            if found.diagnosis.classes:
                self._keep(sentence=as_a_class(found))
                return Event.KNOWN
            self._keep(sentence=f"No motion of this arm would tell more. {found.answer}")
            return Event.NOTHING_TELLS
        if no_time and self._asks_for(self._wanted):
            self._keep(sentence=f"The time that is left is for what no motion settles. {found.answer}")
            return Event.NO_MOTION_TELLS
        if no_time:
            return self._out_of_time(None if useless else best)
        self._keep(confirming=confirming)
        self._choices = tuple(chosen_motion(self.account, choice, found) for choice in design.choices)
        return Event.CHOSEN

    def _check(self) -> Event:
        objection = ""
        for motion, trajectory in self._choices:
            file = self._folder / motion.trajectory
            file.write_text(json.dumps(trajectory.to_json()) + "\n", encoding="utf-8")
            objection = self._driver.objection(file)
            if not objection:
                self._keep(pending=motion)
                return Event.SAFE
        what = f"Of the motions that would tell most ({len(self._choices)} tried) none is safe here"
        if (first := self._choices[0][0]).forecast is None:
            what = f"What has to come next, {first.purpose.split(':')[0]}, is not safe here"
        self._keep(
            sentence=f"{what}: {objection} Give the arm more room (--workspace), or record motions of your own and "
            "begin anew with --from."
        )
        return Event.UNSAFE

    def _question(self) -> Event:
        motion = self.account.pending
        assert motion is not None
        self._tell(describe_motion(motion))
        if motion.seconds > self.account.left_s:  # the budget of this command is smaller than the one it was planned in
            self._tell("It does not fit into the budget any more and is withdrawn.")
            self._keep(pending=None)
            return Event.NO_TIME
        agreed = self._ask(motion)
        if agreed is None:
            self._keep(sentence=f"Planned, not driven: {describe_motion(motion)}")
            return Event.ONLY_PLANNED
        if agreed:
            self._keep(attempts=self.account.attempts + 1)
            return Event.AGREED
        self._keep(sentence="The motion was declined; nothing moved.")
        return Event.REFUSED

    def _record(self) -> Event:
        motion = self.account.pending
        assert motion is not None
        return self._came_of(self._driver.drive(motion, self._folder / motion.trajectory, self._attempt))

    # ---- what they need

    def _refuse_another_arm(self) -> None:
        """Before anything is computed, whatever was done to the arm."""
        account = self.account
        if account.state in RESTING or (stated := self._driver.stated()) is None:
            return
        for item in account.recordings:
            refuse_another_arm([read_recording(item.file)], comparable(stated, item, account))

    @property
    def _attempt(self) -> Path:
        return self._folder / f"motion-{self.account.attempts:02d}"

    def _came_of(self, drive: Drive) -> Event:
        """Note how the pending motion ended. Raises ConfigurationError where nobody knows.

        That is not noted: where processes of the run are left, they soon write down how it ended.
        """
        if drive.outcome == "unknown":
            raise ConfigurationError(drive.sentence, file=str(drive.recording))
        motion = self.account.pending
        if drive.outcome == "recorded" and drive.recording is not None and motion is not None:
            self._take(motion, drive.recording)
            return Event.RECORDED
        self._keep(sentence=drive.sentence, exit_code=drive.exit_code)
        return {"dropped": Event.DROPPED, "unsafe": Event.UNSAFE}.get(drive.outcome, Event.STOPPED)

    def _take(self, motion: Motion, recording: Path) -> None:
        action = self.account.doing if motion.kind == SAME_MOTION else None
        taken = Recorded(file=str(recording), motion=motion, added_mass=self.account.added_mass, action=action)
        doing = None if action is not None else self.account.doing
        self._keep(recordings=(*self.account.recordings, taken), pending=None, doing=doing)
        self._study = None

    def _studied(self) -> Study:
        if self._study is None:
            # What was done to the arm is asked of pairs of recordings; the diagnosis is of the arm as it was.
            own = [item for item in self.account.recordings if item.action is None]
            recordings, robot = read_together(own, self.account.robot)
            masses = [_mass(item.added_mass) for item in own]
            self._study = study(
                [recordings[0], *recordings[2:]],
                robot,
                heldout=recordings[1:2],
                masses=[masses[0], *masses[2:], *masses[1:2]],
                mass_now=_mass(self.account.added_mass),
                progress=self._progress,
            )
        return self._study

    def _out_of_time(self, best: Forecast | None = None) -> Event:
        step = self.account.steps[-1] if self.account.steps else None
        known = "" if step is None else f" So far: {step.answer}"
        if best is not None and step is not None:
            leader = step.alive[0]
            known += (
                f" What leads: {leader.name}, {100 * leader.probability:.0f} %. "
                f"{PERIODS[0] * PERIOD_S:.0f} s more would settle it with {100 * best.probability:.0f} %."
            )
        self._keep(
            sentence=f"Out of time: {self.account.used_s / 60.0:.1f} of {self.account.budget_s / 60.0:.1f} minutes of "
            "recorded motion are used, and the rest is too short for one. Call again with a larger --budget to go on."
            + known
        )
        return Event.NO_TIME

    def _keep(self, **changes: object) -> None:
        self.account = save(self._folder, msgspec.structs.replace(self.account, **changes))


def _mass(given: tuple[float, float, float, float] | None) -> AddedMass | None:
    return None if given is None else AddedMass(given[0], given[1:])
