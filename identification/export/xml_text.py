"""Numbers and elements of the XML that every exporter writes: no digit lost, no file opened."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable

import numpy as np
import pinocchio

from identification.arrays import FloatArray
from identification.robots.urdf_parser import DRAKE

INERTIA_SYMBOLS = ((0, 0, "ixx"), (0, 1, "ixy"), (0, 2, "ixz"), (1, 1, "iyy"), (1, 2, "iyz"), (2, 2, "izz"))
"""Row, column and name of a tensor's entries, in URDF and SDF alike."""

ElementTree.register_namespace("drake", DRAKE)


def add(parent: ElementTree.Element, tag: str, text: str | None = None, **attributes: str) -> ElementTree.Element:
    """Append an element with attributes and, where given, a text."""
    element = ElementTree.SubElement(parent, tag, attributes)
    element.text = text
    return element


def number(value: float) -> str:
    """The shortest text that reads back as the same double; minus zero is written as zero."""
    return repr(float(value) + 0.0)


def numbers(values: Iterable[float] | FloatArray) -> str:
    """Several numbers, separated by blanks."""
    return " ".join(number(value) for value in values)


def place(xyz: str | None, rpy: str | None) -> pinocchio.SE3:
    """The pose that URDF's xyz (m) and rpy (rad, Rz Ry Rx) texts state; zeros where absent."""
    translation, angles = (np.array([float(v) for v in (text or "0 0 0").split()]) for text in (xyz, rpy))
    return pinocchio.SE3(pinocchio.rpy.rpyToMatrix(*angles), translation)


def sdf_pose(element: ElementTree.Element) -> pinocchio.SE3:
    """The pose that an element's <pose> of SDF states, its rotation as angles or as a quaternion x y z w; the identity
    where absent.
    """
    stated = element.find("pose")
    if stated is None:
        return pinocchio.SE3.Identity()
    values = np.array([float(word) for word in (stated.text or "0 0 0 0 0 0").split()])
    if stated.get("rotation_format") == "quat_xyzw":
        turn = pinocchio.Quaternion(values[3:]).normalized().toRotationMatrix()
    else:
        in_degrees = stated.get("degrees") in ("true", "1")
        turn = pinocchio.rpy.rpyToMatrix(np.deg2rad(values[3:]) if in_degrees else values[3:])
    return pinocchio.SE3(turn, values[:3])


def roll_pitch_yaw(rotation: FloatArray) -> FloatArray:
    """(3,) angles of Rz(yaw) Ry(pitch) Rx(roll), rad, of a rotation matrix."""
    return np.asarray(pinocchio.rpy.matrixToRpy(rotation), dtype=np.float64)


def quaternion(rotation: FloatArray) -> FloatArray:
    """(4,) quaternion w, x, y, z of a rotation matrix, as MuJoCo orders it."""
    x, y, z, w = pinocchio.Quaternion(rotation).coeffs()
    return np.array([w, x, y, z])


def document(root: ElementTree.Element, notes: Iterable[str] = ()) -> str:
    """The file's text, with the notes as comments at the top of the root element."""
    for line in reversed(list(notes)):
        # Two hyphens would end a comment.
        root.insert(0, ElementTree.Comment(f" {line.replace('--', '- -')} "))
    ElementTree.indent(root)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"
