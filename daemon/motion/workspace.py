"""What surrounds the arm and what it carries, checked and in the form that the preflight measures with.

Not here: the structure of the file (`workspace_file`), distances (`safety.collision`), the reading of YAML (`config`).
`check` and `run` read it, and the supervisor before the start ramp.
"""

from __future__ import annotations

import contextlib
import hashlib
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import msgspec

from daemon.config import read_settings
from daemon.errors import ConfigurationError
from daemon.motion.tool import FastenedMass, Tool, check_tool
from daemon.motion.workspace_file import Margins, WallEntry, WorkspaceFile
from safety.collision import ForbiddenBox, Plane, Workspace
from safety.errors import GeometryError
from safety.geometry import RobotGeometry, load_geometry
from safety.limits import JointLimits
from safety.preflight_distance import Distances

FARTHEST_M = 10.0
"""No arm of the family with any tool reaches so far: a floor, wall or box that is farther away is meant in mm."""


@dataclass(frozen=True, slots=True, eq=False)
class Surroundings:
    """What a path is held against. entry: the file with the tool as it is taken. digest: SHA-256 of its content,
    whatever its layout and whatever the tool is called.
    """

    geometry: RobotGeometry
    workspace: Workspace
    entry: WorkspaceFile
    digest: str

    @property
    def margins(self) -> Margins:
        """Distances that are kept, m."""
        return self.entry.margins

    @property
    def tool(self) -> Tool:
        """What is known of the tool."""
        return self.entry.tool or Tool()

    def distances(self, limits: JointLimits) -> Distances:
        """What the preflight measures with."""
        margins = self.margins
        return Distances(self.geometry, self.workspace, limits, margins.self_collision_m, margins.workspace_m)


def load_surroundings(
    robot: str, file: str | Path | None = None, tool: Tool | None = None, added_mass: FastenedMass | None = None
) -> Surroundings:
    """Shape of a built-in arm with its tool, and its surroundings; without a file a floor at the mounting face.

    tool: what it says stands before what the file says of the tool; an empty one takes that away. added_mass: on top of
    the tool, whoever told of that. Raises MissingInputError (66), ConfigurationError (78) naming file and field,
    GeometryError for an unknown robot.
    """
    geometry = load_geometry(robot)
    entry = WorkspaceFile() if file is None else read_settings(file, WorkspaceFile, "workspace")
    if entry.floor_height_m is not None and not abs(entry.floor_height_m) <= FARTHEST_M:
        reason = f"{entry.floor_height_m:g} m is no height of a floor (at most {FARTHEST_M:g} m from the base)."
        raise ConfigurationError(reason, file=str(file), field="floor_height_m")
    for name, margin in msgspec.structs.asdict(entry.margins).items():
        if not 0.0 <= margin < math.inf:
            raise ConfigurationError(f"{margin} m is no distance to keep.", file=str(file), field=f"margins.{name}")
    if entry.tool is not None:
        check_tool(entry.tool, str(file), "tool.")
    if tool is not None:
        entry = msgspec.structs.replace(entry, tool=None if tool == Tool() else tool.over(entry.tool))
    if added_mass is not None:
        loaded = (entry.tool or Tool()).with_mass(added_mass[0], added_mass[1:])
        entry = msgspec.structs.replace(entry, tool=loaded)
    names = ["floor", *(f"link {capsule.link}" for capsule in geometry.capsules)]
    walls = []
    for place, wall in enumerate(entry.walls):
        with _naming(file, f"walls[{place}]"):
            _new_name(wall.name, names)
            walls.append(_plane(wall))
    boxes = []
    for place, box in enumerate(entry.boxes):
        with _naming(file, f"boxes[{place}]"):
            _new_name(box.name, names)
            boxes.append(ForbiddenBox(box.name, box.center_m, box.size_m, box.yaw_rad))
            _within_reach(box.name, math.hypot(*box.center_m) - math.hypot(*box.size_m) / 2.0)
            if abs(box.yaw_rad) > math.tau:
                raise GeometryError(f"{box.name!r} is turned by {box.yaw_rad:g} rad: are these degrees?")
    if entry.tool is not None and entry.tool.length_m is not None:
        with _naming(file, "tool"):
            geometry = geometry.with_tool(entry.tool.length_m, entry.tool.radius_m or 0.0)
    return Surroundings(geometry, Workspace(entry.floor_height_m, tuple(walls), tuple(boxes)), entry, _digest(entry))


def _digest(entry: WorkspaceFile) -> str:
    nameless = None if entry.tool is None else msgspec.structs.replace(entry.tool, name="")
    if nameless == Tool():
        nameless = None
    return hashlib.sha256(msgspec.json.encode(msgspec.structs.replace(entry, tool=nameless))).hexdigest()


@contextlib.contextmanager
def _naming(file: str | Path | None, field: str) -> Iterator[None]:
    """A shape that cannot be becomes a mistake in the file, with its place."""
    try:
        yield
    except GeometryError as error:
        raise ConfigurationError(str(error), file=str(file), field=field) from error


def _new_name(name: str, names: list[str]) -> None:
    if not name or name in names:
        raise GeometryError(f"The name {name!r} is empty or taken; reports need to tell links, walls and boxes apart.")
    names.append(name)


def _plane(wall: WallEntry) -> Plane:
    length = math.hypot(*wall.normal)
    if not 0.0 < length < math.inf:
        raise GeometryError(f"The normal of the wall {wall.name!r} has to point somewhere, not {wall.normal}.")
    x, y, z = (component / length for component in wall.normal)
    plane = Plane(wall.name, (x, y, z), wall.offset_m)
    _within_reach(wall.name, abs(wall.offset_m))
    return plane


def _within_reach(name: str, distance_m: float) -> None:
    if distance_m > FARTHEST_M:
        raise GeometryError(
            f"{name!r} is {distance_m:g} m from the base, where no arm could meet it (at most {FARTHEST_M:g} m): are "
            "these metres?"
        )
