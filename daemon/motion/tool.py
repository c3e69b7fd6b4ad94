"""The tool on the flange: what the operator says of its load and its shape, in one structure.

Here: `--tool MASS@X,Y,Z`, the file `tool.yaml`, the same keys in the workspace file, and the words for log and screen.
Not here: distances (`workspace`), torques (`torque_foresight`). Everything is in the flange's frame, z outwards, as the
load data on the cabinet.

    name: gripper
    mass_kg: 2.5
    center_of_mass_m: [0.0, 0.0, 0.06]
    inertia_kg_m2: [0.004, 0.004, 0.002, 0.0, 0.0, 0.0]     # about the centre of mass: xx, yy, zz, xy, xz, yz
    length_m: 0.2                                          # a capsule from the flange outwards
    radius_m: 0.05
"""

from __future__ import annotations

import math
import re
from pathlib import Path

import msgspec
import numpy as np

from daemon.config import read_settings
from daemon.errors import ConfigurationError

FastenedMass = tuple[float, float, float, float]
"""A known mass that is fastened to the tool: kg, and m from the flange."""
NO_TOOL = "none"
HEAVIEST_KG = 50.0
"""More than any arm of the family carries: such a mass is meant in grams."""
FARTHEST_M = 2.0
"""Farther from the flange is meant in mm."""
_A_LOAD_ALONE = re.compile(r"[\s\d.,;:+-]*(kg|g)?[\s\d.,;:+-]*", re.IGNORECASE)
"""Numbers and at most a unit of mass: "2.5", "2.5 kg", "2.5; 0, 0, 0.06"."""


class Tool(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """A tool; what is None is not known. inertia_kg_m2: about the centre of mass, xx, yy, zz, xy, xz, yz."""

    name: str = ""
    mass_kg: float | None = None
    center_of_mass_m: tuple[float, float, float] | None = None
    inertia_kg_m2: tuple[float, float, float, float, float, float] | None = None
    length_m: float | None = None
    radius_m: float | None = None

    def over(self, other: Tool | None) -> Tool:
        """The tool, with what it leaves open taken from another description of it."""
        if other is None:
            return self
        own = {name: value for name in self.__struct_fields__ if (value := getattr(self, name)) not in (None, "")}
        return msgspec.structs.replace(other, **own)

    def inertia(self) -> np.ndarray:
        """(3, 3) kg m² about the centre of mass; zeros where it is not known."""
        xx, yy, zz, xy, xz, yz = self.inertia_kg_m2 or (0.0,) * 6
        return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])

    def with_mass(self, mass_kg: float, place_m: tuple[float, float, float]) -> Tool:
        """The tool with a point mass fastened to it; place_m: from the flange."""
        own_kg, own_m = self.mass_kg or 0.0, np.array(self.center_of_mass_m or (0.0, 0.0, 0.0))
        whole_kg, place = own_kg + mass_kg, np.array(place_m)
        center = (own_kg * own_m + mass_kg * place) / whole_kg
        inertia = self.inertia()
        for kg, at in ((own_kg, own_m - center), (mass_kg, place - center)):
            inertia = inertia + kg * (at @ at * np.eye(3) - np.outer(at, at))
        xx, yy, zz, xy, xz, yz = (float(inertia[i, j]) for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)))
        x, y, z = (float(value) for value in center)
        return msgspec.structs.replace(
            self, mass_kg=whole_kg, center_of_mass_m=(x, y, z), inertia_kg_m2=(xx, yy, zz, xy, xz, yz)
        )

    def describe(self) -> str:
        """One line for log and screen: "gripper, 2.5 kg at (0, 0, 0.06) m, 0.2 m long with radius 0.05 m"."""
        words = [self.name] if self.name else []
        if self.mass_kg is not None:
            words.append(f"{self.mass_kg:g} kg at ({', '.join(f'{x:g}' for x in self.center_of_mass_m or ())}) m")
        if self.length_m is not None:
            words.append(f"{self.length_m:g} m long with radius {self.radius_m:g} m")
        return ", ".join(words) or NO_TOOL

    def tags(self) -> dict[str, str]:
        """Its load data for the metadata of a log, as far as they are known; lists as "x, y, z"."""
        found: dict[str, str] = {}
        if self.mass_kg is not None:
            found["tool_mass_kg"] = repr(self.mass_kg)
            found["tool_center_of_mass_m"] = ", ".join(map(repr, self.center_of_mass_m or ()))
        if self.inertia_kg_m2 is not None:
            found["tool_inertia_kg_m2"] = ", ".join(map(repr, self.inertia_kg_m2))
        return found


def fastened(said: FastenedMass | None, before: FastenedMass | None) -> FastenedMass | None:
    """The known mass on the flange: what is said of it, else what was there before; one of 0 kg is off again."""
    mass = said or before
    return mass if mass is not None and mass[0] > 0.0 else None


def read_tool(text: str, *, is_name: bool = False) -> Tool | None:
    """A tool from what an operator writes: "none", MASS@X,Y,Z in kg and m, or the name of a YAML file.

    is_name: any other text is taken as the tool's name, which the log then carries, unless it looks like a load or a
    file. Raises MissingInputError for a file that is not there, ConfigurationError for everything that describes no
    tool.
    """
    if text.strip().lower() == NO_TOOL:
        return None
    if Path(text).suffix.lower() in (".yaml", ".yml"):
        return check_tool(read_settings(text, Tool, "the tool"), text)
    mass, at, place = text.partition("@")
    try:
        numbers = [float(number) for number in (mass, *place.split(","))] if at else []
    except ValueError:
        numbers = []
    if len(numbers) == 4:
        return check_tool(Tool(mass_kg=numbers[0], center_of_mass_m=(numbers[1], numbers[2], numbers[3])), None)
    if is_name and text.strip() and not _is_meant_as_more(text):
        return Tool(name=text.strip())
    name = " A name has a letter, no @, no / and no ending of a file." if is_name else ""
    raise ConfigurationError(
        f"'{text}' is no tool: give MASS@X,Y,Z in kg and m from the flange, such as 2.5@0,0,0.06, a file tool.yaml, or "
        f"none.{name}",
        field="tool",
    )


def _is_meant_as_more(text: str) -> bool:
    """Whether a text that is no load and no file of ours was meant as one: as a name it would weigh nothing."""
    return (
        "@" in text
        or "/" in text
        or Path(text).suffix.lower() in (".json", ".toml", ".txt", ".urdf", ".xml")
        or _A_LOAD_ALONE.fullmatch(text) is not None
    )


def check_tool(tool: Tool, file: str | None, place: str = "") -> Tool:
    """The tool itself. Raises ConfigurationError naming file and field of what no tool can have."""

    def refuse(field: str, reason: str) -> ConfigurationError:
        return ConfigurationError(reason, file=file, field=f"{place}{field}" if file else f"tool {field}")

    mass, center = tool.mass_kg, tool.center_of_mass_m
    if (mass is None) != (center is None):
        raise refuse("mass_kg", "A mass needs its centre (center_of_mass_m), and the other way round.")
    if mass is not None and not 0.0 <= mass <= HEAVIEST_KG:
        raise refuse("mass_kg", f"{mass:g} kg is no mass of a tool (0 to {HEAVIEST_KG:g} kg).")
    if center is not None and not math.hypot(*center) <= FARTHEST_M:
        raise refuse("center_of_mass_m", f"{center} m is farther than {FARTHEST_M:g} m from the flange.")
    if tool.inertia_kg_m2 is not None:
        if not all(map(math.isfinite, tool.inertia_kg_m2)) or mass is None:
            raise refuse("inertia_kg_m2", "Six finite numbers and a mass are needed.")
        least, middle, largest = np.linalg.eigvalsh(tool.inertia())
        if least < -1e-9 or largest > (least + middle) * (1.0 + 1e-9) + 1e-9:
            raise refuse(
                "inertia_kg_m2",
                f"No body has the principal moments {least:.4g}, {middle:.4g}, {largest:.4g} kg m²: none is negative, "
                "and the largest is at most the sum of the others.",
            )
        if least + middle + largest > 2.0 * mass * FARTHEST_M**2:
            raise refuse(
                "inertia_kg_m2",
                f"A body of {mass:g} kg with the moment {largest:.4g} kg m² would reach beyond {FARTHEST_M:g} m; are "
                "these kg m², about the centre of mass?",
            )
    if (tool.length_m is None) != (tool.radius_m is None):
        raise refuse("length_m", "A shape needs both length_m and radius_m.")
    for field in ("length_m", "radius_m"):
        value = getattr(tool, field)
        if value is not None and not 0.0 <= value <= FARTHEST_M:
            raise refuse(field, f"{value:g} m is no measure of a tool (0 to {FARTHEST_M:g} m).")
    return tool
