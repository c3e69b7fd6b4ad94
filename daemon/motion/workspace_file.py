"""The workspace file as the operator writes it: the structure of the YAML.

Not here: its checks and its form for the preflight (`workspace`).

    floor_height_m: -0.75          # height of the floor in the base frame (z = 0: mounting face); null: no floor
    walls:
      - {name: fence, normal: [1, 0, 0], offset_m: -0.8}      # the arm stays where normal . x >= offset
    boxes:
      - {name: camera post, center_m: [0.7, 0.4, 0.9], size_m: [0.1, 0.1, 1.8], yaw_rad: 0.0}
    tool: {length_m: 0.2, radius_m: 0.05, mass_kg: 2.5, center_of_mass_m: [0, 0, 0.06]}     # see `tool`
    margins: {self_collision_m: 0.02, workspace_m: 0.02}
"""

from __future__ import annotations

import msgspec

from daemon.motion.tool import Tool
from safety.geometry import SELF_COLLISION_MARGIN_M, WORKSPACE_MARGIN_M


class _Section(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of all sections: immutable, unknown keys refused."""


class WallEntry(_Section, frozen=True, kw_only=True):
    """The arm stays where normal . x >= offset_m; a normal of any length is brought to length 1 first."""

    name: str
    normal: tuple[float, float, float]
    offset_m: float


class BoxEntry(_Section, frozen=True, kw_only=True):
    """A box the arm must not enter: centre and full edges in the base frame, turned by yaw_rad about z."""

    name: str
    center_m: tuple[float, float, float]
    size_m: tuple[float, float, float]
    yaw_rad: float = 0.0


class Margins(_Section, frozen=True, kw_only=True):
    """Distances that are kept, m."""

    self_collision_m: float = SELF_COLLISION_MARGIN_M
    workspace_m: float = WORKSPACE_MARGIN_M


class WorkspaceFile(_Section, frozen=True, kw_only=True):
    """The whole file; what is left out is not there, except a floor at the mounting face."""

    floor_height_m: float | None = 0.0
    walls: tuple[WallEntry, ...] = ()
    boxes: tuple[BoxEntry, ...] = ()
    tool: Tool | None = None
    margins: Margins = Margins()
