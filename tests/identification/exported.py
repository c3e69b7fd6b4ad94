"""Models to export and simulate, for the tests: the paper's arm made consistent, random serial arms. No test here."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from identification.base_parameters import BaseRegressor
from identification.model_file import Model, read_model, write_model
from identification.physical_parameters import PhysicalParameters
from identification.robots import Installation, load_robot


def consistent(physical: PhysicalParameters) -> PhysicalParameters:
    """Table 3 with 6e-4 kg m² more on every axis: its links 4 and 7 violate the triangle inequality by up to 2.9e-4."""
    return PhysicalParameters(
        physical.mass, physical.center_of_mass, physical.inertia + 6e-4 * np.eye(3), physical.viscous, physical.coulomb
    )


def model_of(
    folder: Path,
    robot: str,
    physical: PhysicalParameters,
    *,
    rotor: Any = None,
    offset: Any = None,
    installation: Installation | None = None,
    **more: Any,
) -> Model:
    """A model.json of a robot with these parameters, written to a folder and read back. more: further fields."""
    zeros = np.zeros(physical.n)
    rotor, offset = (zeros if values is None else np.asarray(values, float) for values in (rotor, offset))
    joints = range(physical.n)
    base = BaseRegressor(load_robot(robot, installation))
    data = {
        "format": "iiwa-ident/model/1",
        "robot": robot,
        "installation": None if installation is None else installation.to_json(),
        "base_parameters": [
            {"name": name, "value": float(value), "std": 1e-4 * max(abs(float(value)), 1e-2), "unit": unit}
            for name, value, unit in zip(base.names, base.base_from_physical(physical), base.units, strict=True)
        ],
        "physical_parameters": [
            {
                "link": i + 1,
                "mass": float(physical.mass[i]),
                "com": physical.center_of_mass[i].tolist(),
                "inertia": physical.inertia[i].tolist(),
            }
            for i in joints
        ],
        "friction": [
            {"joint": i + 1, "viscous": float(physical.viscous[i]), "coulomb": float(physical.coulomb[i])}
            for i in joints
        ],
        "drives": [{"joint": i + 1, "rotor_inertia": float(rotor[i]), "offset": float(offset[i])} for i in joints],
        "effects": [],
        **more,
    }
    return read_model(write_model(data, folder / "model.json"))


def random_bodies(joints: int, seed: int) -> PhysicalParameters:
    """Parameters of bodies that exist: four point masses each, about the joint's frame."""
    generator = np.random.default_rng(seed)
    points = generator.normal(scale=0.15, size=(joints, 4, 3))
    weights = generator.uniform(0.3, 2.0, (joints, 4))
    mass = weights.sum(axis=1)
    center = np.einsum("ik,ikd->id", weights, points) / mass[:, None]
    arms = points - center[:, None]
    square = np.einsum("ik,ikd,ike->ide", weights, arms, arms)
    inertia = np.trace(square, axis1=1, axis2=2)[:, None, None] * np.eye(3) - square
    inertia = 0.5 * (inertia + inertia.transpose(0, 2, 1))
    return PhysicalParameters(
        mass, center, inertia, generator.uniform(0.0, 0.5, joints), generator.uniform(0.0, 0.5, joints)
    )


def random_arm(joints: int, seed: int) -> str:
    """URDF of a serial arm: random placements and axes, joints of all three kinds, a fixed flange and a heavy tool."""
    generator = np.random.default_rng(seed)
    kinds = generator.choice(["revolute", "prismatic", "continuous"], joints)
    text = ['<robot name="random_arm">', '<link name="base"/>']
    for joint, kind in enumerate(kinds):
        parent = "base" if joint == 0 else f"part_{joint}"
        xyz, rpy, axis = generator.normal(scale=0.3, size=3), generator.uniform(-3.0, 3.0, 3), generator.normal(size=3)
        limit = 'lower="-0.8" upper="0.9" ' if kind != "continuous" else ""
        text.append(
            f'<link name="part_{joint + 1}"/>'
            f'<joint name="axis_{joint + 1}" type="{kind}"><parent link="{parent}"/><child link="part_{joint + 1}"/>'
            f'<origin xyz="{_words(xyz)}" rpy="{_words(rpy)}"/><axis xyz="{_words(axis / np.linalg.norm(axis))}"/>'
            f'<limit {limit}effort="50" velocity="2"/></joint>'
        )
    text.append(
        '<link name="tool"><inertial><mass value="9"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
        '</inertial><visual><geometry><box size="0.1 0.2 0.3"/></geometry></visual></link>'
        '<joint name="weld" type="fixed">'
        f'<parent link="part_{joints}"/><child link="tool"/><origin xyz="0.1 0 0.2" rpy="0.4 0.2 0.1"/></joint></robot>'
    )
    return "\n".join(text)


def _words(values: np.ndarray) -> str:
    return " ".join(repr(float(value)) for value in values)
