"""The command `payload`: a tool's load data from recordings without and with it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from daemon.cli.app import app
from daemon.cli.inputs import (
    GravityOption,
    JointsOption,
    LockOption,
    MountOption,
    RobotOption,
    installation_of,
    load_inputs,
)
from daemon.cli.lists import AFTER, TwoLists
from daemon.cli.output import JsonOption, data, wants_json_on_stdout, write_json

if TYPE_CHECKING:
    from identification.audit.payload import Body

PARTS_OF_TOOL = ("tool_mass_kg", "tool_center_of_mass_m", "tool_inertia_kg_m2")


@app.command(cls=TwoLists)
def payload(
    ctx: typer.Context,
    logs: Annotated[
        list[Path], typer.Argument(metavar="WITHOUT… -- WITH…", help="Recordings without the tool, then with it.")
    ],
    robot: RobotOption = None,
    joints: JointsOption = None,
    lock: LockOption = None,
    mount: MountOption = None,
    gravity: GravityOption = None,
    json_file: JsonOption = None,
) -> None:
    """Mass, centre of mass and inertia of a tool, with 95 % intervals, as the cabinet's load data.

    Two recordings need no dashes between them. The best motion turns the wrist through its range.
    Example: iiwa-ident payload runs/bare/recording.mcap -- runs/tool/recording.mcap
    """
    from identification.audit.payload import weigh

    after = ctx.meta[AFTER] or (1 if len(logs) == 2 else None)
    if after is None or not 0 < after < len(logs):
        raise typer.BadParameter("Give the recordings without the tool, then --, then those with it.")
    inputs = load_inputs(logs, robot, joints=joints, installation=installation_of(gravity, mount, lock))
    count = len(logs) - after
    frame = _flange(inputs.robot.name)
    body = weigh(inputs.robot, inputs.recordings[:count], inputs.recordings[count:], **frame)
    stated = [recording.source.metadata for recording in inputs.recordings[count:]]
    where = "the flange" if frame else f"link {inputs.robot.n}, whose frame ends the arm's description"
    if json_file is not None:
        write_json(json_file, to_json(body, where, stated[0]))
    if not wants_json_on_stdout(json_file):
        for line in lines_of(body, where, stated[0]):
            data(line)


def _flange(name: str) -> dict[str, Any]:
    """The flange's frame in the last link's: known of the built-in arms, whose flange is turned by π about z."""
    import numpy as np

    from identification.robots import BUILT_IN_ROBOTS
    from safety.geometry import FLANGE_M

    if name not in BUILT_IN_ROBOTS:
        return {}
    return {"rotation": np.diag([-1.0, -1.0, 1.0]), "origin": np.array([0.0, 0.0, FLANGE_M])}


def lines_of(body: Body, where: str, stated: dict[str, str]) -> list[str]:
    """What an operator types into the cabinet, each with half of its 95 % interval."""
    from identification.audit.sentences import with_interval

    x, y, z = (with_interval(item, 1e3, "") for item in body.center)
    inertia = ", ".join(f"{item.name.removeprefix('inertia_')} {with_interval(item)}" for item in body.inertia)
    before, after = (sum(value**2 for value in values) ** 0.5 for values in (body.rms_before, body.rms_after))
    return [
        f"Mass M: {with_interval(body.mass)}",
        f"Centre of mass X, Y, Z: {x}, {y}, {z} mm from {where}",
        f"Inertia about it: {inertia}",
        f"With this load {after:.3g} Nm RMS stay (all joints together), without it {before:.3g} Nm.",
        compared(body, stated),
    ]


def compared(body: Body, stated: dict[str, str]) -> str:
    """How it compares with what the log says is set."""
    if "tool_mass_kg" not in stated:
        return "The log does not say which load data are set."
    mass = float(stated["tool_mass_kg"])
    low, high = body.mass.interval
    fits = low - 0.05 <= mass <= high + 0.05
    verdict = "which agrees" if fits else f"which is {body.mass.value - mass:+.2f} kg away: set the load data anew"
    return f"The log says {mass:g} kg, {verdict}."


def to_json(body: Body, where: str, stated: dict[str, str]) -> dict[str, Any]:
    """The result as JSON, and as the cabinet's load data: kg, mm, kg m²."""
    return {
        "format": "iiwa-ident/payload/1",
        "frame": where,
        "mass": body.mass.to_json(),
        "center_of_mass": {item.name[-1]: item.to_json() for item in body.center},
        "inertia": {item.name.removeprefix("inertia_"): item.to_json() for item in body.inertia},
        "load_data": {
            "M": body.mass.value,
            **{axis: 1e3 * item.value for axis, item in zip("XYZ", body.center, strict=True)},
            **{f"J{axis}": item.value for axis, item in zip("XYZ", body.inertia, strict=False)},
        },
        "set": {name: stated[name] for name in PARTS_OF_TOOL if name in stated},
        "comparison": compared(body, stated),
        "rms_nm": {"without": list(body.rms_before), "with": list(body.rms_after)},
    }
