"""The door of `export`: a model into a file for a simulator, checked by reading it back.

Here: which skeleton, which numbers, the notes, the file beside it for effects. Not here: the formats' own rules
(`urdf`, `sdf`, `mjcf`) and the comparison (`check`).
"""

from __future__ import annotations

import json
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from identification.arrays import FloatArray
from identification.base_parameters import told_widths
from identification.errors import ModelFileError
from identification.export.arm import arm_of, with_distinct_names
from identification.export.check import Agreement, check_export
from identification.export.effects import effects_note, with_found_rotors
from identification.export.given_bodies import given_bodies
from identification.export.held_joints import fix_held_joints
from identification.export.kinematic_urdf import arm_without_inertias
from identification.export.mjcf import write_mjcf
from identification.export.parameters import ModelParameters, Origins, parameters_of, refuse_inconsistent
from identification.export.sdf import write_sdf
from identification.export.urdf import move_meshes, write_urdf
from identification.export.xml_text import document
from identification.model_file import Model
from identification.robots import RobotModel
from identification.robots.installation import STANDARD_GRAVITY
from identification.robots.model import refuse_followers
from identification.whole_file import write_whole

FORMATS = ("urdf", "sdf", "mjcf")

_ADVICE = " Export the consistent set, the default: its bodies exist."

_FRICTION_NOTES = {
    "urdf": (
        "<dynamics> holds viscous (damping) and Coulomb friction (friction). MuJoCo uses both. Drake uses damping and "
        "ignores friction. Pinocchio stores both; its dynamics algorithms use neither.",
    ),
    "sdf": (
        "<dynamics> holds viscous (damping) and Coulomb friction (friction). Gazebo hands both to its physics engine; "
        "Drake uses damping and ignores friction.",
        "Gazebo's world has 9.8 m/s² unless told otherwise: set <gravity>{gravity}</gravity> in yours.",
    ),
    "mjcf": (
        "damping and frictionloss hold viscous and Coulomb friction, the latter as hard as steps of 1 ms allow. MuJoCo "
        "knows no velocity limits, and meshes stay behind.",
    ),
}
_ROTOR_NOTES = {
    "urdf": "Rotor inertia stands in drake:rotor_inertia (Drake). Elsewhere URDF has no place for it: set armature "
    "(Pinocchio, MuJoCo) to {values} kg m² yourself.",
    "sdf": "Rotor inertia stands in drake:rotor_inertia (Drake); Gazebo has no place for it ({values} kg m²).",
    "mjcf": "Rotor inertia stands in armature.",
}
_STAND_NOTE = (
    "The arm stands turned, which the file does not say: in the frame of its base gravity is {gravity} m/s². Set that "
    "in the simulator, or turn the base."
)
_NO_ROTOR_NOTE = (
    "No rotor inertia: the torque was measured behind the gear, where it cannot be seen. Stiff controllers need one to "
    "be stable in simulation."
)


@dataclass(frozen=True, slots=True)
class ExportResult:
    """path: the file written. agreements: what other programs read from it. notes: what the format cannot say.

    effects_path: the file with torque that no simulator model holds, None if there is none. origins: what each
    parameter rests on, None where no prior was used.
    """

    path: Path
    agreements: tuple[Agreement, ...]
    notes: tuple[str, ...]
    effects_path: Path | None
    origins: Origins | None


def export_model(
    model: Model,
    path: str | Path,
    form: str,
    *,
    parameter_set: str = "consistent",
    prior: str | Path | None = None,
    motor_inertia: FloatArray | None = None,
) -> ExportResult:
    """Write a model as "urdf", "sdf" or "mjcf" and read it back with every simulator that is installed.

    parameter_set: "consistent" or "physical". prior: a URDF whose bodies the open directions of the consistent set go
    to, uniform bodies where none is given. motor_inertia: (n,) kg m² added to each joint's rotor inertia, for
    simulators with stiff controllers; torques are then those of the motors, not those behind the gears. Raises
    InconsistentParametersError (65) for links that no body can have, ModelFileError, RobotError, ExportCheckError.
    """
    if form not in FORMATS:
        raise ModelFileError(f"There is no format '{form}'; known are {', '.join(FORMATS)}.")
    path, robot = Path(path), model.load_robot()
    refuse_followers(robot, "export")
    if prior is not None and parameter_set != "consistent":
        raise ModelFileError("A prior belongs to the consistent parameter set; the physical one has none.")
    parameters = parameters_of(model, parameter_set, None if prior is None else given_bodies(prior, robot))
    parameters = with_found_rotors(parameters, model)
    refuse_inconsistent(parameters.physical, file=model.path, advice=_ADVICE if parameter_set == "physical" else "")
    notes = _notes(form, parameters, robot)
    if motor_inertia is not None and motor_inertia.any():
        parameters = replace(parameters, rotor_inertia=parameters.rotor_inertia + motor_inertia)
        notes = (
            *_notes(form, parameters, robot),
            "Part of the rotor inertia is a data-sheet prior, not identified: joint torques are those of the motors.",
        )
    effects = effects_note(model, parameters.offset, parameters.physical.coulomb, robot.units)
    notes = (*notes, *effects.sentences)
    width = model.options.coulomb_velocity
    if model.options.turns_gently:
        notes = (
            *notes,
            f"Coulomb friction was identified as F_s tanh(q̇/v) with v = "
            f"{told_widths(width, robot)}; the format has no place for v, which stands in the file beside this one.",
        )
    skeleton = _skeleton(robot, path)
    if form == "urdf":
        root = write_urdf(skeleton, robot, parameters)
    elif form == "sdf":
        arm, renamed = with_distinct_names(arm_of(skeleton, robot), robot.joint_names)
        root = write_sdf(arm, skeleton, robot, parameters)
        notes = (*notes, *(f"SDF wants all names to differ: link {old} is called {new}." for old, new in renamed))
    else:
        root = write_mjcf(arm_of(skeleton, robot), skeleton, robot, parameters)
    source = f"{robot.name}, identified; from {Path(model.path).name or 'a model'}, {parameter_set} parameters."
    origins = () if parameters.origins is None else parameters.origins.sentences()
    write_whole(path, document(root, (source, *notes, *origins)))
    beside = None
    terms = model.data.get("class_terms")
    if effects.left_out or terms or model.options.turns_gently:
        beside = path.with_name(path.name + ".effects.json")
        content: dict[str, Any] = {
            "format": "iiwa-ident/effects/1",
            "model": path.name,
            "effects": list(effects.left_out),
        }
        if model.options.turns_gently:
            units = ["rad/s" if revolute else "m/s" for revolute in robot.kinematics.revolute]
            unit = units[0] if len(set(units)) == 1 else units
            content["friction_transition"] = {"velocity": width, "unit": unit, "law": "F_s tanh(q̇/velocity)"}
        if terms:
            content["class_terms"] = terms
        write_whole(beside, json.dumps(content, indent=1, allow_nan=False) + "\n")
    agreements, complaints = check_export(path, form, robot, parameters)
    return ExportResult(path, agreements, (*notes, *complaints), beside, parameters.origins)


def _skeleton(robot: RobotModel, target: Path) -> ElementTree.Element:
    """The robot's own URDF where it came from one, its comments kept; else one made from its kinematics."""
    if robot.modified_denavit_hartenberg is not None:
        return arm_without_inertias(robot)
    source = Path(robot.source)
    builder = ElementTree.TreeBuilder(insert_comments=True)
    root = ElementTree.fromstring(source.read_text("utf-8"), parser=ElementTree.XMLParser(target=builder))
    fix_held_joints(root, robot)
    move_meshes(root, source.resolve().parent, target.resolve().parent)
    return root


def _notes(form: str, parameters: ModelParameters, robot: RobotModel) -> tuple[str, ...]:
    gravity = " ".join(f"{value:g}" for value in robot.gravity_in_files + 0.0)
    notes = [note.format(gravity=gravity) for note in _FRICTION_NOTES[form]]
    if form == "urdf" and robot.installation.gravity != STANDARD_GRAVITY:
        notes.append(_STAND_NOTE.format(gravity=gravity))
    rotor = parameters.rotor_inertia
    values = ", ".join(f"{value:.4g}" for value in rotor)
    notes.append(_ROTOR_NOTES[form].format(values=values) if rotor.any() else _NO_ROTOR_NOTE)
    return tuple(notes)
