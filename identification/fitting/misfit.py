"""How much of each joint's torque the fitted model leaves: beyond the noise, where the recordings know their noise, and
beyond the torque itself, which no model of the joint does.

The diagnosis finds out what it is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from identification.arrays import BoolArray, FloatArray
from identification.fitting.blocks import Block
from identification.fitting.rms import RmsTable
from identification.json_values import plain

DEVIATIONS = 5.0
"""Of the energy that noise alone leaves, by which a misfit is beyond it."""
NOISE_ALONE = 1.5
"""Times the noise up to which a joint has no torque that a model could describe."""
CONTRADICTED = 120.0
"""% of a joint's RMS torque: a model that leaves more adds torque that is not there; without any, 100 are left."""
ANOTHER_SET_UP = "stand, load, signs or units are others. `iiwa-ident diagnose --model` says which"


@dataclass(frozen=True, slots=True, eq=False)
class Misfit:
    """over_noise: (n,) RMS of the misfit over RMS of the noise, within the compared band; nan where noise is not known.

    detected: (n,) whether it is more than noise would leave by chance.
    """

    over_noise: FloatArray
    detected: BoolArray

    @property
    def known(self) -> bool:
        """Whether the recordings tell their noise."""
        return bool(np.isfinite(self.over_noise).all())

    @property
    def may_be_more_than_noise(self) -> bool:
        """Whether noise is not all that is left, as far as the recordings tell."""
        return not self.known or bool(self.detected.any())

    @property
    def sentence(self) -> str:
        """What an operator should know and do."""
        if not self.known:
            return (
                "Misfit and noise cannot be told apart here, because no two periods of a motion are known: record four "
                "or more, or run `iiwa-ident diagnose`, which holds rows out."
            )
        ratios = ", ".join(f"{value:.1f}" for value in self.over_noise)
        said = f"Misfit over noise, joints 1 to {self.over_noise.size}: {ratios}."
        if not self.detected.any():
            return f"{said} Nothing but noise is left."
        joints = ", ".join(str(joint + 1) for joint in np.flatnonzero(self.detected))
        several = "joints" if np.count_nonzero(self.detected) > 1 else "joint"
        return (
            f"{said} On {several} {joints} the model leaves more than noise, and σ does not hold there: run "
            "`iiwa-ident diagnose`."
        )

    def to_json(self) -> dict[str, Any]:
        """The figures as plain JSON types."""
        return dict(plain(self))


def misfit_over_noise(blocks: Sequence[Block], values: FloatArray) -> Misfit:
    """Energy of the residual of base parameters (p,) on the fitted rows against that of their noise."""
    joints = blocks[0].torque.shape[1]
    left, expected, spread = np.zeros(joints), np.zeros(joints), np.zeros(joints)
    for block in blocks:
        noise = block.signals.row_noise
        if noise is None:
            return Misfit(np.full(joints, np.nan), np.zeros(joints, dtype=np.bool_))
        residual = np.where(block.fitted, block.torque - block.columns @ values, 0.0)
        power = np.where(block.fitted, noise**2, 0.0)
        left += (residual**2).sum(axis=0)
        expected += power.sum(axis=0)
        # A line and its neighbours share one estimate of the noise: those errors add up within a neighbourhood.
        shared = 2.0 * float(len(power)) / max(1.0, block.signals.noise_freedom) / 10.0
        spread += 2.0 * (1.0 + shared) * (power**2).sum(axis=0)
    beyond = left - expected
    over = np.sqrt(np.maximum(beyond, 0.0) / np.maximum(expected, 1e-300))
    return Misfit(over, beyond > DEVIATIONS * np.sqrt(spread))


def notes_on_joints_missed(rms: RmsTable) -> tuple[str, ...]:
    """A warning where a fit leaves a joint as much as no model at all would: the recording is not what it states."""
    fits = [row for row in rms.rows if row.label.startswith("fit,")]
    noise = np.array([row.rms_nm <= NOISE_ALONE * row.noise_floor_nm for row in fits])
    each = np.where(noise, 0.0, [row.percent for row in fits])
    share = each.max(axis=0)
    missed = np.flatnonzero(share >= 100.0)
    if not missed.size:
        return ()
    joints = ", ".join(str(joint + 1) for joint in missed)
    shares = ", ".join(f"{share[joint]:.0f}" for joint in missed)
    which = "the model" if (each[0] >= 100.0).any() else "the feasible set, not the base parameters,"
    return (
        f"WARNING, {which} describes nothing of joint{'s' * (missed.size > 1)} {joints}: it leaves {shares} % of the "
        "RMS torque there; `iiwa-ident doctor --log` checks signs, units, clock and order of the recording",
    )


def notes_on_models_contradicted(rms: RmsTable, misplaced: Callable[[str], str] = lambda _: "") -> tuple[str, ...]:
    """A warning for each recording of which a model leaves a joint more than the torque itself: another set-up.

    misplaced: of the name of such a recording, what is to be said of joints that stand elsewhere; else empty.
    """
    notes: dict[str, str] = {}
    for row in rms.rows:
        name = row.label.rpartition(", ")[0]
        wrong = np.flatnonzero((row.percent >= CONTRADICTED) & ~(row.rms_nm <= NOISE_ALONE * row.noise_floor_nm))
        if wrong.size and name not in notes:
            joints = ", ".join(str(joint + 1) for joint in wrong)
            shares = ", ".join(f"{row.percent[joint]:.0f}" for joint in wrong)
            notes[name] = (
                f"WARNING, {name}: the model leaves {shares} % of the RMS torque of joint{'s' * (wrong.size > 1)} "
                f"{joints}, more than no model would: {misplaced(name).rstrip('.') or ANOTHER_SET_UP}"
            )
    return tuple(notes.values())
