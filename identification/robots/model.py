"""The value object that stands for one robot's kinematics, and the Pinocchio model built from it.

Here: joints, placements, limits, gravity. Not here: reading files (`modified_denavit_hartenberg`, `urdf`) and inertial
parameters, which are what the package identifies.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pinocchio

from identification.arrays import BoolArray, FloatArray, IntArray
from identification.errors import RobotError
from identification.robots.flange import Flange
from identification.robots.installation import ON_THE_FLOOR, Installation

BUILT_IN = "built-in "
"""Before the name of a robot of this program, where its source is a file for others."""
TABLE_IN_FILES = np.array([-1.0, -1.0, 1.0])
"""Diagonal of the rotation from the base of a built-in arm's table to `base_link` of the files."""
_RIGHT_ANGLE_TOLERANCE = 1e-5


@dataclass(frozen=True, slots=True, eq=False)
class Kinematics:
    """Joint tree of a fixed-base robot, in the order of the joints; the frame of link i is the frame of joint i.

    parent: (n,) index of the link that carries joint i, −1 for the base; always smaller than i.
    rotation: (n, 3, 3) and translation: (n, 3) m, pose of the joint frame at q = 0 in the parent's link frame
    (columns of the rotation are the joint frame's axes). axis: (n, 3) unit vector in the joint frame.
    revolute: (n,) True for a revolute joint, False for a prismatic one.
    """

    parent: IntArray
    rotation: FloatArray
    translation: FloatArray
    axis: FloatArray
    revolute: BoolArray

    def __post_init__(self) -> None:
        n = len(self.parent)
        if n == 0:
            raise RobotError("The robot has no movable joint.", field="joint")
        for joint, parent in enumerate(self.parent):
            if not -1 <= parent < joint:
                raise RobotError(
                    f"Joint {joint + 1} hangs on link {parent + 1}; joints must be listed from the base outwards.",
                    field="parent",
                    joint=joint + 1,
                )
        for name in ("rotation", "translation", "axis"):
            if not np.all(np.isfinite(getattr(self, name))):
                raise RobotError(f"The robot's {name} holds a number that is not finite.", field=name)
        for values in (self.parent, self.rotation, self.translation, self.axis, self.revolute):
            values.setflags(write=False)

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.parent)

    def upstream(self, link: int) -> tuple[int, ...]:
        """Joints (counted from 0) whose motion moves `link`, from the base outwards, `link` itself last."""
        chain = []
        joint = link
        while joint >= 0:
            chain.append(joint)
            joint = int(self.parent[joint])
        return tuple(reversed(chain))


@dataclass(frozen=True, slots=True)
class Mimic:
    """A joint of a URDF without a motor of its own: it stands at multiplier · (leader's position) + offset, rad (m)."""

    joint: str
    leader: str
    multiplier: float
    offset: float


@dataclass(frozen=True, slots=True, eq=False)
class RobotModel:
    """One fixed-base robot with n revolute or prismatic joints, one position number per joint.

    position_lower, position_upper: rad (m for a prismatic joint); velocity: rad/s (m/s); effort: Nm (N); each (n,),
    nan where unknown. gravity: (3,) m/s² in the base frame. modified_denavit_hartenberg: (n, 4) columns alpha rad, d m,
    theta rad, rl m, the joint variable's own entry being its offset; None for a robot read from a URDF.
    source: what it was read from. digest: SHA-256 of that source. locked_joints: those held still, by name with their
    position; they are no joints of this robot any more. mimics: joints that follow one with a motor.
    flange: where load data are given from, None where nobody says.
    pinocchio_model has nq = nv = n; its joint k + 1 is joint k here, continuous URDF joints are plain revolute ones.
    """

    name: str
    joint_names: tuple[str, ...]
    kinematics: Kinematics
    pinocchio_model: pinocchio.Model = field(repr=False)
    modified_denavit_hartenberg: FloatArray | None
    position_lower: FloatArray
    position_upper: FloatArray
    velocity: FloatArray
    effort: FloatArray
    gravity: FloatArray
    source: str
    digest: str
    locked_joints: tuple[tuple[str, float], ...] = ()
    mimics: tuple[Mimic, ...] = ()
    flange: Flange | None = None

    @property
    def driven(self) -> tuple[int, ...]:
        """Joints (from 0) with a motor of their own: what is recorded of a robot."""
        following = {item.joint for item in self.mimics}
        return tuple(joint for joint, name in enumerate(self.joint_names) if name not in following)

    @property
    def driven_names(self) -> tuple[str, ...]:
        """Their names."""
        return tuple(self.joint_names[joint] for joint in self.driven)

    @property
    def followers(self) -> tuple[tuple[int, int, float, float], ...]:
        """(follower, leader, multiplier, offset) of each joint without a motor of its own, joints from 0."""
        place = {name: joint for joint, name in enumerate(self.joint_names)}
        return tuple((place[item.joint], place[item.leader], item.multiplier, item.offset) for item in self.mimics)

    @property
    def spec(self) -> str:
        """What `load_robot` takes for it: the name of a built-in robot, or a file."""
        return self.source.removeprefix(BUILT_IN)

    @property
    def installation(self) -> Installation:
        """How it stands and what of it is held, as `load_robot` takes it."""
        x, y, z = (float(value) for value in self.gravity)
        return Installation((x, y, z), self.locked_joints)

    @property
    def gravity_in_files(self) -> FloatArray:
        """(3,) m/s² in the base frame of the arm's URDF, SDF and MJCF files, its own or other people's.

        A built-in arm's is `base_link`, turned by π about z against the base of the paper's table.
        """
        turn = TABLE_IN_FILES if self.source.startswith(BUILT_IN) else np.ones(3)
        return np.asarray(turn * self.gravity, dtype=np.float64)

    @property
    def torque_unit(self) -> str:
        """What a column of torques of all joints is in: "Nm", "N", or both."""
        kinds = set(self.units)
        return kinds.pop() if len(kinds) == 1 else "Nm (N of prismatic joints)"

    def to_json(self) -> dict[str, Any]:
        """Which robot it is, for model.json: `robot`, and `installation` where it is not free on a floor."""
        stand = self.installation
        return {"robot": self.spec, **({} if stand == ON_THE_FLOOR else {"installation": stand.to_json()})}

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each joint's torque: Nm, or N for a prismatic joint."""
        return tuple("Nm" if revolute else "N" for revolute in self.kinematics.revolute)

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.kinematics.n


def refuse_followers(robot: RobotModel, what: str) -> None:
    """Raises RobotError, naming a joint that follows one that moves; what: the verb that this program has no way of."""
    if robot.mimics:
        first = robot.mimics[0]
        raise RobotError.at(
            robot.source,
            f"joint '{first.joint}' follows '{first.leader}', which moves; `fit` and `validate` follow "
            f"it, but this program cannot {what} such an arm. If '{first.leader}' stood still, say where: "
            f"--lock {first.leader}=0.",
            field=first.joint,
        )


def build_pinocchio_model(
    name: str,
    kinematics: Kinematics,
    joint_names: tuple[str, ...],
    gravity: FloatArray,
    inertias: tuple[pinocchio.Inertia, ...] | None = None,
) -> pinocchio.Model:
    """Pinocchio model with one configuration number per joint; zero inertias unless given (one per link)."""
    model = pinocchio.Model()
    model.name = name
    model.gravity.linear = gravity
    for joint in range(kinematics.n):
        placement = pinocchio.SE3(kinematics.rotation[joint], kinematics.translation[joint])
        index = model.addJoint(
            int(kinematics.parent[joint]) + 1,
            _pinocchio_joint(kinematics.axis[joint], bool(kinematics.revolute[joint])),
            placement,
            joint_names[joint],
        )
        model.addJointFrame(index)
        if inertias is not None:
            model.appendBodyToJoint(index, inertias[joint], pinocchio.SE3.Identity())
    return model


def _pinocchio_joint(axis: FloatArray, revolute: bool) -> object:
    aligned = {
        (1.0, 0.0, 0.0): (pinocchio.JointModelRX, pinocchio.JointModelPX),
        (0.0, 1.0, 0.0): (pinocchio.JointModelRY, pinocchio.JointModelPY),
        (0.0, 0.0, 1.0): (pinocchio.JointModelRZ, pinocchio.JointModelPZ),
    }.get((float(axis[0]), float(axis[1]), float(axis[2])))
    if aligned is not None:
        return aligned[0]() if revolute else aligned[1]()
    return pinocchio.JointModelRevoluteUnaligned(axis) if revolute else pinocchio.JointModelPrismaticUnaligned(axis)


def snap_to_right_angles(rotation: FloatArray) -> FloatArray:
    """The rotation matrix (3, 3) with entries below 1e-5 made exactly zero, orthonormal again.

    URDF files print π/2 as 1.5708 or 1.570796327. The 1e-6 … 1e-10 that this leaves in a matrix is no kinematics, but
    it turns parameters without any effect into columns of noise, which the grouping would take for real ones.
    """
    snapped = np.where(np.abs(rotation) < _RIGHT_ANGLE_TOLERANCE, 0.0, rotation)
    left, _, right = np.linalg.svd(snapped)
    orthonormal = np.asarray(left @ right, dtype=np.float64)
    orthonormal[snapped == 0.0] = 0.0
    near_unit = np.abs(np.abs(orthonormal) - 1.0) < 1e-12
    orthonormal[near_unit] = np.sign(orthonormal[near_unit])
    # Zeroing may not be consistent with a rotation (three tiny entries in general position): then keep the input.
    if np.linalg.norm(orthonormal @ orthonormal.T - np.eye(3)) > 1e-12:
        return np.array(rotation, dtype=np.float64)
    return orthonormal
