"""The motions of an investigation: the shipped ones that come first, those that are chosen, and one driven again."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from daemon.investigate.account import Account, Motion, Recorded
from daemon.words import counted
from identification.excitation import (
    TableTrajectory,
    Trajectory,
    default_trajectory,
    load_trajectory,
    validation_trajectory,
)
from identification.investigation.actions import Action
from identification.investigation.choice import ENOUGH, PERIODS, Choice
from identification.investigation.experiments import PERIOD_S
from identification.investigation.forecast import LEAST_GAIN
from identification.investigation.study import Study
from identification.recordings.reader import read_recording
from identification.signals.periodic import PeriodicSettings, smooth_motion
from identification.signals.periods import average_periods, period_table

FIRST_PERIODS, SECOND_PERIODS = 8, 4
SAME_MOTION = "same motion"
"""Kind of the motion that shows what an action of the operator changed."""
Planned = tuple[Motion, Trajectory]


def smallest_budget_s(recordings: int) -> float:
    """Seconds of motion without which nothing can be told: what must come first, and one short motion."""
    first = (FIRST_PERIODS, SECOND_PERIODS)[recordings:]
    return PERIOD_S * (sum(first) + PERIODS[0])


def shipped_motion(robot: str, given: int) -> Planned:
    """The first or the second motion of an investigation from nothing. given: recordings at hand, 0 or 1."""
    first = given == 0
    periods = FIRST_PERIODS if first else SECOND_PERIODS
    motion = Motion(
        number=given + 1,
        kind="excitation" if first else "another excitation",
        purpose="the shipped excitation: the parameters of the arm, and what stands out from them"
        if first
        else "another excitation, on which every name is checked",
        trajectory=f"trajectory-{given + 1:02d}.json",
        periods=periods,
        seconds=PERIOD_S * periods,
    )
    return motion, default_trajectory(robot) if first else validation_trajectory(robot)


def chosen_motion(account: Account, choice: Choice, found: Study) -> Planned:
    """A motion that was designed, with what it will tell."""
    number = len(account.recordings) + 1
    alive, pair = found.assessment.alive, choice.forecast.hardest
    motion = Motion(
        number=number,
        kind=choice.experiment.kind,
        purpose=choice.experiment.purpose,
        trajectory=f"trajectory-{number:02d}.json",
        periods=choice.periods,
        seconds=choice.seconds,
        forecast=choice.forecast.probability,
        now=choice.forecast.now,
        forms=choice.forecast.forms,
        named=choice.forecast.named,
        named_now=choice.forecast.named_now,
        tells=None if pair is None else (alive[pair.truth].name, alive[pair.rival].name),
    )
    return motion, choice.experiment.trajectory(account.robot)


def same_motion(account: Account, folder: Path) -> Planned:
    """The first motion once more after an action, so that whatever was not changed cancels.

    Longer, where there is time, after an action that was done before and did not tell: the two are judged together.
    """
    number, first = len(account.recordings) + 1, account.recordings[0]
    trajectory = _motion_of(first, account.robot, folder)
    again = account.doing is not None and account.recordings[-1].action is account.doing
    fitting = int(account.left_s / trajectory.period_s) if again else SECOND_PERIODS
    periods = max(SECOND_PERIODS, min(FIRST_PERIODS, fitting))
    done = "" if account.doing is None else account.doing.value.replace("_", " ")
    motion = Motion(
        number=number,
        kind=SAME_MOTION,
        purpose=f"the first motion once more after the action '{done}': what it changed",
        trajectory=f"trajectory-{number:02d}.json",
        periods=periods,
        seconds=round(trajectory.period_s * periods, 3),
    )
    return motion, trajectory


def compared_with(earlier: Sequence[Recorded], last: Recorded) -> Recorded | None:
    """What shows what was done before the last recording: the same motion with the same mass on the flange.

    Where that mass is what was done, one without. None where there is none since whatever else was done to the arm.
    """
    mass = None if last.action is Action.ADD_MASS else last.added_mass
    for item in reversed([earlier[0], *(item for item in earlier[1:] if item.action is not None)]):
        if item.added_mass == mass:
            return item
        if item.action is not Action.ADD_MASS:
            break
    return None


def _motion_of(first: Recorded, robot: str, folder: Path) -> Trajectory:
    """The motion of a recording: its file, or what was measured where it was given, whatever its period is."""
    if first.motion is not None:
        return load_trajectory(folder / first.motion.trajectory)
    average = average_periods(period_table(read_recording(first.file)))
    table = smooth_motion(average, PeriodicSettings())[0]
    return TableTrajectory(table, len(table) / average.period_s, robot)


def describe_motion(motion: Motion) -> str:
    """What a motion is for and what it will tell, in two sentences."""
    what = f"Motion {motion.number}: {motion.purpose}, {counted(motion.periods, 'period')}, {motion.seconds:.0f} s."
    return what if motion.forecast is None else f"{what} {prediction_of(motion)}"


def broken_off(motion: Motion, recorded_s: float | None, folder: Path) -> str:
    """What is said of a motion that a killed command left. recorded_s: of its periods, None: nobody counted."""
    much = f"nothing of its {motion.seconds:.0f} s was recorded"
    if recorded_s is None:
        much = f"how much of it was recorded, `iiwa-ident recover {folder}` says"
    elif recorded_s:
        much = f"{recorded_s:.1f} of its {motion.seconds:.0f} s were recorded and stay in {folder}"
    return (
        f"Motion {motion.number} ({motion.kind.replace('_', ' ')}) was broken off: {much}. It counts for nothing, "
        "and is asked for once more from its beginning."
    )


def prediction_of(motion: Motion) -> str:
    """What a motion with a forecast will tell."""
    if motion.tells is None:
        return "Nothing that has a name is likely so far: it is to show whether there is something after all."
    truth, rival = motion.tells
    now, then = motion.named_now or 0.0, motion.named or 0.0
    if now >= ENOUGH:
        return (
            f"{truth[:1].upper()}{truth[1:]} leads all else by enough; the diagnosis asks for more before it gives a "
            "name, and this motion adds to it."
        )
    pair = f"It is to tell {truth} from {rival}:"
    if then < LEAST_GAIN:
        return f"{pair} none of the motions tried is likely to give a name at once, and this one tells most."
    chances = f"has its name afterwards with {100 * then:.0f} % (without the motion {100 * now:.0f} %)"
    if motion.forms < ENOUGH:
        return f"{pair} if a form of the library is there, which has {100 * motion.forms:.0f} %, it {chances}."
    return f"{pair} whichever is there {chances}."
