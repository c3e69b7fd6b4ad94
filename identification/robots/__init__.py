"""Robots: kinematics by name, from a modified Denavit-Hartenberg table or from a URDF, as one value object.

`load_robot` is the door; the built-in tables are in `data`. Inertial parameters are not here: they are identified.
"""

from __future__ import annotations

from dataclasses import replace
from importlib import resources
from pathlib import Path

from identification.errors import RobotError, RobotNotFoundError, reason_of
from identification.robots.flange import IIWA_FLANGE
from identification.robots.installation import STANDARD_GRAVITY, Installation
from identification.robots.locking import lock_joints
from identification.robots.model import BUILT_IN, Kinematics, RobotModel
from identification.robots.modified_denavit_hartenberg import robot_from_arrays, robot_from_table
from identification.robots.urdf import robot_from_urdf
from identification.robots.urdf_parser import text_of

__all__ = [
    "BUILT_IN_ROBOTS",
    "STANDARD_GRAVITY",
    "Installation",
    "Kinematics",
    "RobotModel",
    "load_robot",
    "robot_from_arrays",
    "robot_from_table",
    "robot_from_urdf",
]

BUILT_IN_ROBOTS = ("iiwa14", "iiwa7")


def load_robot(spec: str | Path, installation: Installation | None = None) -> RobotModel:
    """The robot called `spec` (`iiwa14`, `iiwa7`) or described by the file `spec` (`.urdf`, or `.csv` with MDH rows).

    installation: which way it weighs and which joints are held; None: it stands on a floor and every joint moves.
    Raises RobotNotFoundError (exit code 66) if there is neither, RobotError (65) if the file cannot be used.
    """
    chosen = installation if installation is not None else Installation()
    robot = lock_joints(_described(spec, chosen.gravity), dict(chosen.locked_joints))
    return replace(robot, locked_joints=chosen.locked_joints)


def _described(spec: str | Path, gravity: tuple[float, float, float]) -> RobotModel:
    if str(spec) in BUILT_IN_ROBOTS:
        table = resources.files("identification.robots.data").joinpath(f"{spec}_mdh.csv").read_text("utf-8")
        built_in = robot_from_table(table, name=str(spec), source=f"{BUILT_IN}{spec}", gravity=gravity)
        return replace(built_in, flange=IIWA_FLANGE)
    path = Path(spec)
    if not path.is_file():
        raise RobotNotFoundError(
            f"There is no robot '{spec}': it is neither a file nor one of {', '.join(BUILT_IN_ROBOTS)}.", file=path
        )
    try:
        text = text_of(path)
    except (OSError, ValueError, LookupError) as error:
        raise RobotError(f"{path} cannot be read as text: {reason_of(error)}.", file=path) from error
    suffix = path.suffix.lower()
    if suffix == ".csv":
        return robot_from_table(text, name=path.stem, source=str(path), gravity=gravity)
    if suffix in (".urdf", ".xml"):
        return robot_from_urdf(text, source=str(path), gravity=gravity)
    raise RobotError.at(path, f"a robot is described by a .urdf file or a .csv table, not by '{suffix}'.")
