"""A URDF tree seen as the bodies that move: what is fixed to what, which shapes and named frames each body carries.

Here: merging of links joined by fixed joints, as identification sees them (one set of parameters per movable joint).
Not here: writing.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass, replace

import numpy as np
import pinocchio

from identification.export.xml_text import place
from identification.robots import RobotModel


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """kind: "visual" or "collision"; placement: its pose in the body's frame; geometry: URDF's element (box, …)."""

    kind: str
    placement: pinocchio.SE3
    geometry: ElementTree.Element


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """name: of the link at the joint. shapes: of it and all links fixed to it. frames: those links by name, posed."""

    name: str
    shapes: tuple[Shape, ...]
    frames: tuple[tuple[str, pinocchio.SE3], ...]


@dataclass(frozen=True, slots=True, eq=False)
class Arm:
    """base: what does not move. links: (n,) the bodies, in the order of the robot's joints, with URDF's joint types."""

    name: str
    base: Body
    links: tuple[Body, ...]
    joint_types: tuple[str, ...]


def attachments(urdf: ElementTree.Element, robot: RobotModel) -> dict[str, tuple[int, pinocchio.SE3]]:
    """For each link: the body it belongs to (index of the joint that moves it, −1 the base) and its pose in that."""
    joints = {child.get("link", ""): joint for joint in urdf.findall("joint") for child in joint.findall("child")}
    found: dict[str, tuple[int, pinocchio.SE3]] = {}

    def attach(link: str) -> tuple[int, pinocchio.SE3]:
        if link not in found:
            joint = joints.get(link)
            if joint is None:
                found[link] = (-1, pinocchio.SE3.Identity())
            elif joint.get("name") in robot.joint_names:
                found[link] = (robot.joint_names.index(joint.get("name", "")), pinocchio.SE3.Identity())
            else:
                body, pose = attach(link_at(joint, "parent"))
                found[link] = (body, pose * origin(joint))
        return found[link]

    for link in urdf.findall("link"):
        attach(link.get("name", ""))
    return found


def origin(element: ElementTree.Element) -> pinocchio.SE3:
    """The pose in an element's <origin>, identity where it has none."""
    stated = element.find("origin")
    return pinocchio.SE3.Identity() if stated is None else place(stated.get("xyz"), stated.get("rpy"))


def root_link(urdf: ElementTree.Element) -> str:
    """The link that no joint moves; the first in the file need not be it."""
    moved = {link_at(joint, "child") for joint in urdf.findall("joint")}
    return next(link.get("name", "") for link in urdf.findall("link") if link.get("name") not in moved)


def arm_of(urdf: ElementTree.Element, robot: RobotModel) -> Arm:
    """The bodies of a robot's URDF tree."""
    attached = attachments(urdf, robot)
    joints = {joint.get("name"): joint for joint in urdf.findall("joint")}
    own = {link_at(joints[name], "child"): index for index, name in enumerate(robot.joint_names)}
    names = {-1: root_link(urdf), **{index: link for link, index in own.items()}}
    shapes: dict[int, list[Shape]] = {body: [] for body in names}
    frames: dict[int, list[tuple[str, pinocchio.SE3]]] = {body: [] for body in names}
    for link in urdf.findall("link"):
        body, pose = attached[link.get("name", "")]
        if link.get("name") != names[body]:
            frames[body].append((link.get("name", ""), pose))
        for kind in ("visual", "collision"):
            for shape in link.findall(kind):
                geometry = shape.find("geometry")
                if geometry is not None and len(geometry):
                    shapes[body].append(Shape(kind, pose * origin(shape), geometry[0]))
    bodies = {body: Body(name, tuple(shapes[body]), tuple(frames[body])) for body, name in names.items()}
    return Arm(
        name=urdf.get("name") or robot.name,
        base=bodies[-1],
        links=tuple(bodies[index] for index in range(robot.n)),
        joint_types=tuple(joints[name].get("type", "revolute") for name in robot.joint_names),
    )


def with_distinct_names(arm: Arm, joint_names: tuple[str, ...]) -> tuple[Arm, tuple[tuple[str, str], ...]]:
    """The arm with links and frames renamed where a joint or another of them has their name; old and new names."""
    taken, renamed = set(joint_names), []

    def distinct(name: str) -> str:
        new = name
        while new in taken:
            new += "_link"
        taken.add(new)
        if new != name:
            renamed.append((name, new))
        return new

    bodies = [
        replace(body, name=distinct(body.name), frames=tuple((distinct(name), pose) for name, pose in body.frames))
        for body in (arm.base, *arm.links)
    ]
    return replace(arm, base=bodies[0], links=tuple(bodies[1:])), tuple(renamed)


def joint_placement(robot: RobotModel, urdf: ElementTree.Element, joint: int) -> pinocchio.SE3:
    """Pose of a joint's frame in its parent body at zero, as the file must state it.

    The robot's kinematics has right angles to full precision where the file says 1.5708. The built-in arms measure from
    the shoulder, their file from the floor: there the file counts.
    """
    element = next(item for item in urdf.findall("joint") if item.get("name") == robot.joint_names[joint])
    _, parent = attachments(urdf, robot)[link_at(element, "parent")]
    stated = parent * origin(element)
    exact = pinocchio.SE3(robot.kinematics.rotation[joint], robot.kinematics.translation[joint])
    return exact if np.abs(stated.homogeneous - exact.homogeneous).max() < 1e-4 else stated


def link_at(joint: ElementTree.Element, end: str) -> str:
    """Name of the link at one end of a joint, "parent" or "child"; '' where the joint states none."""
    element = joint.find(end)
    return "" if element is None else element.get("link", "")
