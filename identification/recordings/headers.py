"""What the header of a table says of each column: quantity, joint and unit, in the spellings that leave no doubt.

`q1`, `tau_1`, `pos[0]`, `Torque 3 (Nm)`, `q_deg_3`, `time_ms`. Anything else is no column of a recording. Pure.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from identification.recordings.units import UNITS, unknown_unit

COLUMN = re.compile(r"^(q_link|q_cmd|tau_ext|temperature|tau|dq|q)_?(\d+)$")
NAMES = {
    "t": ("t", "time", "timestamp"),
    "q": ("q", "pos", "position", "positions", "joint_pos", "joint_position", "joint_positions", "joint_angle"),
    "dq": ("dq", "qdot", "q_dot", "vel", "velocity", "velocities", "joint_vel", "joint_velocity", "joint_velocities"),
    "tau": ("tau", "torque", "torques", "effort", "efforts", "joint_torque", "joint_torques", "joint_effort"),
    "q_cmd": ("q_cmd",),
    "q_link": ("q_link",),
    "tau_ext": ("tau_ext",),
}
"""Of each quantity; qd is none: it may be a velocity or a desired position."""
UNIT_OF = {"q_cmd": "q", "q_link": "q", "tau_ext": "tau"}
"""Quantities whose unit goes by another one's name."""
_SPELT = (("°", "deg"), ("degrees", "deg"), ("degree", "deg"), ("radians", "rad"), ("radian", "rad"), ("_per_", "/"))
_TIMES = re.compile(r"[\s·*.⋅^]|-(?=m)")
_IN_BRACKETS = re.compile(r"^(.*?)[\s_]*[\[(]\s*([^\[\]()\d][^\[\]()]*|)\s*[\])]$")
_WITH_NUMBER = re.compile(r"^(\D*?)[\s_.]*[\[(]?(\d+)[\])]?(?:[\s_.]*(\D+))?$")


@dataclass(frozen=True, slots=True)
class Column:
    """quantity: one of NAMES. number: of the joint as the header counts, None of time. unit: as in UNITS, None where
    none stands there.
    """

    quantity: str
    number: int | None
    unit: str | None


def columns_of(header: Sequence[str]) -> dict[int, Column]:
    """The columns of a recording by their place. Of a quantity that stands there as in COLUMN others are not looked at.

    Raises ValueError as `column_of` does.
    """
    exact = {match.group(1) for match in map(COLUMN.match, header) if match} | ({"t"} & set(header))
    found: dict[int, Column] = {}
    for place, name in enumerate(header):
        column = column_of(name, exact)
        if column is not None:
            found[place] = column
    return found


def column_of(name: str, exact: Collection[str] = ()) -> Column | None:
    """What a column is by its name, None where it is nothing of a recording. exact: quantities taken by COLUMN alone.

    Raises ValueError for a unit in brackets that its quantity cannot have, with what is known.
    """
    plain = COLUMN.match(name)
    if plain is not None:
        return Column(plain.group(1), int(plain.group(2)), None)
    bracketed = _IN_BRACKETS.match(name)
    rest, stated = (name, None) if bracketed is None else bracketed.groups()
    numbered = _WITH_NUMBER.match(rest)
    text, number, behind = (rest, None, None) if numbered is None else numbered.groups()
    words = [word for word in re.split(r"[\s_.]+", text.lower()) if word]
    unit_words = [] if behind is None else [behind.strip("_ ")]
    for length in range(len(words), 0, -1):
        called = "_".join(words[:length])
        quantity = next((each for each, names in NAMES.items() if called in names), None)
        if quantity in exact and name != "t":
            return None
        if quantity is None or (number is None) != (quantity == "t"):
            continue
        written = [*("_".join(words[length:]),) * (length < len(words)), *unit_words]
        if len(written) + (stated is not None) > 1:
            return None
        unit = _unit(UNIT_OF.get(quantity, quantity), stated if stated is not None else "".join(written))
        # Without brackets a letter may stand for anything: q_m is as likely measured as in metres.
        if written and (unit is None or (len(written[0]) == 1 and quantity != "t")):
            return None
        if unit is None and stated is not None:
            raise ValueError(f"column '{name}': {unknown_unit(UNIT_OF.get(quantity, quantity), stated)}")
        return Column(quantity, None if number is None else int(number), unit)
    return None


def _unit(quantity: str, text: str) -> str | None:
    """The unit of UNITS that a text spells, None for another."""
    spelt = text.strip()
    if spelt in UNITS[quantity]:
        return spelt
    plain = _TIMES.sub("", spelt.lower() if not spelt.startswith("M") else spelt)
    for said, meant in _SPELT:
        plain = plain.replace(said, meant)
    plain = re.sub(r"[/_]s(ec(ond)?)?s?$", "/s", plain)
    plain = {"sec": "s", "second": "s", "seconds": "s", "newtonmeter": "nm", "ampere": "a"}.get(plain, plain)
    return next((unit for unit in UNITS[quantity] if unit.lower() == plain), None)


def units_of(columns: Mapping[int, Column]) -> tuple[dict[str, str], dict[int, float]]:
    """The unit of each quantity whose columns {place: Column} state it, and factors to SI of columns that differ.

    Raises ValueError where some columns of a quantity state a unit and others none, or currents stand beside torques.
    """
    units: dict[str, str] = {}
    factors: dict[int, float] = {}
    for quantity in UNITS:
        own = {place: each for place, each in columns.items() if UNIT_OF.get(each.quantity, each.quantity) == quantity}
        stated = {each.unit for each in own.values()}
        if stated <= {None}:
            continue
        known = sorted(unit for unit in stated if unit is not None)
        if None in stated:
            raise ValueError(f"some columns of {quantity} state a unit ({', '.join(known)}), others none; state all")
        if len(known) == 1:
            units[quantity] = known[0]
            continue
        if "A" in known:
            raise ValueError(
                f"columns of {quantity} are in {' and '.join(known)}; a recording holds torques or currents"
            )
        factors.update({place: UNITS[quantity][str(each.unit)] for place, each in own.items()})
        units[quantity] = next(iter(UNITS[quantity]))
    return units, factors
