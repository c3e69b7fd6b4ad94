"""How one robot stands in the lab: which way it weighs, and which of its joints are held.

A value object only. `load_robot` applies it to a robot's description; recordings that were imported and model.json
carry it, so that the next command does not have to be told again.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from identification.errors import RobotError

STANDARD_GRAVITY = (0.0, 0.0, -9.81)
_G = abs(STANDARD_GRAVITY[2])
MOUNTS: dict[str, tuple[float, float, float]] = {
    "floor": STANDARD_GRAVITY,
    "ceiling": (0.0, 0.0, _G),
    "wall": (_G, 0.0, 0.0),
}
"""Gravity in the base frame, m/s². On a wall the base's +x axis points down; another turn about the base's z axis is
another gravity, to be given in numbers. The base frame of a built-in arm is `PAPER_BASE`: its +x is the cabinet's −x,
so that its wall is A 0°, B −90°, C 0° there."""
PAPER_BASE = "base frame of the paper's table: base_link of the public URDFs turned by 180° about z"
FILE_BASE = "base frame of the robot's file"
_PLAUSIBLE_GRAVITY = (9.7, 9.9)
"""m/s², anywhere on the ground."""


@dataclass(frozen=True, slots=True)
class Installation:
    """gravity: m/s² in the frame of the base. locked_joints: joints that are held, by name, with their position in rad
    (m). Raises RobotError for a gravity that no place on the ground has and for a position that is not finite.
    """

    gravity: tuple[float, float, float] = STANDARD_GRAVITY
    locked_joints: tuple[tuple[str, float], ...] = ()

    def __post_init__(self) -> None:
        size = float(np.linalg.norm(self.gravity))
        if len(self.gravity) != 3 or not _PLAUSIBLE_GRAVITY[0] <= size <= _PLAUSIBLE_GRAVITY[1]:
            raise RobotError(
                f"Gravity ({', '.join(f'{value:g}' for value in self.gravity)}) is {size:.4g} m/s² long; three numbers "
                f"of {_PLAUSIBLE_GRAVITY[0]} to {_PLAUSIBLE_GRAVITY[1]} m/s² together are needed, in the base's frame.",
                field="gravity",
            )
        for name, position in self.locked_joints:
            if not np.isfinite(position):
                raise RobotError(f"Joint '{name}' cannot be held at {position}.", field=name)
        if len(dict(self.locked_joints)) != len(self.locked_joints):
            raise RobotError("A joint is locked twice.", field="locked_joints")

    @classmethod
    def parse(
        cls, *, gravity: str | None = None, mount: str | None = None, lock: Iterable[str] = ()
    ) -> Installation | None:
        """What a command line says: "X,Y,Z" in m/s², one of MOUNTS, "joint=position" each; None where it says nothing.

        Raises RobotError for text that is none of these.
        """
        locked = tuple(_joint_and_position(item) for text in lock for item in text.split(",") if item.strip())
        if gravity is None and mount is None and not locked:
            return None
        if gravity is not None and mount is not None:
            raise RobotError("Gravity and mount say the same thing; give one of them.", field="gravity")
        if mount is not None:
            if mount not in MOUNTS:
                raise RobotError(f"The mount '{mount}' is none of {', '.join(MOUNTS)}.", field="mount")
            return cls(MOUNTS[mount], locked)
        return cls(STANDARD_GRAVITY if gravity is None else _vector(gravity), locked)

    def to_json(self) -> dict[str, Any]:
        """As plain JSON types."""
        return {"gravity_m_s2": list(self.gravity), "locked_joints": dict(self.locked_joints)}

    @classmethod
    def from_json(cls, data: Mapping[str, Any] | None) -> Installation:
        """What `to_json` wrote; None is an arm on the floor with no joint held. Raises RobotError for anything else."""
        if not data:
            return cls()
        try:
            x, y, z = (float(value) for value in data["gravity_m_s2"])
            locked = {str(name): float(value) for name, value in data["locked_joints"].items()}
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise RobotError(f"The installation is not as it should be ({error!r}).", field="installation") from error
        return cls((x, y, z), tuple(locked.items()))


ON_THE_FLOOR = Installation()
"""Gravity along −z of the base, every joint free."""


def _joint_and_position(text: str) -> tuple[str, float]:
    name, separator, position = text.partition("=")
    try:
        if separator and name.strip():
            return name.strip(), float(position)
    except ValueError:
        pass
    raise RobotError(f"'{text}' does not lock a joint; JOINT=POSITION in rad (m) does.", field="lock")


def _vector(text: str) -> tuple[float, float, float]:
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise RobotError(f"Gravity '{text}' is not X,Y,Z in m/s².", field="gravity") from None
    return x, y, z
