"""What no motion settles, and what an operator can do about it instead.

Two hypotheses are one torque on every motion when the columns of one are combinations of the other's and of the base
parameters, whatever the motion: the rank test asks that of every motion tried, random ones too. Then something about
the arm has to change: what it carries, how it stands, how warm it is.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from identification.arrays import FloatArray
from identification.investigation.actions import ASK, Action
from identification.investigation.hypotheses import Hypothesis

ONE_TORQUE = 1e-3
"""Share of a hypothesis's λ that tells it from a rival, on the best of all motions, below which the two are one."""


LIKELY = 0.02
"""Probability below which nobody asks what tells a hypothesis from another."""
_BY_PAIR = {
    frozenset(pair): action
    for action, pairs in {
        Action.ADD_MASS: (
            ("torque_sensor_gain", "cable_spring"),
            ("torque_sensor_gain", "payload"),
            ("torque_sensor_gain", "bending_crosstalk"),
            ("torque_sensor_gain", "joint_crosstalk"),
            ("bending_crosstalk", "joint_crosstalk"),
            ("cable_spring", "joint_elasticity"),
            ("cable_spring", "position_dependent_torque"),
            ("load_dependent_friction", "position_dependent_friction"),
        ),
        Action.TURN_TOOL: (("payload", "payload"), ("payload", "joint_zero_offset")),
        Action.LEVEL_BASE: (
            ("base_tilt", "joint_crosstalk"),
            ("base_tilt", "joint_zero_offset"),
            ("base_tilt", "torque_offset"),
        ),
        Action.WARM_UP: (("torque_offset", "torque_offset"), ("torque_offset", "asymmetric_viscous_friction")),
    }.items()
    for pair in pairs
}

ALWAYS_ONE = {
    "torque_offset": ("Coulomb friction that differs between the two directions", Action.WARM_UP),
    "payload": ("other parameters of the last link", Action.TURN_TOOL),
}
"""Effects that have a twin without an entry in the library: the twin in words, and what tells the two apart."""


INVISIBLE = {
    "gain": ("a gain common to all torque sensors", "heavier links", Action.ADD_MASS),
    "load": ("a load on the flange", "other parameters of the last link", Action.TURN_TOOL),
}
"""What no motion shows at all, because base parameters take it up whole: two names for it, and what settles it.

By the equations, not by a search: every term of eq. (1) and friction is linear in its parameters, so that a factor
common to all joints is one common to all parameters; and a body fixed to the last link adds to that link's own ten.
"""


def unasked(wanted: Collection[str]) -> tuple[str, ...]:
    """What no motion shows and nobody asked for yet, each as a question to an operator. wanted: of INVISIBLE."""
    return tuple(
        f"Is there {first}, or is it {second}? The base parameters take either up whole, so that no motion within any "
        f"limits shows it. To have it settled by an action, add --settle {name}."
        for name, (first, second, _) in INVISIBLE.items()
        if name not in wanted
    )


@dataclass(frozen=True, slots=True)
class Equivalence:
    """Two names for one torque on every motion. action: what settles it; None: nothing that this program knows."""

    first: str
    second: str
    action: Action | None

    @classmethod
    def of(cls, first: Hypothesis, second: Hypothesis) -> Equivalence:
        """Of two hypotheses."""
        return cls(first.name, second.name, _BY_PAIR.get(frozenset((first.effect or "", second.effect or ""))))

    @property
    def sentence(self) -> str:
        """For the operator."""
        known = "" if self.action is None else f" {ASK[self.action]}"
        return f"No motion tells {self.first} from {self.second}: their torques are one on every motion tried.{known}"


def twins_of(effects: Sequence[str]) -> tuple[Equivalence, ...]:
    """Equivalences of claimed effects with what the library has no entry for."""
    return tuple(
        Equivalence(effect.replace("_", " "), *ALWAYS_ONE[effect])
        for effect in dict.fromkeys(effects)
        if effect in ALWAYS_ONE
    )


def invisible(question: str) -> Equivalence:
    """The equivalence that an operator asks to be settled. question: of INVISIBLE."""
    return Equivalence(*INVISIBLE[question])


def inseparable(hypotheses: Sequence[Hypothesis], best: FloatArray) -> tuple[tuple[int, int], ...]:
    """Pairs of likely hypotheses that no motion tells apart.

    best: (H, H) largest λ of each against each over all motions tried, each with all recordings; in the column of
    "nothing more" what is visible of it at all.
    """
    nothing = next(number for number, item in enumerate(hypotheses) if item.effect is None)
    found = []
    for i, first in enumerate(hypotheses):
        for j in range(i + 1, len(hypotheses)):
            second = hypotheses[j]
            if nothing in (i, j) or min(first.probability, second.probability) < LIKELY:
                continue
            visible = max(best[i, nothing], best[j, nothing])
            if visible > 0.0 and max(best[i, j], best[j, i]) < ONE_TORQUE * visible:
                found.append((i, j))
    return tuple(found)
