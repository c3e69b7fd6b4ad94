"""What missing physics a planned motion will show, effect by effect and joint by joint.

Here: λ at plausible size and the smallest size that shows, from the effect library's own columns on the 1 kHz table.
Not here: that computation (`identification.mismatch.detectability`) and the objective (`detectability_term`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from identification.arrays import FloatArray
from identification.base_parameters import BaseRegressor
from identification.excitation.effect_columns import PLAUSIBLE_SIZES
from identification.excitation.fourier import Trajectory
from identification.excitation.prediction import NoiseColour
from identification.mismatch.detectability import ORACLE_STRENGTH, candidates, confusable, planned_rows
from identification.mismatch.effects import effect_named
from identification.mismatch.motion import Motion
from identification.mismatch.settings import DiagnosisSettings
from identification.physical_parameters import PhysicalParameters

TOOL_STRENGTH = 2.0 * DiagnosisSettings().complete_score
"""λ from which the diagnosis finds that something is missing: its score counts half a χ²."""


@dataclass(frozen=True, slots=True)
class ShownEffect:
    """One effect at one joint (from 1; other_joint for crosstalk). size: plausible, in unit of the coefficient.

    strength: λ at that size over the run, of the phase that shows least. smallest_oracle, smallest_tool: size with
    λ = 24 and with the diagnosis's own threshold; inf where nothing shows. alike: the effect and joint whose rest is
    most like this one's, and the cosine between them; "" where none comes near 0.9.
    """

    effect: str
    joint: int
    other_joint: int | None
    size: float
    unit: str
    strength: float
    smallest_oracle: float
    smallest_tool: float
    alike: str
    cosine: float


def effects_shown(
    regressor: BaseRegressor,
    trajectory: Trajectory,
    nominal: PhysicalParameters,
    noise_nm: FloatArray,
    periods: int,
    colour: NoiseColour | None = None,
) -> tuple[ShownEffect, ...]:
    """Every effect of `PLAUSIBLE_SIZES` at every joint on `periods` periods, noise_nm (n,) Nm per sample at 1 kHz.

    colour: spectrum of the noise, None for the iiwa's.
    """
    samples = round(1000.0 * trajectory.period_s)
    times = np.arange(samples) / 1000.0
    states = trajectory.evaluate(times)
    full = regressor.full_from_physical(nominal)
    torque = regressor.torque(regressor.base_from_full(full), *states)
    motion = Motion(regressor.robot, times, *states, torque, full, True, np.zeros(1))
    rows = planned_rows(motion, regressor, noise_nm, periods=periods)
    factor = (colour or NoiseColour()).row_factor(len(rows.noise), trajectory.period_s, 1000.0)
    rows = replace(rows, noise=rows.noise * factor[:, None])
    found = [
        item
        for item in candidates([rows], [effect_named(name) for name in PLAUSIBLE_SIZES])
        if item.place.joint is not None
    ]
    nearest: dict[int, tuple[str, float]] = {}
    for pair in confusable(found):
        for one, other in ((pair.first, pair.second), (pair.second, pair.first)):
            nearest.setdefault(id(one), (f"{other.effect.name} at joint {other.place.joint}", pair.relation.cosine))
    shown = []
    for item in found:
        leading = np.flatnonzero(item.leading)
        size = PLAUSIBLE_SIZES[item.effect.name]
        unit_strength = float(np.linalg.eigvalsh(item.strength[np.ix_(leading, leading)])[0])
        unit_strength = max(unit_strength, 0.0) if item.identifiable else 0.0
        oracle, tool = (
            math.sqrt(needed / unit_strength) if unit_strength > 0.0 else math.inf
            for needed in (ORACLE_STRENGTH, TOOL_STRENGTH)
        )
        alike, cosine = nearest.get(id(item), ("", 0.0))
        shown.append(
            ShownEffect(
                item.effect.name, int(item.place.joint or 0), item.place.other_joint, size, item.effect.units[0],
                size**2 * unit_strength, oracle, tool, alike, cosine,
            )
        )  # fmt: skip
    return tuple(shown)
