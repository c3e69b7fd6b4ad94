"""What a simulator model can hold of the effects that a diagnosis found, and what must stay beside it.

Here: one table and two functions. Not here: finding effects, or simulating them (`simulation` takes them as a torque).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from identification.arrays import FloatArray
from identification.export.parameters import ModelParameters
from identification.mismatch.settings import CAPTURE
from identification.model_file import Model

IN_THE_PARAMETERS = {
    "payload": "is part of the last link's mass and inertia",
    "rotor_inertia": "is the joint's rotor inertia",
}
"""Effects that the exported numbers hold: the extended model was fitted with the load, and `with_found_rotors` adds the
rotor inertias that were found."""


@dataclass(frozen=True, slots=True)
class EffectsNote:
    """left_out: effects that the simulator model cannot hold, as in the findings.

    sentences: one for each effect, for the file's head and the operator.
    """

    left_out: tuple[dict[str, Any], ...]
    sentences: tuple[str, ...]


def with_found_rotors(parameters: ModelParameters, model: Model) -> ModelParameters:
    """The model's parameters with the rotor inertias that stand among its effects: those are beside its parameters.

    Raises ModelFileError for such an effect that is not complete.
    """
    rotor = parameters.rotor_inertia.copy()
    for effect in model.data.get("effects", []):
        if effect.get("effect") == "rotor_inertia":
            try:
                rotor[int(effect["joint"]) - 1] += float(effect["model"]["coefficients"][0])
            except (KeyError, TypeError, ValueError, IndexError) as error:
                raise model.error(f"effect rotor_inertia is not complete ({error!r})", "effects") from error
    return replace(parameters, rotor_inertia=rotor)


def effects_note(model: Model, offset: FloatArray, coulomb: FloatArray, units: Sequence[str]) -> EffectsNote:
    """Sort the model's effects into those the simulator model holds and those that go into a file beside it.

    offset, coulomb: (n,) constant torque and Coulomb friction of each joint in the set of parameters that is written,
    in its unit. No format has a place for the former: it is left out as an effect, and advice is given where it is more
    than a tenth of the latter.
    """
    left_out, sentences = [], []
    offsets: list[dict[str, Any]] = [
        {"effect": "torque_offset", "joint": joint, "parameters": {"offset": {"value": float(value), "unit": unit}}}
        for joint, (value, unit) in enumerate(zip(offset, units, strict=True), start=1)
    ]
    small, some = np.abs(offset) <= CAPTURE * coulomb, offset != 0.0
    told, little = ([offsets[joint] for joint in np.flatnonzero(some & which)] for which in (~small, small))
    for effect in [*model.data.get("effects", []), *told]:
        name = str(effect.get("effect"))
        where = f" of joint {effect['joint']}" if effect.get("joint") else ""
        if name in IN_THE_PARAMETERS:
            sentences.append(f"{name}{where} {IN_THE_PARAMETERS[name]}.")
        else:
            left_out.append(effect)
            sentences.append(f"{name}{where} has no place in a simulator model: apply it as a joint torque.")
    if terms := (model.data.get("class_terms") or {}).get("terms"):
        joints = sorted({int(term["joint"]) for term in terms})
        named = f"joint{'s' if len(joints) > 1 else ''} {', '.join(map(str, joints))}"
        sentences.append(
            f"The torque without a name on {named} (class_terms) has no place in a simulator model: apply it as a "
            "joint torque."
        )
    return EffectsNote((*left_out, *little), tuple(sentences))
