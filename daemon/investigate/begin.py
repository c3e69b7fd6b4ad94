"""How an investigation begins: its account, with every recording read once so that what is wrong is said first."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from daemon.errors import ConfigurationError
from daemon.investigate.account import Account, Recorded
from daemon.investigate.motions import smallest_budget_s
from daemon.investigate.same_arm import refuse_other_arms
from daemon.investigate.states import State
from daemon.words import counted
from identification.errors import RecordingError, TrajectoryNotFoundError
from identification.excitation import default_trajectory
from identification.investigation.study import refuse_without_periods
from identification.recordings import refuse_shared_samples
from identification.recordings.reader import inputs_of, read_recording, recording_file, robot_of


def begun(given: Sequence[Path], robot: str | None, budget_s: float, seed: int) -> Account:
    """The account of a new investigation. given: recordings or run folders. robot: None is what the recordings say.

    Raises ConfigurationError for a budget that is too short, for recordings of different arms and for an arm that has
    no shipped motions; RecordingError where no robot is given and they do not all say the same one, where one is given
    twice, has too few joints or no periods; and the errors of `read_recording`.
    """
    least = smallest_budget_s(len(given))
    if budget_s < least:
        raise ConfigurationError(
            f"{budget_s / 60.0:g} minutes are too short: {math.ceil(least / 6.0) / 10.0:g} are the least with "
            f"{counted(len(given), 'recording')} at hand.",
            field="--budget",
        )
    read = [read_recording(file) for file in given]
    refuse_other_arms(read)
    if read:
        refuse_shared_samples([read[0], *read[2:]], read[1:2])
    for file, item in zip(given, read, strict=True):
        if robot is not None and item.robot not in (None, robot):
            raise ConfigurationError(f"it is of {item.robot}; --robot says {robot}.", file=str(file))
    arm = robot or (robot_of(read) if read else "iiwa14")
    try:
        joints = default_trajectory(arm).offset.size
    except TrajectoryNotFoundError:
        raise ConfigurationError(
            f"investigate has motions for an iiwa 14 or 7 only, and this arm is {arm}; nothing was moved. For another "
            f"arm design two motions (`iiwa-ident design --robot {arm}`), record them, and give both to `iiwa-ident "
            "diagnose`, the second with --heldout.",
            field="--robot",
        ) from None
    for file, item in zip(given, read, strict=True):
        if item.n < joints:
            raise RecordingError(
                f"it has {item.n} joints and {arm} has {joints}: it is of another arm, or not of all joints",
                file=str(file),
            )
    # Here, and not once the next motion was driven.
    refuse_without_periods(inputs_of(read, robot=arm).recordings)
    files = tuple(Recorded(file=str(recording_file(file).absolute())) for file in given)
    return Account(robot=arm, seed=seed, budget_s=budget_s, recordings=files)


def exit_code(account: Account) -> int:
    """0: settled or only planned; of a motion that was not completed that of its run; 1: something is open."""
    if account.state in (State.INTERRUPTED, State.DROPPED):
        return account.exit_code
    return 0 if account.state in (State.SETTLED, State.PLANNED) else 1
