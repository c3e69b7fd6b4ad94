"""The effects of the library on the motion at hand: every place, every grid point, as rows beside the nominal ones.

Rows depend on the motion only; they are computed once and kept. Here no torque is looked at.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.effects.base import Effect, Place
from identification.mismatch.evidence import Evidence, Rows
from identification.mismatch.motion import Motion
from identification.mismatch.settings import ALTERNATIVE

Shape = tuple[tuple[str, float], ...]


@dataclass(frozen=True, slots=True, eq=False)
class EffectRows:
    """An effect at one place and one shape. joints: from 0. rows: (len(joints), R, m) Nm per unit, all evidences.

    cost: log-likelihood that the choice of the shape costs: the log of the number of grid points that it was chosen
    from (in textbook forms, of these), and ALTERNATIVE for each nonlinear parameter off its textbook value: the simpler
    form is said that is as good.
    """

    effect: Effect
    place: Place
    shape: Shape
    joints: tuple[int, ...]
    rows: FloatArray
    cost: float = 0.0

    @property
    def coefficients(self) -> int:
        """Number m of columns."""
        return int(self.rows.shape[2])


@dataclass(slots=True)
class Library:
    """Effects with the evidences they are evaluated on, and what was evaluated so far.

    waves: joint (from 1) → how often per turn its torque may repeat beside what is usual (`ShapeParameter.apart`).
    """

    effects: Sequence[Effect]
    evidences: Sequence[Evidence]
    waves: Mapping[int, tuple[float, ...]] = field(default_factory=dict)
    _known: dict[tuple[str, Place, Shape], EffectRows | None] = field(default_factory=dict)
    _candidates: tuple[list[EffectRows], list[tuple[Effect, Place]]] | None = field(default=None, init=False)

    def seen_from(self, evidences: Sequence[Evidence]) -> Library:
        """The same effects on the same motions with another torque; rows that do not depend on that are kept."""
        kept = {effect.name for effect in self.effects if not effect.sees_torque}
        known = {key: rows for key, rows in self._known.items() if key[0] in kept}
        return Library(self.effects, evidences, self.waves, known)

    def rows(self, effect: Effect, place: Place, shape: Shape) -> EffectRows | None:
        """The rows of an effect; None where no evidence lets it act."""
        key = (effect.name, place, shape)
        if key not in self._known:
            found = evaluate(effect, place, dict(shape), self.evidences)
            self._known[key] = None if found is None else replace(found, cost=self._cost(effect, place, shape))
        return self._known[key]

    def _cost(self, effect: Effect, place: Place, shape: Shape) -> float:
        if not shape:
            return 0.0
        values = dict(shape)
        parameters = effect.shape_parameters(self.evidences[0].motion, place)
        held = [item.textbook is not None and values[item.name] == item.textbook for item in parameters]
        freed = sum(item.textbook is not None for item in parameters) - sum(held)
        points = (item.choices for item, there in zip(parameters, held, strict=True) if freed or not there)
        return math.log(math.prod(points)) + ALTERNATIVE * freed

    def grid(self, effect: Effect, place: Place) -> tuple[Shape, ...]:
        """All combinations of the grids of the effect's nonlinear parameters; one empty shape for a linear effect."""
        return grid_of(effect, place, self.evidences[0].motion, self.waves.get(place.joint or 0, ()))

    def candidates(self) -> tuple[list[EffectRows], list[tuple[Effect, Place]]]:
        """All repeatable effects at all places and grid points, and the pairs that the motion does not let act."""
        if self._candidates is None:
            self._candidates = self._evaluated()
        return self._candidates

    def _evaluated(self) -> tuple[list[EffectRows], list[tuple[Effect, Place]]]:
        found: list[EffectRows] = []
        inactive: list[tuple[Effect, Place]] = []
        for effect in self.effects:
            if effect.stage != "repeatable":
                continue
            for place in effect.places(self.evidences[0].motion):
                rows = [
                    item for item in (self.rows(effect, place, shape) for shape in self.grid(effect, place)) if item
                ]
                found.extend(rows)
                if not rows:
                    inactive.append((effect, place))
        return found, inactive


def grid_of(effect: Effect, place: Place, motion: Motion, waves: Sequence[float] = ()) -> tuple[Shape, ...]:
    """All combinations of the grids of the effect's nonlinear parameters; one empty shape for a linear effect.

    waves: asked beside the grid of a parameter that says how often a torque repeats, as far as in its bounds.
    """
    parameters = effect.shape_parameters(motion, place)
    names = [item.name for item in parameters]
    grids = [
        (*item.grid, *(order for order in waves if item.apart and item.lower <= order <= item.upper))
        for item in parameters
    ]
    return tuple(tuple(zip(names, values, strict=True)) for values in product(*grids))


def evaluate(effect: Effect, place: Place, shape: Mapping[str, float], evidences: Sequence[Rows]) -> EffectRows | None:
    """Project an effect's columns like the torque, evidence by evidence; zero rows where one does not let it act."""
    parts = [effect.columns(evidence.motion, place, shape) for evidence in evidences]
    present = [part for part in parts if part is not None]
    if not present or not any(np.any(part.values) for part in present):
        return None
    joints = tuple(sorted({joint for part in present for joint in part.joints}))
    size = present[0].values.shape[2]
    blocks = []
    for evidence, part in zip(evidences, parts, strict=True):
        block = np.zeros((len(joints), evidence.noise.shape[0], size))
        if part is not None:
            projected = evidence.project(np.asarray(part.values, dtype=np.float64))
            for position, joint in enumerate(part.joints):
                block[joints.index(joint)] = projected[:, position]
        blocks.append(block)
    rows = np.concatenate(blocks, axis=1)
    if not np.all(np.isfinite(rows)):
        return None
    return EffectRows(effect, place, tuple(shape.items()), joints, rows)
