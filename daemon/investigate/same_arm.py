"""Whether recordings, and the motions that are still to be driven, are of one arm with one tool that stands in one way.

Motions are refused before they move: a recording of another arm could not be diagnosed together with the others, and a
tool that the recordings name and the command does not is missing from the distances.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from daemon.errors import ConfigurationError
from daemon.investigate.account import Account, Recorded
from identification.investigation.actions import Action
from identification.recordings import Recording
from identification.recordings.reader import inputs_of, read_recording
from identification.robots import Installation, RobotModel


@dataclass(frozen=True, slots=True)
class Stated:
    """What the log of the next motion will say. serial: empty where nobody says one; tool: in words.

    tool empty, installation None: not to be compared.
    """

    serial: str
    tool: str
    installation: Installation | None


def refuse_other_arms(recordings: Sequence[Recording], *names: str) -> None:
    """Raise ConfigurationError where two recordings say that they are of different arms or tools.

    names: what is compared of "serial" and "tool"; both where none is given.
    """
    for name in names or ("serial", "tool"):
        said = {item.source.metadata[name]: item.source.path for item in recordings if item.source.metadata.get(name)}
        if len(said) > 1:
            (one, first), (other, second) = list(said.items())[:2]
            raise ConfigurationError(
                f"its {name} is '{other}', that of {first} is '{one}': recordings of one arm with one tool are needed.",
                file=second,
            )


def read_together(recorded: Sequence[Recorded], robot: str) -> tuple[Sequence[Recording], RobotModel]:
    """The recordings, read as of one arm, and its model. A known mass adds to the tool that they name."""
    read = [read_recording(item.file) for item in recorded]
    refuse_other_arms(read, "serial")
    refuse_other_arms([item for item, at in zip(read, recorded, strict=True) if at.added_mass is None], "tool")
    inputs = inputs_of(read, robot=robot)
    return inputs.recordings, inputs.robot


def comparable(stated: Stated, recorded: Recorded, account: Account) -> Stated:
    """What of it one recording must agree with: the serial number always.

    A known mass adds to the tool, an action may turn the tool or level the base, before this recording or since.
    """
    actions = (recorded.action, account.doing)
    other_tool = recorded.added_mass or account.added_mass or Action.TURN_TOOL in actions or Action.ADD_MASS in actions
    return replace(
        stated,
        tool="" if other_tool else stated.tool,
        installation=None if Action.LEVEL_BASE in actions else stated.installation,
    )


def refuse_another_arm(recordings: Iterable[Recording], stated: Stated) -> None:
    """Raise ConfigurationError where a recording says that it is of another arm, tool or stand than what will move."""
    for item in recordings:
        for name, now in (("serial", stated.serial), ("tool", stated.tool)):
            before = item.source.metadata.get(name)
            if before and now and before != now:
                raise ConfigurationError(
                    f"its {name} is '{before}', and the motions of this command would be driven with '{now}': nothing "
                    f"was moved. --{name} says what is so; recordings of one arm with one tool are needed.",
                    file=str(item.source.path),
                )
        if stated.installation is not None and item.installation.gravity != stated.installation.gravity:
            before, now = (
                ", ".join(f"{value:g}" for value in stand.gravity) for stand in (item.installation, stated.installation)
            )
            raise ConfigurationError(
                f"the arm stood in gravity ({before}) m/s² in it, and the motions of this command would be checked and "
                f"noted with ({now}): nothing was moved. Say with --mount or --gravity how the arm stands.",
                file=str(item.source.path),
            )
