"""Class terms as they stand in `model.json`: bases, weights, the ranges they were fitted and checked in; their torque.

Beyond these ranges every term fades to zero.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from identification.arrays import FloatArray
from identification.errors import ModelFileError
from identification.mismatch.effects.displacement import torque_of_displacement
from identification.mismatch.motion import Motion
from identification.mismatch.unknown.angle import AngleBasis
from identification.mismatch.unknown.classes import CLASSES, Basis
from identification.mismatch.unknown.inputs import Inputs, Ranges, random_waves
from identification.mismatch.unknown.selection import Selection

FRICTION = "friction"
"""Viscous and Coulomb friction that stand with the class terms of a joint: no class, and no mismatch of its own."""
_NUMBERS = {item.name: number for number, item in enumerate(CLASSES)}


def terms_of(selection: Selection) -> dict[str, Any]:
    """JSON of all classes that a selection holds, with their posterior mean weights."""
    rows = selection.rows
    terms = []
    for joint, state in enumerate(selection.states):
        if not state.groups:
            continue
        weights = selection.posterior(joint, state).weights
        for place, group in enumerate(state.groups):
            basis, shown = rows.joints[joint].bases[group], rows.joints[joint].shown[group]
            terms.append(
                {
                    "class": CLASSES[basis.number].name,
                    "group": basis.group,
                    "joint": joint + 1,
                    "centre": basis.centre.tolist(),
                    "scale": basis.scale,
                    "weights": (shown @ weights[state.gram.group == place]).tolist(),
                }
            )
    if rows.angles:
        base = selection.mean(0, selection.states[0])[1]
        for item, own in zip(rows.angles, rows.angle_columns, strict=True):
            terms.append(
                {
                    "class": item.name,
                    "group": item.group,
                    "joint": item.joint + 1,
                    "angle": True,
                    "centre": item.centre.tolist(),
                    "scale": item.scale,
                    "weights": base[own].tolist(),
                }
            )
    direction, phase = random_waves(rows.inputs[0].motion.n)
    return {
        "ranges": rows.inputs[0].ranges.to_json(),
        "fade": rows.inputs[0].fade_width,
        "waves": {"direction": direction.tolist(), "phase": phase.tolist()},
        "terms": terms,
    }


def with_friction(
    data: Mapping[str, Any], values: Mapping[str, float], bounds: Mapping[str, tuple[float, float]]
) -> tuple[dict[str, Any], dict[str, float]]:
    """Class terms with the friction that no joint has, and base parameters by name without it.

    Beside a torque that falls with the speed, parameters that are free take a viscous friction below zero. Within the
    ranges the sum stays as it is; beyond, where the terms end, and in physical parameters a friction of a machine is
    left. bounds: of "FV" (Nm s/rad) and "FS" (Nm). Joints without class terms keep what they have.
    """
    terms, changed = list(data["terms"]), dict(values)
    for joint in sorted({int(term["joint"]) for term in terms if not term.get("angle")}):
        weights = []
        for symbol in ("FV", "FS"):
            value = values.get(f"{symbol}_{joint}", 0.0)
            kept = float(np.clip(value, *bounds[symbol]))
            weights.append(value - kept if f"{symbol}_{joint}" in values else 0.0)
            changed[f"{symbol}_{joint}"] = kept
        if any(weights):
            terms.append({"class": FRICTION, "joint": joint, "weights": weights})
    return {**data, "terms": terms}, {name: changed[name] for name in values}


def terms_torque(data: Mapping[str, Any], motion: Motion) -> FloatArray:
    """(S, n) Nm of class terms along a motion. Raises ModelFileError where they are not complete or of another arm."""
    torque = np.zeros((motion.samples, motion.n))
    if "position_lower" in data.get("ranges", {}) and ("bending" not in data["ranges"] or "waves" not in data):
        raise ModelFileError(
            "The torque without a name in this model was written by an earlier version, which did not keep all that it "
            "is evaluated with: diagnose the recording again and use the model that this writes",
            field="class_terms",
        )
    try:
        ranges = Ranges.from_json(data["ranges"])
        waves = np.array(data["waves"]["direction"]).reshape(motion.n, -1), np.array(data["waves"]["phase"])
        inputs = Inputs(motion, ranges, float(data["fade"]), ranges, waves)
        if inputs.ranges.speed.size != motion.n:
            raise ValueError(f"{inputs.ranges.speed.size} joints")
        for term in data["terms"]:
            joint = int(term["joint"]) - 1
            if term["class"] == FRICTION:
                friction = np.column_stack([motion.velocity[:, joint], motion.direction[:, joint]])
                torque[:, joint] += inputs.inside("velocity")[:, joint] * (friction @ np.array(term["weights"]))
                continue
            centre = np.array(term["centre"], dtype=np.float64)
            if term.get("angle"):
                angle = AngleBasis(term["class"], int(term["group"]), joint, centre, float(term["scale"]))
                moved = angle.displacement(inputs) @ np.array(term["weights"], dtype=np.float64)
                torque += torque_of_displacement(motion, joint, moved)
                continue
            basis = Basis(_NUMBERS[term["class"]], int(term["group"]), joint, centre, float(term["scale"]))
            torque[:, joint] += basis.columns(inputs) @ np.array(term["weights"], dtype=np.float64)
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise ModelFileError(
            f"The class terms of the model are not complete, or of an earlier version ({error!r}): diagnose the "
            "recording again and use the model that this writes",
            field="class_terms",
        ) from error
    return torque


def range_sentence(data: Mapping[str, Any]) -> str:
    """Where the terms hold, in words."""
    joints = sorted({int(term["joint"]) for term in data["terms"]})
    named = ", ".join(map(str, joints))
    return (
        f"The model holds torque without a name on joint{'s' if len(joints) > 1 else ''} {named}; it was fitted and "
        "checked within the ranges that stand with it in model.json, and fades to zero beyond them."
    )
