"""Simulator models (URDF, SDF, MJCF with inertias) as base parameters: what torque the user's simulator computes.

The file is asked for inverse dynamics at random states, by Pinocchio, MuJoCo or Drake, and base parameters are those
whose torque is the same. So frames, fixed links and conventions of the file need no translation; where the torque
cannot be matched, its kinematics is another and that is the answer. Not here: comparing with recordings.
"""

from __future__ import annotations

import importlib.util
import logging
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio

from identification.arrays import FloatArray
from identification.base_parameters import BaseRegressor, RegressorOptions
from identification.errors import RobotError, RobotNotFoundError
from identification.robots.model import BUILT_IN, TABLE_IN_FILES, RobotModel
from identification.robots.urdf_parser import DRAKE, parsed_urdf, refuse_xacro, text_of

InverseDynamics = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]
"""(q, q̇, q̈), each (n,) → torque (n,) Nm."""

STATES = 120
SEED = 96
FARTHEST = 2.0
"""rad (m) from zero, of the states at which a file is asked."""
DRAWN = 0.05
"""Share by which what a file says of a link is off."""
TOLERANCE = 1e-4
"""Of the largest torque: files print angles and lengths with few digits."""
FEW_DIGITS = 1e-3
"""By which entries of unit vectors differ that a file prints with few digits."""
BESIDE_BODIES = {
    "qfrc_spring": "springs (stiffness)",
    "qfrc_gravcomp": "gravity compensation (gravcomp)",
    "qfrc_damper": "damping that is no viscous friction of one joint (of a tendon, or polynomial)",
    "qfrc_fluid": "a fluid (density, viscosity)",
    "qfrc_constraint": "constraints (equality)",
}
"""MuJoCo's forces that are neither a rigid body's nor friction."""


class _Opened(NamedTuple):
    """Inverse dynamics under the robot's gravity; as `base_in_file`; movable joints that the robot does not know."""

    torque: InverseDynamics
    base: FloatArray
    unknown: tuple[str, ...]


def read_simulator_model(path: str | Path, regressor: BaseRegressor) -> FloatArray:
    """Base parameters (p,) whose torque is that of a simulator model, friction of its joints included.

    Joints are taken by name, or in the order of the file where the names differ and the number is the same. Raises
    RobotNotFoundError where there is no file, RobotError where it cannot be read, has no inertias, moves otherwise
    than the regressor's robot, or has joints besides that matter where they stand, as fingers do not.
    """
    path = Path(path)
    if not path.is_file():
        raise RobotNotFoundError.at(path, "there is no such model")
    opened = _opened(path, regressor.robot)
    draw, shape = np.random.default_rng(SEED), (STATES, regressor.robot.n)
    q, dq, ddq = draw.uniform(-FARTHEST, FARTHEST, shape), draw.uniform(-1.5, 1.5, shape), draw.normal(size=shape)
    states = list(zip(q, dq, ddq, strict=True))
    torque = np.array([opened.torque(*state) for state in states])
    if not np.any(np.abs(torque) > 1e-9):
        raise RobotError.at(path, "it gives no link a mass; a model to compare with needs inertias.")
    if opened.unknown:
        bent = _opened(path, regressor.robot, FARTHEST).torque
        moved = np.array([bent(*state) for state in states]) - torque
        share = np.linalg.norm(moved) / np.linalg.norm(torque)
        if share > DRAWN:
            raise RobotError.at(
                path,
                f"has {', '.join(opened.unknown)} beside the joints of {regressor.robot.name}, and {100 * share:.0f} % "
                "of the torque depends on where they stand. Give a model of the arm that was recorded.",
            )
    columns = regressor.matrix(q, dq, ddq).reshape(-1, regressor.size)
    scale = np.linalg.norm(columns, axis=0)
    values = np.linalg.lstsq(columns / scale, torque.ravel(), rcond=None)[0] / scale
    left = np.abs(torque.ravel() - columns @ values).reshape(shape).max(axis=0)
    if left.max() > TOLERANCE * np.abs(torque).max():
        joint = int(np.argmax(left))
        reason = _beside_bodies(path, regressor.robot, (q, dq, ddq), TOLERANCE * float(np.abs(torque).max()))
        raise RobotError.at(
            path,
            f"its torque on joint {joint + 1} cannot be that of {regressor.robot.name} with any inertias "
            f"({left[joint]:.2g} Nm differ); {reason or 'zero positions, axes, lengths or gravity are others.'}",
            joint=joint + 1,
        )
    return np.asarray(values, dtype=np.float64)


def base_in_file(path: Path, robot: RobotModel) -> FloatArray:
    """(3, 3) how the base that gravity is stated for stands in the world of a simulator model. Raises RobotError."""
    return _opened(path, robot).base


def read_with_drives(path: str | Path, robot: RobotModel) -> tuple[BaseRegressor, FloatArray]:
    """A regressor that can have the torque of a simulator model, with rotor inertias where the file's joints have some
    (`armature`), and its base parameters (p,). Raises as `read_simulator_model`.
    """
    regressor = BaseRegressor(robot)
    try:
        return regressor, read_simulator_model(path, regressor)
    except RobotError as refusal:
        regressor = BaseRegressor(robot, RegressorOptions(rotor_inertia=True))
        try:
            return regressor, read_simulator_model(path, regressor)
        except RobotError:
            raise refusal from None


def _opened(path: Path, robot: RobotModel, others: float = 0.0) -> _Opened:
    """A file with the joints that the robot does not know at `others`, rad (m), or the limit before it."""
    try:
        root = ElementTree.parse(path).getroot()
        match root.tag:
            case "robot":
                return _by_pinocchio(path, root, robot, others)
            case "mujoco":
                return _mujoco_torque(path, robot, others)[-1]
            case "sdf":
                return _by_drake(path, root, robot, others)
    except (ElementTree.ParseError, ValueError, RuntimeError, OSError) as error:
        if isinstance(error, RobotError):
            raise
        raise RobotError(
            f"{path} cannot be read as a simulator model: {str(error).splitlines()[0]}", file=path
        ) from error
    raise RobotError.at(path, f"is neither URDF, SDF nor MJCF (its root is <{root.tag}>).")


def _base_by(axes: FloatArray, robot: RobotModel) -> FloatArray:
    """(3, 3) R with axes = R · those of the robot, both (n, 3) unit vectors at zero, in a file's world and in its base.

    A file may hang its base turned in the world: gravity in the frame of the base is then another in the world. I where
    no turn makes them equal, or where they are all parallel and do not tell.
    """
    model = robot.pinocchio_model
    jacobians = pinocchio.computeJointJacobians(model, model.createData(), np.zeros(model.nq))
    turn = TABLE_IN_FILES if robot.source.startswith(BUILT_IN) else np.ones(3)
    own = _axes_of(jacobians, list(range(model.nv))) * turn
    if np.abs(own - axes).max() < FEW_DIGITS:
        return np.eye(3)
    left, sizes, right = np.linalg.svd(axes.T @ own)
    found = np.asarray(left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right, dtype=np.float64)
    tells = sizes[1] > FEW_DIGITS and np.abs(own @ found.T - axes).max() < FEW_DIGITS
    return found if tells else np.eye(3)


def _axes_of(jacobians: FloatArray, order: Sequence[int]) -> FloatArray:
    """(n, 3) unit vectors along axes, of Pinocchio's joint Jacobians in the world: what turns, else what moves."""
    columns = jacobians.reshape(6, -1)[:, order]  # Pinocchio hands back (6,) for a robot of one joint
    turning, moving = columns[3:].T, columns[:3].T
    return np.asarray(np.where(np.linalg.norm(turning, axis=1, keepdims=True) > 0.5, turning, moving))


def _chosen(path: Path, names: Sequence[str], robot: RobotModel) -> list[int]:
    """Places of the robot's joints among the movable joints of a file."""
    if all(name in names for name in robot.joint_names):
        return [list(names).index(name) for name in robot.joint_names]
    if len(names) == robot.n:
        return list(range(robot.n))
    raise RobotError.at(path, f"has {len(names)} movable joints, {robot.name} has {robot.n}.")


def _unknown(names: Sequence[str], chosen: Sequence[int], robot: RobotModel) -> list[int]:
    """Places of those movable joints of a file that the robot neither has, at these places, nor holds still."""
    held = held_in(names, robot)
    return [place for place, name in enumerate(names) if place not in chosen and name not in held]


def held_in(names: Collection[str], robot: RobotModel) -> dict[str, float]:
    """Those of the joints that the robot holds still that a file has too, with where they stand, rad (m)."""
    return {name: position for name, position in robot.locked_joints if name in names}


def _by_pinocchio(path: Path, root: ElementTree.Element, robot: RobotModel, others: float) -> _Opened:
    refuse_xacro(root, path)
    model = parsed_urdf(text_of(path), bodies=True)
    names = list(model.names)[1:]
    chosen = _chosen(path, names, robot)
    unknown = _unknown(names, chosen, robot)
    order = [model.joints[place + 1].idx_v for place in chosen]
    rest = np.zeros(model.nv)
    for joint in (model.joints[place + 1] for place in unknown):
        limits = model.lowerPositionLimit[joint.idx_q], model.upperPositionLimit[joint.idx_q]
        rest[joint.idx_v] = others if joint.nq > joint.nv else np.clip(others, *limits)
    for name, position in held_in(names, robot).items():
        rest[model.joints[names.index(name) + 1].idx_v] = position
    stand = pinocchio.integrate(model, pinocchio.neutral(model), rest)
    jacobians = pinocchio.computeJointJacobians(model, model.createData(), stand)
    base = _base_by(_axes_of(jacobians, order), robot)
    model.gravity.linear = base @ robot.gravity_in_files
    massless = [place for place in chosen if model.inertias[place + 1].mass <= 0.0]
    if massless and (len(massless) < robot.n or model.inertias[massless[0] + 1].mass):
        mass = model.inertias[massless[0] + 1].mass
        raise RobotError.at(
            path,
            f"what joint '{names[massless[0]]}' moves has {f'a mass of {mass:.4g} kg' if mass else 'no mass'}, "
            "so its torque is not that of an arm. Give that link its <inertial>.",
            joint=chosen.index(massless[0]) + 1,
        )
    dynamics = {joint.get("name"): joint.find("dynamics") for joint in root.findall("joint")}
    elements = [dynamics.get(names[place]) for place in chosen]
    damping, friction = (
        np.array([0.0 if item is None else float(item.get(key, 0.0)) for item in elements])
        for key in ("damping", "friction")
    )

    rotors = _drake_rotors(root)
    rotor = np.array([rotors.get(names[place], 0.0) for place in chosen])
    rigid = pinocchio_torque(model, order, rest)

    def torque(q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
        return np.asarray(rigid(q, dq, ddq) + damping * dq + friction * np.sign(dq) + rotor * ddq, dtype=np.float64)

    return _Opened(torque, base, tuple(names[place] for place in unknown))


def _drake_rotors(root: ElementTree.Element) -> dict[str, float]:
    """Rotor inertia of a URDF's joints as seen there, kg m² (kg): by Drake's tags, as URDF has none of its own."""
    found = {}
    for transmission in root.findall("transmission"):
        joint, actuator = transmission.find("joint"), transmission.find("actuator")
        if joint is not None and actuator is not None:
            stated = {
                tag: element.get("value", "0")
                for tag in ("rotor_inertia", "gear_ratio")
                if (element := actuator.find(f"{{{DRAKE}}}{tag}")) is not None
            }
            gear = float(stated.get("gear_ratio", 1.0))
            found[joint.get("name", "")] = float(stated.get("rotor_inertia", 0.0)) * gear**2
    return found


def pinocchio_torque(model: pinocchio.Model, order: Sequence[int], rest: FloatArray | float = 0.0) -> InverseDynamics:
    """Inverse dynamics of the rigid bodies. order: places of the robot's joints among the model's velocities. rest:
    (nv,) rad (m), where the others stand.
    """
    data = model.createData()

    def torque(q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
        state = np.zeros((3, model.nv))
        state[0] = rest
        state[:, order] = q, dq, ddq
        # A continuous joint has two position numbers there: reach it from zero.
        position = pinocchio.integrate(model, pinocchio.neutral(model), state[0])
        return np.asarray(pinocchio.rnea(model, data, position, state[1], state[2])[order])

    return torque


def _beside_bodies(path: Path, robot: RobotModel, states: tuple[FloatArray, ...], least: float) -> str:
    """Which forces, Nm above `least` at these states, an MJCF has that bodies and friction have not; '' for none."""
    if ElementTree.parse(path).getroot().tag != "mujoco":
        return ""
    model, data, order, (torque, *_) = _mujoco_torque(path, robot)
    by_actuator = model.jnt_actgravcomp[model.dof_jntid[order]].astype(bool)
    largest = dict.fromkeys(BESIDE_BODIES, 0.0)
    for state in zip(*states, strict=True):
        torque(*state)
        for name in largest:
            force = np.where(by_actuator & (name == "qfrc_gravcomp"), 0.0, getattr(data, name)[order])
            if name == "qfrc_damper":
                force = force + model.dof_damping[order] * state[1]
            largest[name] = max(largest[name], float(np.abs(force).max()))
    found = [BESIDE_BODIES[name] for name, value in largest.items() if value > least]
    return f"the file also has {' and '.join(found)}. Take them out of a copy." if found else ""


def _mujoco_torque(path: Path, robot: RobotModel, others: float = 0.0) -> tuple[Any, Any, FloatArray, _Opened]:
    """MuJoCo's model and data, which degrees of freedom the robot's joints are, and what `_opened` hands back."""
    import mujoco

    model = mujoco.MjModel.from_xml_path(str(path))
    for flag in (mujoco.mjtDisableBit.mjDSBL_CONTACT, mujoco.mjtDisableBit.mjDSBL_LIMIT):
        model.opt.disableflags |= flag
    # Its dry friction is a soft constraint; here it is the force at full sliding.
    friction = np.array(model.dof_frictionloss)
    model.dof_frictionloss[:] = 0.0
    data, moving = mujoco.MjData(model), (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
    joints = [joint for joint in range(model.njnt) if model.jnt_type[joint] in moving]
    names = [model.joint(joint).name for joint in joints]
    places = _chosen(path, names, robot)
    unknown = _unknown(names, places, robot)
    order, position = (
        address[[joints[place] for place in places]] for address in (model.jnt_dofadr, model.jnt_qposadr)
    )

    data.qpos[position] = 0.0
    for joint in (joints[place] for place in unknown if others):
        limits = model.jnt_range[joint] if model.jnt_limited[joint] else (-np.inf, np.inf)
        data.qpos[model.jnt_qposadr[joint]] = np.clip(others, *limits)
    for name, stands in held_in(names, robot).items():
        data.qpos[model.joint(name).qposadr] = stands
    mujoco.mj_kinematics(model, data)
    base = _base_by(data.xaxis[[joints[place] for place in places]], robot)
    model.opt.gravity[:] = base @ robot.gravity_in_files

    def torque(q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
        data.qpos[position], data.qvel[order], data.qacc[order] = q, dq, ddq
        mujoco.mj_inverse(model, data)
        return np.asarray(data.qfrc_inverse[order] + friction[order] * np.sign(dq), dtype=np.float64)

    return model, data, order, _Opened(torque, base, tuple(names[place] for place in unknown))


def _by_drake(path: Path, root: ElementTree.Element, robot: RobotModel, others: float) -> _Opened:
    if importlib.util.find_spec("pydrake") is None:
        raise RobotError.at(path, "SDF is read by Drake, which is not installed (pip install drake).")
    logging.getLogger("drake").setLevel(logging.ERROR)  # it warns of dry friction, which is read below
    plant, joints = drake_plant(path, root)
    rest, names = drake_rest(plant, joints, robot), [joint.name() for joint in joints]
    chosen = _chosen(path, names, robot)
    unknown = [joints[place] for place in _unknown(names, chosen, robot)]
    for joint in unknown:
        start = joint.position_start()
        rest[start : start + 1] = np.clip(others, joint.position_lower_limits(), joint.position_upper_limits())
    joints = [joints[place] for place in chosen]
    order = [joint.velocity_start() for joint in joints]
    base = _base_by(_drake_axes(plant, joints, rest), robot)
    plant.mutable_gravity_field().set_gravity_vector(base @ robot.gravity_in_files)
    dry = {item.get("name"): float(item.findtext("axis/dynamics/friction") or 0.0) for item in root.iter("joint")}
    friction = np.array([dry.get(joint.name(), 0.0) for joint in joints])

    rigid = drake_torque(plant, order, rest)

    def torque(q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
        return np.asarray(rigid(q, dq, ddq) + friction * np.sign(dq), dtype=np.float64)

    return _Opened(torque, base, tuple(joint.name() for joint in unknown))


def drake_rest(plant: Any, joints: Sequence[Any], robot: RobotModel) -> FloatArray:
    """(nq,) positions of a plant, rad (m), with the robot's held joints where they stand and all others at zero."""
    rest, places = np.zeros(plant.num_positions()), {joint.name(): joint.position_start() for joint in joints}
    for name, position in held_in(places, robot).items():
        rest[places[name]] = position
    return rest


def _drake_axes(plant: Any, joints: Sequence[Any], rest: FloatArray) -> FloatArray:
    """(n, 3) as `_axes_of`."""
    from pydrake.multibody.tree import JacobianWrtVariable

    context, world = plant.CreateDefaultContext(), plant.world_frame()
    plant.SetPositions(context, rest)
    columns = []
    for joint in joints:
        body = joint.child_body().body_frame()
        whole = plant.CalcJacobianSpatialVelocity(context, JacobianWrtVariable.kV, body, np.zeros(3), world, world)
        columns.append(np.roll(whole[:, joint.velocity_start()], 3))  # Drake has what turns first
    return _axes_of(np.stack(columns, axis=1), list(range(len(joints))))


def drake_plant(path: Path, root: ElementTree.Element) -> tuple[Any, list[Any]]:
    """The model of a file with this root, welded to the world where no joint of its own holds it, and what moves."""
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import MultibodyPlant

    plant = MultibodyPlant(0.0)
    instances = Parser(plant).AddModels(path)
    if len(instances) != 1:
        raise RobotError.at(path, f"it holds {len(instances)} models; give a file with the arm alone.")
    indices = plant.GetJointIndices(instances[0])
    if not any(joint.findtext("parent", "").strip() == "world" for joint in root.iter("joint")):
        carried = {plant.get_joint(index).child_body().index() for index in indices}
        base = plant.get_body(next(index for index in plant.GetBodyIndices(instances[0]) if index not in carried))
        plant.WeldFrames(plant.world_frame(), base.body_frame(), plant.GetDefaultFloatingBaseBodyPose(base))
    plant.Finalize()
    joints = [plant.get_joint(index) for index in plant.GetJointIndices(instances[0])]
    return plant, [joint for joint in joints if joint.num_velocities() == 1]


def drake_torque(plant: Any, order: Sequence[int], rest: FloatArray | float = 0.0) -> InverseDynamics:
    """Inverse dynamics of a plant, damping and rotor inertia included. order, rest: as for `pinocchio_torque`."""
    from pydrake.multibody.tree import MultibodyForces_

    context = plant.CreateDefaultContext()

    def torque(q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
        state = np.zeros((3, plant.num_velocities()))
        state[0] = rest
        state[:, order] = q, dq, ddq
        plant.SetPositions(context, state[0])
        plant.SetVelocities(context, state[1])
        forces = MultibodyForces_[float](plant)
        plant.CalcForceElementsContribution(context, forces)
        return np.asarray(plant.CalcInverseDynamics(context, state[2], forces)[order])

    return torque
