"""Which effects are the same torque, which contain another, and what to record to tell a set of them apart.

Here: the relation of two effects' columns once the nominal columns are projected off, and the experiments per pair.
Which of two explains a recording is not decided here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from types import MappingProxyType
from typing import Literal

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.effects import effect_named

Kind = Literal["identical", "first_in_second", "second_in_first", "distinct"]

# 1 − cosine below which two directions are one: rounding and the tilt of a fitted model, no experiment of this length.
SAME = 1e-4

ALSO_CALLED: Mapping[str, str] = MappingProxyType(
    {
        "torque_offset": "asymmetric Coulomb friction, or the rest torque of a cable",
        "payload": "other parameters of the last link",
    }
)
"""Physics that is the same torque as an effect on every motion, and has no entry of its own."""

_EXPERIMENTS: Mapping[frozenset[str], str] = MappingProxyType(
    {
        frozenset(pair): text
        for pair, text in {
            ("bending_crosstalk", "joint_crosstalk"): "Load the neighbouring joint by a motor torque against a stop "
            "held by the same link: it turns the neighbour's sensor without bending this joint.",
            ("bending_crosstalk", "torque_sensor_gain"): "Press on the arm at rest with a known force, once along a "
            "line through the joint's axis (bending alone), once across it (torque).",
            ("cable_spring", "torque_offset"): "Repeat the motion about another centre of the joint: a spring's "
            "torque moves with it, an offset stays.",
            ("cable_spring", "torque_sensor_gain"): "Repeat with a known payload: a gain grows with the load, a spring "
            "does not.",
            ("cable_spring", "joint_elasticity"): "Repeat with a known payload: wind-up grows with the load, a "
            "spring does not.",
            ("position_dependent_torque", "torque_offset"): "Let the joint turn through more than one period of the "
            "harmonic.",
            ("load_dependent_friction", "position_dependent_friction"): "Repeat the same path with a known payload.",
            ("presliding_hysteresis", "stribeck_friction"): "Drive the same path at half the speed: pre-sliding keeps "
            "its place along the path, Stribeck friction its speed.",
            ("presliding_hysteresis", "torque_delay"): "Drive the same path at half the speed: a delay keeps its "
            "time, pre-sliding its distance.",
            ("stribeck_friction", "torque_delay"): "Drive the same path at half the speed: a delay keeps its time, "
            "Stribeck friction its speed.",
            ("nonlinear_viscous_friction", "stribeck_friction"): "Drive up to the speed limit, then creep: curvature "
            "shows at the fast end, Stribeck friction at the slow one.",
            ("asymmetric_viscous_friction", "torque_offset"): "Drive constant speeds, slow and fast, in both "
            "directions: an offset does not grow with speed.",
            ("base_elasticity", "joint_elasticity"): "Set a dial gauge on the base and stretch the arm "
            "out: only a base that yields moves it.",
            ("base_tilt", "joint_crosstalk"): "Level the base with an inclinometer and repeat; crosstalk stays.",
            ("distal_rotor_reaction", "torque_sensor_gain"): "Hold a known mass at rest: only a gain shows there.",
            ("backlash", "joint_elasticity"): "Rock the joint about the pose where its torque is zero: play shows "
            "there alone, elasticity in proportion to the torque.",
            ("backlash", "torque_sensor_gain"): "Hold a known mass at rest: only a gain shows there.",
            ("joint_zero_offset", "payload"): "Calibrate the joint's zero geometrically (reference marks).",
            ("payload", "torque_sensor_gain"): "Hold a known mass at rest in several poses.",
        }.items()
    }
)


@dataclass(frozen=True, slots=True)
class Relation:
    """How two effects' projected columns stand to each other.

    kind: "identical" (one space), "first_in_second" or "second_in_first" (nested), "distinct". cosine: of the smallest
    angle between the two spaces; 1 means that some combination of one is some combination of the other.
    """

    kind: Kind
    cosine: float


def relation(first: FloatArray, second: FloatArray) -> Relation:
    """Relation of two spaces given by orthonormal columns (rows, m₁) and (rows, m₂); a space of nothing is in any."""
    sizes = first.shape[1], second.shape[1]
    if 0 in sizes:
        return Relation(
            "identical" if sizes == (0, 0) else "first_in_second" if sizes[0] == 0 else "second_in_first", 0.0
        )
    cosines = np.linalg.svd(first.T @ second, compute_uv=False)
    largest = min(1.0, float(cosines[0]))
    if cosines[-1] < 1.0 - SAME:
        return Relation("distinct", largest)
    if sizes[0] == sizes[1]:
        return Relation("identical", largest)
    return Relation("first_in_second" if sizes[0] < sizes[1] else "second_in_first", largest)


def separating_experiment(names: Sequence[str]) -> str | None:
    """What to record to tell the named effects apart: one sentence per pair that has its own, else the first's.

    None where all names are one effect (the same at several joints) that has nothing to be told from. Raises KeyError
    for a name that the library has not.
    """
    distinct = tuple(dict.fromkeys(names))
    known = [
        _EXPERIMENTS[key] for pair in combinations(sorted(distinct), 2) if (key := frozenset(pair)) in _EXPERIMENTS
    ]
    if known:
        return " ".join(dict.fromkeys(known))
    return effect_named(distinct[0]).separating_experiment if distinct else None
