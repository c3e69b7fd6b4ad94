"""What an operator did to the arm, or wants settled, in the words that every command of an investigation shares."""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Literal

import typer

if TYPE_CHECKING:
    from identification.investigation.added_mass import AddedMass


class Wanted(StrEnum):
    """What no motion shows, and an operator may want to be settled."""

    GAIN = "gain"
    LOAD = "load"


AddedMassOption = Annotated[
    str | None,
    typer.Option(
        "--added-mass", metavar="KG@X,Y,Z", help="Known mass on the flange from now on, m from there; or none."
    ),
]
AfterDropOption = Annotated[
    bool, typer.Option("--after-drop", help="Go on after the robot dropped out, once somebody has looked at it.")
]
YesOption = Annotated[bool, typer.Option("--yes", help="Do not ask before each motion; on a fake robot only.")]
DoneOption = Annotated[
    Literal["turn_tool", "warm_up", "level_base"] | None,
    typer.Option("--done", help="What was done to the arm since, as the page asked for."),
]
SettleOption = Annotated[
    list[Wanted] | None, typer.Option("--settle", help="What no motion shows: gain of all sensors, load on the flange.")
]


def mass_of(text: str | None) -> AddedMass | None:
    """The mass of KG@X,Y,Z, of 0 kg for `none`. Raises a usage error for anything else, also for what no tool
    can be, such as a place in mm.
    """
    from daemon.cli.acquisition import tool_from
    from identification.investigation.added_mass import AddedMass

    if text == "none":
        return AddedMass(0.0, (0.0, 0.0, 0.0))
    try:
        mass = None if text is None else AddedMass.parse(text)
    except ValueError as error:
        raise typer.BadParameter(f"--added-mass '{text}' is no KG@X,Y,Z, such as 2.0@0,0,0.05, nor none.") from error
    tool_from(text)
    return mass
