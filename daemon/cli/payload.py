"""The command `payload`: a tool's load data from recordings without and with it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from daemon.cli.app import app
from daemon.cli.inputs import RecordedArm
from daemon.cli.lists import AFTER, TwoLists
from daemon.cli.option_groups import grouped
from daemon.cli.output import JsonOption, data_lines, told_in_words

if TYPE_CHECKING:
    from identification.audit.difference import Number
    from identification.audit.payload import Body

SET = ("tool_mass_kg", "tool_center_of_mass_m", "tool_inertia_kg_m2")
CENTER_KNOWN_M = 0.002
"""What a centre of mass should be known within."""
MASS_AGREES_KG, CENTER_AGREES_M = 0.05, 0.005
"""Load data are set to a tenth of a kilogram and to a few millimetres."""
TAKEN_OFF = "That is no load to set, for the second ones carry less: a tool was taken off, or they were to stand first."


@app.command(cls=TwoLists)
@grouped
def payload(
    ctx: typer.Context,
    logs: Annotated[
        list[Path], typer.Argument(metavar="WITHOUT… -- WITH…", help="Recordings without the tool, then with it.")
    ],
    arm: RecordedArm,
    json_file: JsonOption = None,
) -> None:
    """Mass, centre of mass and inertia of a tool, with 95 % intervals, as the cabinet's load data.

    Two recordings need no dashes between them. The motion for it: iiwa-ident design --for payload.
    Example: iiwa-ident payload runs/bare/recording.mcap -- runs/tool/recording.mcap
    """
    from identification.audit.payload import weigh

    after = ctx.meta[AFTER] or (1 if len(logs) == 2 else None)
    if after is None or not 0 < after < len(logs):
        raise typer.BadParameter("Give the recordings without the tool, then --, then those with it.")
    found = arm.load(logs, fits=True)
    count = len(logs) - after
    body = weigh(found.robot, found.recordings[:count], found.recordings[count:])
    stated = [found.recordings[place].source.metadata for place in (0, count)]
    if told_in_words(to_json(body, stated), json_file):
        data_lines(lines_of(body, stated, found.robot.torque_unit))


def lines_of(body: Body, stated: Sequence[dict[str, str]], unit: str) -> list[str]:
    """What an operator types into the cabinet, each with half of its 95 % interval.

    stated: of a log without, with. unit: of the robot's torques.
    """
    from identification.audit.difference import with_interval
    from identification.audit.payload import cabinet_load_data

    def shown(item: Number, factor: float, unit: str | None) -> str:
        return "not determined" if item.name in body.undetermined else with_interval(item, factor, unit)

    x, y, z = (shown(item, 1e3, "") for item in body.center)
    inertia = ", ".join(f"{item.name.removeprefix('inertia_')} {shown(item, 1.0, None)}" for item in body.inertia)
    load = cabinet_load_data(body)
    typed = ", ".join(f"{name} {value:.4g}" for name, value in load.items() if value is not None)
    missing = ", ".join(name for name, value in load.items() if value is None)
    before, after = (sum(value**2 for value in values) ** 0.5 for values in (body.rms_before, body.rms_after))
    longer = _how_much_longer(body)
    return [
        f"Mass M: {with_interval(body.mass)}",
        f"Centre of mass X, Y, Z: {x}, {y}, {z} mm from {body.frame}",
        f"Inertia about it: {inertia}",
        f"As load data (kg, mm, degrees, kg m²): {typed}",
        *([f"Not determined by these motions: {missing}. Take them from a drawing of the tool."] if missing else []),
        *([TAKEN_OFF] if body.mass.interval[1] < 0.0 else []),
        f"With this load {after:.3g} {unit} RMS stay (all joints together), without it {before:.3g} {unit}.",
        *([] if longer is None else [longer]),
        *_other_scale(body),
        compared(body, stated),
    ]


def _how_much_longer(body: Body) -> str | None:
    """What to do where the centre is not known well; None where it is."""
    needed = body.seconds_for(CENTER_KNOWN_M)
    if needed <= body.seconds:
        return None
    if not math.isfinite(needed):
        return (
            "Where its centre is cannot be said: the load is too light for these motions, or they turn it too little."
        )
    worst, tens = CENTER_KNOWN_M * math.sqrt(needed / body.seconds), math.ceil(needed / 10.0)
    return (
        f"The centre is known within ± {1e3 * worst:.1f} mm: the load is too light for ± {1e3 * CENTER_KNOWN_M:g} mm "
        f"from {body.seconds:.0f} s of motion. About {10 * tens} s without and as much with it would do."
    )


def _other_scale(body: Body) -> list[str]:
    """That torque reads otherwise with the load than without, where that is clear."""
    from identification.audit.comparison import LEAST_SIGMAS
    from identification.audit.difference import with_interval

    more = body.torque_ratio.value - 1.0
    if abs(more) < LEAST_SIGMAS * body.torque_ratio.std:
        return []
    size = with_interval(replace(body.torque_ratio, value=abs(more)), 100.0, "%")
    said = f"reads {size} {'more' if more > 0.0 else 'less'} with the tool than without."
    if body.ratio_joint is not None:
        return [f"The same torque of joint {body.ratio_joint + 1} {said} It is taken off."]
    return [
        f"The same torque {said} The load is in units of the recordings without it; which are right is not known, and "
        "its mass is so much less certain."
    ]


def compared(body: Body, stated: Sequence[dict[str, str]]) -> str:
    """How it compares with what the logs say is set: the tool of those with it, less that of those without."""
    if SET[0] not in stated[1]:
        return "The log does not say which load data are set."
    (mass_before, center_before), (mass_after, center_after) = map(_set, stated)
    mass = mass_after - mass_before
    low, high = body.mass.interval
    said = f"The log says {mass:g} kg"
    if not low - MASS_AGREES_KG <= mass <= high + MASS_AGREES_KG:
        return f"{said}, which is {body.mass.value - mass:+.2f} kg away: set the load data anew."
    if center_after is None or not mass or not body.frame.startswith("the flange"):
        return f"{said}, which agrees."
    moments = [
        mass_after * after - mass_before * before
        for after, before in zip(center_after, center_before or (0.0, 0.0, 0.0), strict=True)
    ]
    place = [moment / mass for moment in moments]
    said += f" at ({', '.join(f'{1e3 * value:z.0f}' for value in place)}) mm"
    for axis, item, value in zip("XYZ", body.center, place, strict=True):
        low, high = item.interval
        if not low - CENTER_AGREES_M <= value <= high + CENTER_AGREES_M:
            return f"{said}, which is {1e3 * (item.value - value):+.0f} mm away along {axis}: set the load data anew."
    return f"{said}, which agrees."


def _set(stated: dict[str, str]) -> tuple[float, tuple[float, ...] | None]:
    """Mass in kg and centre in m of the tool that a log's metadata name; no tool, no mass."""
    center = tuple(float(number) for number in stated.get(SET[1], "").split(",") if number.strip())
    return float(stated.get(SET[0], 0.0)), center if len(center) == 3 else None


def to_json(body: Body, stated: Sequence[dict[str, str]]) -> dict[str, Any]:
    """The result as JSON, and as the cabinet's load data: kg, mm, degrees, kg m²."""
    from identification.audit.payload import cabinet_load_data
    from identification.json_values import number

    return {
        "format": "iiwa-ident/payload/1",
        "frame": body.frame,
        "mass": body.mass.to_json(),
        "center_of_mass": {item.name[-1]: item.to_json() for item in body.center},
        "inertia": {item.name.removeprefix("inertia_"): item.to_json() for item in body.inertia},
        "load_data": cabinet_load_data(body),
        "undetermined": list(body.undetermined),
        "set": {name: stated[1][name] for name in SET if name in stated[1]},
        "torque_ratio": body.torque_ratio.to_json(),
        "torque_ratio_joint": None if body.ratio_joint is None else body.ratio_joint + 1,
        "seconds": body.seconds,
        "seconds_for_2_mm": number(body.seconds_for(CENTER_KNOWN_M)),
        "comparison": compared(body, stated),
        "rms_nm": {"without": list(body.rms_before), "with": list(body.rms_after)},
    }
