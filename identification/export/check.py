"""Simulator models read back by other programs and compared with the model they came from, in inverse dynamics.

Pinocchio always; MuJoCo and Drake where installed. Here: reading back and comparing. Not here: writing.
Truth is Pinocchio's inverse dynamics of the identified numbers, built without any file.
"""

from __future__ import annotations

import importlib.util
import logging
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio

from identification.arrays import FloatArray
from identification.errors import ExportCheckError
from identification.export.arm import root_link
from identification.export.parameters import ModelParameters
from identification.export.xml_text import INERTIA_SYMBOLS, sdf_pose
from identification.physical_parameters import symmetric
from identification.robots import RobotModel
from identification.robots.simulator_models import InverseDynamics, drake_torque, pinocchio_torque
from identification.robots.urdf_parser import parsed_urdf

TOLERANCE = 1e-9
STATES = 20
_SEED = 87
_WORLD = "world"


class _RefusedError(Exception):
    """A program does not take the file, for a reason that is no difference in torque."""

    def __init__(self, program: str, reason: str) -> None:
        super().__init__(f"{program}: {reason}")
        self.program, self.reason = program, reason


@dataclass(frozen=True, slots=True)
class Agreement:
    """What one program makes of the file. covers: the terms compared. difference_nm: the largest, over all states."""

    program: str
    covers: str
    difference_nm: float

    def sentence(self) -> str:
        """For the operator."""
        return f"{self.program} reads it back: inverse dynamics ({self.covers}) within {self.difference_nm:.1e} Nm."


def check_export(
    path: Path, form: str, robot: RobotModel, parameters: ModelParameters
) -> tuple[tuple[Agreement, ...], tuple[str, ...]]:
    """Read a written file back with every program that is there, at random states (seed fixed).

    Returns what they make of it, and a sentence for each that does not take the file, for its own reasons (Drake is
    strict about names, mimic joints and what else a robot's own URDF may hold). Raises ExportCheckError where a torque
    differs by more than 1e-9 of the largest torque, at least 1e-9 Nm, or MuJoCo refuses its own format.
    """
    readers = {
        "urdf": (_pinocchio_urdf, _drake), "sdf": (_pinocchio_sdf, _drake), "mjcf": (_pinocchio_mjcf, _mujoco),
    }[form]  # fmt: skip
    model = parameters.pinocchio_model(robot)
    generator = np.random.default_rng(_SEED)
    states = [_state(robot, generator) for _ in range(STATES)]
    agreements, complaints = [], []
    for reader in readers:
        try:
            read = reader(path, robot)
        except _RefusedError as refused:
            complaints.append(f"{refused.program} does not take the file, the others do: {refused.reason}")
            continue
        if read is None:
            continue
        program, terms, inverse_dynamics = read
        model.armature = parameters.rotor_inertia if "rotor inertia" in terms else np.zeros(robot.n)
        data = model.createData()
        largest, difference = 0.0, 0.0
        for q, dq, ddq in states:
            expected = pinocchio.rnea(model, data, q, dq, ddq).copy()
            if "viscous friction" in terms:
                expected += parameters.physical.viscous * dq
            if "Coulomb friction" in terms:
                expected += parameters.physical.coulomb * np.sign(dq)
            largest = max(largest, float(np.abs(expected).max()))
            difference = max(difference, float(np.abs(inverse_dynamics(q, dq, ddq) - expected).max()))
        covers = ", ".join(("rigid body", *terms))
        if not difference <= TOLERANCE * max(1.0, largest):
            raise ExportCheckError(
                f"{path}: {program} reads other torques from it, by up to {difference:.2g} Nm ({covers}); "
                "do not use it.",
                file=path,
                program=program,
                difference_nm=difference,
            )
        agreements.append(Agreement(program, covers, difference))
    return tuple(agreements), tuple(complaints)


def _state(robot: RobotModel, generator: np.random.Generator) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A position within ±π (±1 m) and, for dry friction to be fully sliding, a velocity of at least 0.2."""
    span = np.where(robot.kinematics.revolute, np.pi, 1.0)
    ends = np.fmax(robot.position_lower, -span), np.fmin(robot.position_upper, span)
    lower, upper = np.minimum(*ends), np.maximum(*ends)
    dq = generator.uniform(0.2, 1.5, robot.n) * generator.choice([-1.0, 1.0], robot.n)
    return generator.uniform(lower, upper), dq, generator.normal(size=robot.n)


Read = tuple[str, tuple[str, ...], InverseDynamics]
"""The program with its version, what it read beside the rigid body, and its inverse dynamics."""

_ROTOR, _VISCOUS, _COULOMB = "rotor inertia", "viscous friction", "Coulomb friction"


def _pinocchio_urdf(path: Path, robot: RobotModel) -> Read | None:
    return _by_pinocchio(parsed_urdf(path.read_text("utf-8")), robot, ())


def _pinocchio_mjcf(path: Path, robot: RobotModel) -> Read | None:
    return _by_pinocchio(pinocchio.buildModelFromMJCF(str(path)), robot, (_ROTOR,))


def _by_pinocchio(model: pinocchio.Model, robot: RobotModel, terms: tuple[str, ...]) -> Read:
    model.gravity.linear = robot.gravity_in_files
    order = [model.joints[model.getJointId(name)].idx_v for name in robot.joint_names]
    return f"Pinocchio {pinocchio.__version__}", terms, pinocchio_torque(model, order)


def _pinocchio_sdf(path: Path, robot: RobotModel) -> Read | None:
    """Pinocchio's wheel cannot read SDF: the poses and inertias are read here, from the file alone."""
    model_element = ElementTree.parse(path).getroot()[0]
    links = {link.get("name"): link for link in model_element.findall("link")}
    model, index = pinocchio.Model(), {"world": 0}
    for joint in model_element.findall("joint"):
        parent, child = str(joint.findtext("parent")), str(joint.findtext("child"))
        if joint.get("type") == "fixed":
            index[child] = index[parent]
            continue
        axis = np.array(str(joint.findtext("axis/xyz")).split(), dtype=np.float64)
        kind = (
            pinocchio.JointModelPrismaticUnaligned
            if joint.get("type") == "prismatic"
            else pinocchio.JointModelRevoluteUnaligned
        )
        index[child] = model.addJoint(index[parent], kind(axis), sdf_pose(joint), str(joint.get("name")))
        inertial = links[child].find("inertial")
        if inertial is None:
            raise ExportCheckError(f"{path}: link {child} has no inertia.", file=path, program="", difference_nm=np.inf)
        tensor = [float(str(inertial.findtext(f"inertia/{name}"))) for _, _, name in INERTIA_SYMBOLS]
        pose = sdf_pose(inertial)
        body = pinocchio.Inertia(float(str(inertial.findtext("mass"))), np.zeros(3), symmetric(np.array(tensor)))
        model.appendBodyToJoint(index[child], body, pose)
    return _by_pinocchio(model, robot, ())


def _mujoco(path: Path, robot: RobotModel) -> Read | None:
    if importlib.util.find_spec("mujoco") is None:
        return None
    import mujoco

    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise ExportCheckError(
            f"{path}: MuJoCo does not take it: {_first_line(error)}", file=path, program="MuJoCo", difference_nm=np.inf
        ) from error
    data = mujoco.MjData(model)
    joints = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name) for name in robot.joint_names]
    order = model.jnt_dofadr[joints]

    def inverse_dynamics(q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
        data.qpos[order], data.qvel[order], data.qacc[order] = q, dq, ddq
        mujoco.mj_inverse(model, data)
        return np.asarray(data.qfrc_inverse[order])

    return f"MuJoCo {mujoco.__version__}", (_ROTOR, _VISCOUS, _COULOMB), inverse_dynamics


def _drake(path: Path, robot: RobotModel) -> Read | None:
    """Drake's inverse dynamics has rotor inertia and damping; dry friction it does not know."""
    if importlib.util.find_spec("pydrake") is None:
        return None
    from importlib.metadata import version

    try:
        from pydrake.multibody.parsing import Parser
        from pydrake.multibody.plant import MultibodyPlant
    except ImportError as error:  # so under LC_ALL=C where Python does not speak UTF-8
        raise _RefusedError("Drake", f"it cannot be loaded here ({error})") from error

    # It warns of each joint that it leaves dry friction out; our note says so once.
    logging.getLogger("drake").setLevel(logging.ERROR)
    program = f"Drake {version('drake')}"
    plant = MultibodyPlant(0.0)
    try:
        (instance,) = Parser(plant).AddModels(path)
        root = root_link(ElementTree.parse(path).getroot()) if path.suffix == ".urdf" else _WORLD
        # Drake takes a link of this name for the world itself: it is fixed already.
        if root != _WORLD:
            plant.WeldFrames(plant.world_frame(), plant.GetFrameByName(root, instance))
        plant.mutable_gravity_field().set_gravity_vector(robot.gravity_in_files)  # type: ignore[arg-type]
        plant.Finalize()
    except (RuntimeError, ValueError, SystemExit) as error:  # a condition that Drake demands ends as SystemExit
        raise _RefusedError(program, _first_line(error)) from error
    order = [plant.GetJointByName(name).velocity_start() for name in robot.joint_names]

    return program, (_ROTOR, _VISCOUS), drake_torque(plant, order)


def _first_line(error: BaseException) -> str:
    return next(iter(str(error).strip().splitlines()), type(error).__name__)
