"""What an operator can do that no motion can, and what a recording before and one after it say: the same motion twice.

Between two recordings of one motion everything cancels that was not changed, a model error too, so that the difference
of their torques is that of what was done and the noise of both. Turned tool: a load's first moments across the
flange's axis and its products of inertia with it change their sign. Added mass: the share of its torque that a sensor
reads is the sensor's gain. Levelled base: gravity turns in its frame. Warmed up: friction falls, and whatever part of
an offset is friction falls with it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from scipy.special import chdtrc

from identification.arrays import FloatArray
from identification.base_parameters import Widths, direction_of
from identification.errors import RecordingError
from identification.investigation.added_mass import AddedMass
from identification.mismatch.effects import effect_named
from identification.mismatch.effects.base import Place
from identification.mismatch.evidence import Evidence
from identification.mismatch.motion import Motion
from identification.mismatch.settings import DIFFERENT
from identification.regressor import link_columns


class Action(StrEnum):
    """What an operator can do that no motion can."""

    ADD_MASS = "add_mass"
    TURN_TOOL = "turn_tool"
    LEVEL_BASE = "level_base"
    WARM_UP = "warm_up"


ASK = {
    Action.ADD_MASS: "Fasten a known mass to the flange and give the command again with --added-mass KG@X,Y,Z (kg, and "
    "m from the flange): what is proportional to the torque grows with it, what is not stays.",
    Action.TURN_TOOL: "Turn the tool by half a turn on the flange and give the command again with --done turn_tool: a "
    "load turns with the tool, the last link does not.",
    Action.LEVEL_BASE: "Level the base with an inclinometer and give the command again with --done level_base: what a "
    "leaning base did goes with it, all else stays.",
    Action.WARM_UP: "Warm the arm up by half an hour of motion and give the command again with --done warm_up: "
    "friction falls with temperature, an offset of the sensor stays.",
}
"""The question to the operator, in plain words."""
TOLD = 3.0
"""Nats from which on one of two answers is given: odds of 20 to 1."""
LEAST_LOAD = 1e-3
"""Share of a known mass's largest torque on any joint from which on a joint's sensor is asked about it."""
MOST_GAIN = 0.5
"""Share by which sensors may read a known mass wrongly; beyond it the mass is not what was said."""
_SAME_MOTION_RAD = 1e-3
_TURNED = (1, 2, 6, 8)
"""Of eq. (3), those that change their sign when a body turns by half a turn about z: MX, MY, XZ, YZ."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """answer: short, for programs. settled: whether one answer stands. sentence: with the figures, for the operator."""

    action: Action
    answer: str
    settled: bool
    sentence: str


@dataclass(frozen=True, slots=True, eq=False)
class Difference:
    """Two recordings of one motion: rows (R, n) Nm of the second minus the first, and their deviation (R, n) Nm.

    own_noise: (R, n) Nm, the second one's share of the deviation; the first one's is in all that it is taken from.
    """

    before: Evidence
    rows: FloatArray
    noise: FloatArray
    own_noise: FloatArray

    def project(self, columns: FloatArray) -> FloatArray:
        """Rows (R, …) of torque columns (S, …) along the motion."""
        return self.before.project(columns)[: len(self.rows)]

    def fit(self, columns: FloatArray, joints: Sequence[int]) -> tuple[FloatArray, FloatArray]:
        """Coefficients (m,) of columns (S, len(joints), m) Nm and their covariance, noise as large as what they leave.

        Constants that drift between recordings are fitted beside them, joint by joint.
        """
        blocks, target = [], []
        for number, joint in enumerate(joints):
            drift = np.zeros((len(columns), len(joints)))
            drift[:, number] = 1.0
            rows = self.project(np.concatenate([columns[:, number], drift], axis=1))
            blocks.append(rows / self.noise[:, joint, None])
            target.append(self.rows[:, joint] / self.noise[:, joint])
        matrix, measured = np.concatenate(blocks), np.concatenate(target)
        scale = np.maximum(np.linalg.norm(matrix, axis=0), 1e-300)
        covariance = np.linalg.pinv((matrix / scale).T @ (matrix / scale), 1e-10, hermitian=True)
        values = covariance @ ((matrix / scale).T @ measured)
        left = measured - (matrix / scale) @ values
        excess = max(1.0, float(left @ left) / max(1, measured.size - scale.size))
        own = columns.shape[2]
        return (values / scale)[:own], (excess * covariance / np.outer(scale, scale))[:own, :own]


def differences(before: Evidence, *after: Evidence) -> tuple[Difference, ...]:
    """What each recording of a motion has beyond the first one, up to the lowest frequency that one is compared to.

    Raises RecordingError where the motions are not one.
    """
    for item in after:
        if not is_same(before.motion, item.motion):
            raise RecordingError(
                f"{item.recording.source.path} is not the motion of {before.recording.source.path}: what was changed "
                "between them shows only where the arm moves alike",
                file=item.recording.source.path,
            )
    count = min(len(item.torque) for item in (before, *after))
    shared = before.noise[:count]
    return tuple(
        Difference(
            before,
            item.torque[:count] - before.torque[:count],
            np.sqrt(shared**2 + item.noise[:count] ** 2),
            item.noise[:count],
        )
        for item in after
    )


def is_same(first: Motion, second: Motion) -> bool:
    """Whether two motions are one, as far as an arm drives the same positions twice."""
    if first.position.shape != second.position.shape:
        return False
    return float(np.abs(first.position - second.position).max()) <= _SAME_MOTION_RAD


def added_mass(difference: Difference, mass: AddedMass) -> Outcome:
    """What each sensor reads of a known mass. difference: of the raw torques, the mass on the flange in the second."""
    motion = difference.before.motion
    torque = mass.torque(motion.robot, motion.position, motion.velocity, motion.acceleration)
    gains, variances = [], []
    size = np.sqrt((torque**2).mean(axis=0))
    # A mass on the axis of a joint loads it with nothing.
    loaded = [int(joint) for joint in np.flatnonzero(size > LEAST_LOAD * size.max())]
    for joint in loaded:
        values, covariance = difference.fit(torque[:, joint, None, None], [joint])
        gains.append(float(values[0]) - 1.0)
        variances.append(float(covariance[0, 0]))
    precision = 1.0 / np.array(variances)
    gain = float(precision @ np.array(gains) / precision.sum())
    deviation = 1.0 / math.sqrt(float(precision.sum()))
    distance = float(chdtrc(len(gains) - 1, float(precision @ (np.array(gains) - gain) ** 2)))
    text = f"Of the known mass the sensors read {100 * (1 + gain):.2f} ± {100 * 1.96 * deviation:.2f} % (95 %)"
    if abs(gain) > MOST_GAIN:
        return Outcome(
            Action.ADD_MASS, "", False,
            f"{text}. No sensor is that wrong: see that the mass is on the flange, weigh it, give --added-mass again.",
        )  # fmt: skip
    if distance < DIFFERENT:
        worst = int(np.argmax(np.abs(np.array(gains) - gain) * np.sqrt(precision)))
        return Outcome(
            Action.ADD_MASS, "single_gain", True,
            f"{text}, but not alike: joint {loaded[worst] + 1} reads {100 * (1 + gains[worst]):.2f} % of it (chance "
            f"{distance:.1g}). Its sensor has a gain of its own.",
        )  # fmt: skip
    if chdtrc(1, (gain / deviation) ** 2) < DIFFERENT:
        return Outcome(Action.ADD_MASS, "common_gain", True, f"{text}: all sensors have this gain, no link is heavier.")
    return Outcome(
        Action.ADD_MASS, "no_common_gain", True, f"{text}: no common gain beyond that; what the links weigh stands."
    )


def turned_tool(difference: Difference) -> Outcome:
    """Whether what hangs on the flange turned with the tool."""
    motion = difference.before.motion
    states = (motion.position, motion.velocity, motion.acceleration)
    columns = link_columns(motion.robot, *states, motion.n - 1, _TURNED)
    size, covariance = difference.fit(columns, range(motion.n))
    chance = float(chdtrc(size.size, float(size @ np.linalg.solve(covariance, size))))
    moment, deviation = -0.5 * size[:2], 0.5 * np.sqrt(np.diag(covariance)[:2])
    text = (
        f"Across the flange's axis the load has first moments of {moment[0]:+.4f} ± {1.96 * deviation[0]:.4f} and "
        f"{moment[1]:+.4f} ± {1.96 * deviation[1]:.4f} kg m (95 %; x and y of the last link, before the turn)"
    )
    if chance < DIFFERENT:
        return Outcome(Action.TURN_TOOL, "load", True, f"{text}: there is a load that turned with the tool.")
    return Outcome(
        Action.TURN_TOOL, "last_link", True,
        f"{text}: nothing turned. What is there belongs to the last link, or sits on the flange's axis.",
    )  # fmt: skip


def levelled(difference: Difference) -> Outcome:
    """Whether gravity turned in the base's frame, about the two axes that are level with the ground."""
    motion = difference.before.motion
    columns = effect_named("base_tilt").columns(motion, Place(), {})
    if columns is None:
        return Outcome(Action.LEVEL_BASE, "", False, "Without gravity no level is seen.")
    turn, covariance = difference.fit(columns.values, columns.joints)
    chance = float(chdtrc(turn.size, float(turn @ np.linalg.solve(covariance, turn))))
    angle = math.degrees(float(np.linalg.norm(turn)))
    deviation = math.degrees(math.sqrt(float(np.linalg.eigvalsh(covariance)[-1])))
    text = f"Gravity turned by {angle:.3f} ± {1.96 * deviation:.3f}° (95 %) in the frame of the base"
    if chance < DIFFERENT:
        return Outcome(Action.LEVEL_BASE, "base_tilt", True, f"{text}: the base leaned by so much.")
    return Outcome(
        Action.LEVEL_BASE, "level", True, f"{text}: it stood no other way before. What is there is no tilt of the base."
    )


def warmed_up(
    warm: Sequence[Difference], joint: int, offset: tuple[float, float], coulomb: tuple[float, float]
) -> Outcome:
    """Whether an offset of a joint (from 0) is the sensor's, or Coulomb friction that differs between directions.

    warm: each warm recording against one cold one, judged together: the noise of the cold one is in all of them.
    offset, coulomb: of the joint before, Nm, with deviations. With r the changes of the Coulomb friction over the
    friction, the changes of the offset are N(0, S) where it is the sensor's, and N(b r, …) where it is friction. The
    cold recording's noise is in b and, with the other sign, in the changes.
    """
    change, covariance, cold = _frictions(warm, joint)
    (size, size_std), (dry, dry_std) = offset, coulomb
    shift, ratio = change[:, 0], change[:, 1] / dry
    own, across, other = covariance[:, 0, :, 0], covariance[:, 0, :, 1] / dry, covariance[:, 1, :, 1] / dry**2
    other = other + np.outer(ratio, ratio) * (dry_std / dry) ** 2
    spread = own - size * (across + across.T) + size**2 * other + np.outer(ratio, ratio) * size_std**2
    # An estimate from more than the cold recording shares with it no more than its own variance.
    spread += min(size_std**2, cold) * (ratio[:, None] + ratio)
    odds = _log_normal(shift - size * ratio, spread) - _log_normal(shift, own)
    last = -1
    text = (
        f"Joint {joint + 1}: Coulomb friction changed by {100 * ratio[last]:+.0f} %, the offset of {size:+.3g} Nm by "
        f"{shift[last]:+.3g} ± {1.96 * math.sqrt(own[last, last]):.2g} Nm (95 %)"
    )
    if len(warm) > 1:
        text += f", {len(warm)} warm recordings judged together"
    again = "Warm the arm up more and record once more: all warm recordings are judged together."
    if float(ratio @ np.linalg.solve(other, ratio)) <= TOLD**2:
        return Outcome(Action.WARM_UP, "", False, f"{text}: friction did not change enough. {again}")
    if odds >= TOLD:
        return Outcome(Action.WARM_UP, "asymmetric_coulomb_friction", True,
                       f"{text}: it is Coulomb friction that differs between the two directions.")  # fmt: skip
    if odds <= -TOLD:
        return Outcome(Action.WARM_UP, "sensor_offset", True, f"{text}: it is an offset of the sensor.")
    return Outcome(Action.WARM_UP, "", False, f"{text}: that tells neither from the other. {again}")


def _frictions(warm: Sequence[Difference], joint: int) -> tuple[FloatArray, FloatArray, float]:
    """(K, 3) change of the offset, Nm, of Coulomb, Nm, and of viscous friction, Nm s/rad, and covariance (K, 3, K, 3);
    variance of the offset in the cold recording, Nm².

    Rows of K differences share the noise of the recording that they are taken from.
    """
    before, count = warm[0].before, len(warm)
    columns = friction_columns(before.motion.velocity, before.motion.coulomb_velocity, joint)
    own = np.stack([item.own_noise[:, joint] ** 2 for item in warm], axis=1)
    shared = warm[0].noise[:, joint] ** 2 - own[:, 0]
    factor = np.linalg.cholesky(own[:, :, None] * np.eye(count) + shared[:, None, None])
    white = np.linalg.inv(factor)
    rows = warm[0].project(columns)
    matrix = (white[:, :, :, None] * rows[:, None, None, :]).reshape(-1, count * rows.shape[1])
    measured = (white @ np.stack([item.rows[:, joint] for item in warm], axis=1)[..., None]).ravel()
    covariance = np.linalg.inv(matrix.T @ matrix)
    change = covariance @ (matrix.T @ measured)
    left = measured - matrix @ change
    covariance = covariance * max(1.0, float(left @ left) / (measured.size - change.size))
    shape = count, rows.shape[1]
    of_cold = np.linalg.inv((rows / shared[:, None]).T @ rows)
    return change.reshape(shape), np.asarray(covariance.reshape(*shape, *shape)), float(of_cold[0, 0])


def friction_columns(velocity: FloatArray, coulomb_velocity: Widths, joint: int) -> FloatArray:
    """(S, 3) of one joint (from 0): constant, direction as Coulomb friction has it, speed. velocity: (S, n)."""
    speed = velocity[:, joint]
    return np.stack([np.ones_like(speed), direction_of(velocity, coulomb_velocity)[:, joint], speed], axis=1)


def _log_normal(distance: FloatArray, covariance: FloatArray) -> float:
    """But for a constant that the number of values alone decides."""
    return -0.5 * float(distance @ np.linalg.solve(covariance, distance) + np.linalg.slogdet(covariance)[1])
