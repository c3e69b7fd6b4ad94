"""One simulator file changed in place: bodies, friction and gravity of its own format, everything else as it was.

URDF and SDF are edited as text trees, MJCF by MuJoCo's own editor, which also resolves its defaults and includes. What
is added to a body is a pseudo-inertia (4, 4) in the frame of the file's link, [[Σ, h], [hᵀ, m]] with Σ = ½ tr(I) − I
about the link's origin. Not here: what is changed (`amend`).
"""

from __future__ import annotations

import os
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio

from identification.arrays import FloatArray
from identification.errors import ModelFileError
from identification.export.arm import link_at, origin, root_link
from identification.export.sdf import sdf_inertial
from identification.export.urdf import urdf_inertial
from identification.export.xml_text import INERTIA_SYMBOLS, add, number, numbers, roll_pitch_yaw, sdf_pose
from identification.physical_parameters import pseudo_inertia, symmetric
from identification.whole_file import write_whole


@dataclass(frozen=True, slots=True, eq=False)
class Changes:
    """bodies: joint's name → (4, 4) pseudo-inertia that its link gains, in the file's frame. viscous, coulomb,
    armature: joint's name → what is added. turn: (3, 3) of the base in the world, None where it stands as stated.
    gravity: (3,) m/s² in the frame of the file's base, None with it.
    """

    bodies: Mapping[str, FloatArray]
    viscous: Mapping[str, float]
    coulomb: Mapping[str, float]
    armature: Mapping[str, float]
    turn: FloatArray | None
    gravity: FloatArray | None = None


def moment_matrix(mass: float, moment: FloatArray, inertia: FloatArray) -> FloatArray:
    """(4, 4) pseudo-inertia of mass kg, first moment (3,) kg m and inertia (3, 3) kg m² about one origin."""
    return np.asarray(pseudo_inertia(np.array([[mass, *moment, *inertia[np.triu_indices(3)]]]))[0])


def _central(matrix: FloatArray, link: str, file: Path) -> tuple[float, FloatArray, FloatArray]:
    """Mass, centre and inertia about it of a pseudo-inertia. Raises ModelFileError where no body has them."""
    mass = float(matrix[3, 3])
    if not mass > 0.0:
        raise ModelFileError.at(file, f"link '{link}' would be left with {mass:.3g} kg; nothing was written.")
    center = matrix[:3, 3] / mass
    about = matrix[:3, :3] - mass * np.outer(center, center)
    least = float(np.linalg.eigvalsh(about)[0])
    if least < 0.0:
        # The masses' spread about the centre cannot be negative: the nearest that can be is taken.
        values, vectors = np.linalg.eigh(about)
        about = (vectors * np.maximum(values, 1e-9 * mass)) @ vectors.T
    return mass, center, np.trace(about) * np.eye(3) - about


def _pseudo(mass: float, center: FloatArray, axes: FloatArray, inertia: FloatArray) -> FloatArray:
    """Pseudo-inertia of a body whose inertia about its centre is stated along the columns of `axes`."""
    about = axes @ inertia @ axes.T
    return moment_matrix(mass, mass * center, about + mass * (center @ center * np.eye(3) - np.outer(center, center)))


def _tensor(entries: Mapping[str, float]) -> FloatArray:
    return symmetric(np.array([entries.get(symbol, 0.0) for _, _, symbol in INERTIA_SYMBOLS]))


def _tree(source: Path) -> ElementTree.ElementTree[ElementTree.Element]:
    return ElementTree.parse(source, ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True)))


def _add_body(
    link: ElementTree.Element,
    added: FloatArray,
    file: Path,
    stated: Callable[[ElementTree.Element], FloatArray],
    write: Callable[[float, FloatArray, FloatArray], ElementTree.Element],
) -> None:
    """Replace a link's <inertial> by that of it and what is added. stated, write: of the format."""
    inertial, whole = link.find("inertial"), added
    if inertial is not None:
        whole = added + stated(inertial)
        link.remove(inertial)
    link.insert(0, write(*_central(whole, link.get("name", ""), file)))


def _child(parent: ElementTree.Element, tag: str) -> ElementTree.Element:
    """The element under another, which is made where there is none."""
    found = parent.find(tag)
    return add(parent, tag) if found is None else found


def _named(root: ElementTree.Element, tag: str, name: str, file: Path) -> ElementTree.Element:
    found = next((item for item in root.iter(tag) if item.get("name") == name), None)
    if found is None:
        raise ModelFileError.at(file, f"has no {tag} '{name}'; nothing was written.")
    return found


def _from(target: Path, source: Path, name: str) -> str:
    """A file's or folder's name that counts from the folder of `source` ("": that folder), from that of `target`."""
    folders = source.resolve().parent, target.resolve().parent
    if "://" in name or os.path.isabs(name) or folders[0] == folders[1]:
        return name
    return os.path.relpath(folders[0] / name, folders[1])


def write_urdf_changes(source: Path, target: Path, changes: Changes) -> None:
    """A URDF with the changes. A turned base hangs on a link `world`, as simulators expect it."""
    tree = _tree(source)
    root = tree.getroot()
    for joint, added in changes.bodies.items():
        link = _named(root, "link", link_at(_named(root, "joint", joint, source), "child"), source)
        _add_body(link, added, source, _urdf_body, urdf_inertial)
    for key, table in (("damping", changes.viscous), ("friction", changes.coulomb)):
        for joint, more in table.items():
            dynamics = _child(_named(root, "joint", joint, source), "dynamics")
            dynamics.set(key, number(max(0.0, float(dynamics.get(key, 0.0)) + more)))
    if changes.turn is not None:
        _turn_urdf(root, changes.turn)
    for mesh in root.iter("mesh"):
        mesh.set("filename", _from(target, source, mesh.get("filename", "")))
    tree.write(target, encoding="utf-8", xml_declaration=True)


def _urdf_body(inertial: ElementTree.Element) -> FloatArray:
    pose, mass, entries = origin(inertial), inertial.find("mass"), inertial.find("inertia")
    tensor = _tensor({} if entries is None else {key: float(value) for key, value in entries.items()})
    mass_kg = 0.0 if mass is None else float(mass.get("value", 0.0))
    return _pseudo(mass_kg, pose.translation, pose.rotation, tensor)


def _turn_urdf(root: ElementTree.Element, turn: FloatArray) -> None:
    base = root_link(root)
    if base == "world":
        for joint in root.findall("joint"):
            if link_at(joint, "parent") == "world":
                pose = pinocchio.SE3(turn, np.zeros(3)) * origin(joint)
                stated = _child(joint, "origin")
                stated.set("xyz", numbers(pose.translation))
                stated.set("rpy", numbers(roll_pitch_yaw(pose.rotation)))
        return
    add(root, "link", name="world")
    joint = add(root, "joint", name="world_to_base", type="fixed")
    add(joint, "parent", link="world")
    add(joint, "child", link=base)
    add(joint, "origin", xyz="0 0 0", rpy=numbers(roll_pitch_yaw(turn)))


def write_sdf_changes(source: Path, target: Path, changes: Changes) -> None:
    """An SDF with the changes; a turned base is the pose of its model."""
    tree = _tree(source)
    root = tree.getroot()
    for joint, added in changes.bodies.items():
        link = _named(root, "link", _named(root, "joint", joint, source).findtext("child", "").strip(), source)
        _add_body(link, added, source, _sdf_body, sdf_inertial)
    for key, table in (("damping", changes.viscous), ("friction", changes.coulomb)):
        for joint, more in table.items():
            axis = _named(root, "joint", joint, source).find("axis")
            if axis is None:
                raise ModelFileError.at(source, f"joint '{joint}' has no axis; nothing was written.")
            element = _child(_child(axis, "dynamics"), key)
            element.text = number(max(0.0, float(element.text or 0.0) + more))
    if changes.turn is not None:
        model = next(root.iter("model"))
        pose = pinocchio.SE3(changes.turn, np.zeros(3)) * sdf_pose(model)
        for stated in model.findall("pose"):
            model.remove(stated)
        element = ElementTree.Element("pose")
        element.text = numbers([*pose.translation, *roll_pitch_yaw(pose.rotation)])
        model.insert(0, element)
    for uri in root.iterfind(".//mesh/uri"):
        uri.text = _from(target, source, (uri.text or "").strip())
    tree.write(target, encoding="utf-8", xml_declaration=True)


def _sdf_body(inertial: ElementTree.Element) -> FloatArray:
    pose, entries = sdf_pose(inertial), inertial.find("inertia")
    tensor = _tensor({} if entries is None else {item.tag: float(item.text or 0.0) for item in entries})
    return _pseudo(float(inertial.findtext("mass", "0")), pose.translation, pose.rotation, tensor)


def write_mjcf_changes(source: Path, target: Path, changes: Changes) -> None:
    """An MJCF with the changes; a turned base is another direction of gravity in its world."""
    import mujoco

    spec: Any = mujoco.MjSpec.from_file(str(source))
    compiled = spec.compile()
    for joint, added in changes.bodies.items():
        body = spec.joint(joint).parent
        own = compiled.body(body.id)  # a body of MJCF need not have a name
        axes = np.zeros(9)
        mujoco.mju_quat2Mat(axes, own.iquat)
        whole = added + _pseudo(float(own.mass[0]), own.ipos, axes.reshape(3, 3), np.diag(own.inertia))
        mass_kg, center, tensor = _central(whole, body.name or f"moved by {joint}", source)
        moments, vectors = np.linalg.eigh(tensor)
        vectors[:, 2] *= np.sign(np.linalg.det(vectors))
        turn = np.zeros(4)
        mujoco.mju_mat2Quat(turn, vectors.ravel())
        body.explicitinertial = True
        body.mass, body.ipos, body.iquat, body.inertia = mass_kg, center, turn, moments
        body.fullinertia = [np.nan, 0.0, 0.0, 0.0, 0.0, 0.0]
    for key, table in (
        ("damping", changes.viscous), ("frictionloss", changes.coulomb), ("armature", changes.armature)
    ):  # fmt: skip
        for name, more in table.items():
            joint_spec = spec.joint(name)
            stated = float(getattr(compiled, f"dof_{key}")[compiled.joint(name).dofadr[0]])
            new = max(0.0, stated + more)
            setattr(joint_spec, key, [new, 0.0, 0.0] if np.ndim(getattr(joint_spec, key)) else new)
    if changes.gravity is not None:
        # What the file says of gravity was not read, since the recording's is stated by whoever asks.
        spec.option.gravity = changes.gravity
    spec.compile()
    for kind, files in (("meshdir", [*spec.meshes, *spec.hfields]), ("texturedir", spec.textures)):
        if files:
            setattr(spec.compiler, kind, _from(target, source, getattr(spec.compiler, kind)))
    spec.modelfiledir = str(target.resolve().parent)
    write_whole(target, spec.to_xml())
