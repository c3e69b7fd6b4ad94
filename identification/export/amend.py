"""A simulator's file with what an audit found written back into it: load, link, friction, gravity; nothing else moves.

Here: which numbers, in whose frame, and the check by reading the file back. Not here: the formats (`amended_files`) and
the search (`audit`).
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pinocchio

from identification.arrays import FloatArray
from identification.audit.difference import Difference
from identification.base_parameters import BaseRegressor, RegressorOptions
from identification.errors import ExportCheckError, ModelFileError, RobotError
from identification.export.amended_files import (
    Changes,
    moment_matrix,
    write_mjcf_changes,
    write_sdf_changes,
    write_urdf_changes,
)
from identification.export.given_bodies import in_file_base, load_as_held, poses_at_zero
from identification.mismatch.settings import CAPTURE
from identification.physical_parameters import symmetric
from identification.regressor import INERTIAL_SYMBOLS
from identification.robots import Kinematics, RobotModel
from identification.robots.joint_units import in_units
from identification.robots.simulator_models import base_in_file, drake_plant, drake_rest, read_simulator_model

TOLERANCE = 1e-3
"""Of the torque's size: what is read back has to be what was meant."""
STATES, SEED = 40, 13
_TENSOR = ("XX", "XY", "XZ", "YY", "YZ", "ZZ")


@dataclass(frozen=True, slots=True, eq=False)
class Amended:
    """path: the file. written: sentences of what stands in it now; left: of what has no place in it. gravity: (3,) m/s²
    in the frame of the base as the file has it now.
    """

    path: Path
    written: tuple[str, ...]
    left: tuple[str, ...]
    gravity: FloatArray


@dataclass(slots=True)
class _Wanted:
    """What is to change, in the robot's frames and numbers of joints."""

    bodies: dict[int, FloatArray] = field(default_factory=dict)
    drives: dict[str, dict[int, float]] = field(default_factory=lambda: {"FV": {}, "FS": {}, "IA": {}})
    gravity: FloatArray | None = None
    written: list[str] = field(default_factory=list)
    left: list[str] = field(default_factory=list)


def amend(source: Path, differences: Sequence[Difference], robot: RobotModel, target: Path) -> Amended:
    """Write `source` with the differences put right into `target`, in the same format, and read it back.

    Raises ModelFileError where the formats differ, a link would have no mass or a joint is not in the file;
    ExportCheckError where the file that was written does not have the torque that was meant.
    """
    kind = _kind(source)
    if source.suffix.lower() != target.suffix.lower():
        raise ModelFileError.at(target, f"a changed model keeps its format; give a name that ends in {source.suffix}.")
    wanted = _wanted(differences, robot, has_armature=kind == "mujoco")
    names, poses, points = _frames(source, kind, robot)
    filed = in_file_base(robot).kinematics
    turn = base_in_file(source, robot)
    ours = _base_in_world(turn, filed, points) @ poses_at_zero(filed)
    bodies = {
        names[link]: (move := np.linalg.solve(poses[link], ours[link])) @ body @ move.T
        for link, body in wanted.bodies.items()
    }
    drives = {
        symbol: {names[joint]: value for joint, value in table.items()} for symbol, table in wanted.drives.items()
    }
    changes = Changes(bodies, drives["FV"], drives["FS"], drives["IA"], None)
    write: Callable[[Path, Path, Changes], None] = {
        "robot": write_urdf_changes, "sdf": write_sdf_changes, "mujoco": write_mjcf_changes
    }[kind]  # fmt: skip
    regressor = BaseRegressor(robot, RegressorOptions(rotor_inertia=True))
    before = read_simulator_model(source, regressor)
    write(source, target, changes)
    _check(before, target, wanted, regressor)
    gravity = np.array(robot.gravity)
    if wanted.gravity is not None:
        gravity = wanted.gravity
        # The base of a built-in arm's table is turned against that of a file.
        base = turn @ filed.rotation[0] @ robot.kinematics.rotation[0].T
        found, stated = base @ gravity, base @ robot.gravity
        if not np.array_equal(turn, np.eye(3)):
            # A base that hangs turned in the file does so in a world where gravity points down.
            stated = np.array([0.0, 0.0, -float(np.linalg.norm(gravity))])
        write(source, target, replace(changes, turn=_turn(found, stated), gravity=found))
        wanted.left.append("A turned base is the pose or gravity of a world: a simulator that sets its own undoes it.")
    return Amended(target, tuple(wanted.written), tuple(wanted.left), gravity)


def _kind(source: Path) -> str:
    try:
        tag = ElementTree.parse(source).getroot().tag
    except (ElementTree.ParseError, OSError) as error:
        raise ModelFileError(f"{source} cannot be read as a simulator model: {error}", file=source) from error
    if tag not in ("robot", "sdf", "mujoco"):
        raise ModelFileError.at(source, f"is neither URDF, SDF nor MJCF (its root is <{tag}>).")
    return tag


def _wanted(differences: Sequence[Difference], robot: RobotModel, *, has_armature: bool) -> _Wanted:
    wanted = _Wanted()
    for item in differences:
        numbers = {number.name: number.value for number in item.numbers}
        if item.effect in ("payload", "link_parameters") and item.link is not None:
            link = item.link - 1
            wanted.bodies[link] = wanted.bodies.get(link, np.zeros((4, 4))) + _body(numbers, link, robot)
        elif item.effect == "friction_change" and item.joint is not None:
            for symbol, name in (("FV", "viscous"), ("FS", "coulomb")):
                wanted.drives[symbol][item.joint - 1] = numbers.get(name, 0.0)
            offset = next((number for number in item.numbers if number.name == "offset"), None)
            # A tenth of the friction that is written is nothing beside it, however well it is known.
            matters = CAPTURE * abs(numbers.get("coulomb", 0.0))
            if offset is not None and abs(offset.value) > max(1.96 * offset.std, matters):
                said = f"Joint {item.joint} has a constant torque of {offset.value:.3g} Nm, "
                if any(each.link is not None for each in differences):
                    said += "or so much is left of the weight of the body that was written, whose numbers have "
                    said += "intervals: not written."
                else:
                    said += "which no simulator's file has a place for: apply it as a joint torque."
                wanted.left.append(in_units(said, robot.units, (item.joint,)))
        elif item.effect == "rotor_inertia" and has_armature:
            joints = item.joints if item.joint is None else (item.joint,)
            for joint, number in zip(joints, item.numbers, strict=True):
                wanted.drives["IA"][joint - 1] = number.value
        elif item.effect == "base_tilt":
            wanted.gravity = np.array([numbers[f"gravity_{axis}"] for axis in "xyz"])
        else:
            wanted.left.append(f"Not written, a simulator's file has no place for it: {item.sentence}")
            continue
        wanted.written.append(item.sentence)
    return wanted


def _body(numbers: dict[str, float], link: int, robot: RobotModel) -> FloatArray:
    """(4, 4) of a load or of a link's change, in the frame of the robot's link."""
    mass = numbers.get("mass", 0.0)
    if "com_x" in numbers:
        center = np.array([numbers[f"com_{axis}"] for axis in "xyz"])
        if robot.flange is not None and robot.flange.link == link:
            center = robot.flange.rotation @ center + robot.flange.origin
        moment = mass * center
    else:
        moment = np.array([numbers.get(f"first_moment_{axis}", 0.0) for axis in "xyz"])
    point = np.zeros((3, 3)) if not mass else (moment @ moment * np.eye(3) - np.outer(moment, moment)) / mass
    if not any(name in numbers for name in _TENSOR):
        return moment_matrix(mass, moment, point)
    return moment_matrix(mass, moment, symmetric(np.array([numbers.get(name, 0.0) for name in _TENSOR])))


_Frames = dict[str, tuple[FloatArray, FloatArray]]
"""Joint's name → (4, 4) pose of its link and (3,) a point on its axis, both at zero in the world of a file."""


def _frames(source: Path, kind: str, robot: RobotModel) -> tuple[list[str], list[FloatArray], FloatArray]:
    """Names of the file's joints in the robot's order, poses of their links, and points (n, 3) on their axes."""
    if kind == "robot":
        given = load_as_held(source, robot)
        poses = poses_at_zero(given.kinematics)
        found: _Frames = dict(zip(given.joint_names, zip(poses, poses[:, :3, 3], strict=True), strict=True))
    elif kind == "mujoco":
        found = _mujoco_frames(source, robot)
    else:
        found = _drake_frames(source, robot)
    names = list(robot.joint_names) if all(name in found for name in robot.joint_names) else list(found)
    if len(names) != robot.n:
        raise ModelFileError.at(source, f"has {len(found)} movable joints, {robot.name} has {robot.n}.")
    return names, [found[name][0] for name in names], np.array([found[name][1] for name in names])


def _base_in_world(turn: FloatArray, filed: Kinematics, points: FloatArray) -> FloatArray:
    """(4, 4) pose of the robot's base in the world of a file: so turned, and so placed that the axes are those there.

    points: (n, 3) m on them. Axes are lines, so a point counts across its own only. Where they leave a direction open,
    no torque depends on it.
    """
    ours, base = poses_at_zero(filed), np.eye(4)
    axes = np.einsum("ij,njk,nk->ni", turn, ours[:, :3, :3], filed.axis)[filed.revolute]
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    off = (points - ours[:, :3, 3] @ turn.T)[filed.revolute]
    base[:3, :3] = turn
    base[:3, 3] = np.linalg.lstsq(across.reshape(-1, 3), np.einsum("nij,nj->ni", across, off).ravel(), rcond=None)[0]
    return base


def _mujoco_frames(source: Path, robot: RobotModel) -> _Frames:
    import mujoco

    model = mujoco.MjModel.from_xml_path(str(source))
    data = mujoco.MjData(model)
    data.qpos[:] = model.qpos0
    moving = [joint for joint in range(model.njnt) if model.jnt_type[joint] >= int(mujoco.mjtJoint.mjJNT_SLIDE)]
    held = dict(robot.locked_joints)
    for joint in moving:
        data.qpos[model.jnt_qposadr[joint]] = held.get(model.joint(joint).name, 0.0)
    mujoco.mj_kinematics(model, data)
    found: _Frames = {}
    for joint in moving:
        if not model.joint(joint).name:
            raise ModelFileError.at(source, "it has joints without a name, so what differs cannot be written to them.")
        body = model.jnt_bodyid[joint]
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = data.xmat[body].reshape(3, 3), data.xpos[body]
        found[model.joint(joint).name] = pose, np.array(data.xanchor[joint])
    return found


def _drake_frames(source: Path, robot: RobotModel) -> _Frames:
    plant, joints = drake_plant(source, ElementTree.parse(source).getroot())
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, drake_rest(plant, joints, robot))
    return {
        joint.name(): (
            np.asarray(joint.child_body().body_frame().CalcPoseInWorld(context).GetAsMatrix4(), dtype=np.float64),
            np.asarray(joint.frame_on_child().CalcPoseInWorld(context).translation(), dtype=np.float64),
        )
        for joint in joints
    }


def _turn(found: FloatArray, stated: FloatArray) -> FloatArray:
    """(3, 3) the base in a world where gravity is as stated: R with Rᵀ · stated = found."""
    return np.asarray(pinocchio.Quaternion.FromTwoVectors(found, np.asarray(stated)).toRotationMatrix())


def _check(before: FloatArray, target: Path, wanted: _Wanted, regressor: BaseRegressor) -> None:
    """Refuse a file that does not weigh or rub as it was meant to; say where an inertia is no body's."""
    robot = regressor.robot
    try:
        after = read_simulator_model(target, regressor)
    except RobotError:
        target.unlink(missing_ok=True)
        raise
    symbols = (*INERTIAL_SYMBOLS, *regressor.options.symbols)
    added = np.zeros((robot.n, len(symbols)))
    for link, body in wanted.bodies.items():
        tensor = np.trace(body[:3, :3]) * np.eye(3) - body[:3, :3]
        added[link, :10] = [body[3, 3], *body[:3, 3], *tensor[np.triu_indices(3)]]
    for symbol, table in wanted.drives.items():
        for joint, value in table.items():
            added[joint, symbols.index(symbol)] = value
    off = after - (before + regressor.regrouping @ added.ravel())
    generator = np.random.default_rng(SEED)
    q, dq, ddq = (generator.uniform(-1.5, 1.5, (STATES, robot.n)) for _ in range(3))
    still = np.zeros_like(q)
    drives = np.array([not name.startswith(("FV", "FS")) for name in regressor.names])
    whole = regressor.matrix(q, dq, ddq)
    size = float(np.abs(whole @ after).max())
    weight = np.abs(regressor.matrix(q, still, still) @ off).max()
    friction = np.abs(whole @ np.where(drives, 0.0, off)).max()
    wrong = float(max(weight, friction))
    if wrong > TOLERANCE * size:
        target.unlink(missing_ok=True)
        raise ExportCheckError(
            f"{target}: read back, its torque is {wrong:.3g} Nm from what was meant: the file's frames are others. "
            "Nothing was written.",
            file=target,
            program="the reader of this program",
            difference_nm=wrong,
        )
    if float(np.abs(whole @ off).max()) > TOLERANCE * size:
        wanted.left.append("The inertia that was found is no body's: the nearest that a body can have was written.")
