"""What is said of an angle that is off: by what, how much, what torque that makes and where, its curve in radians."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.problem import Problem, off
from identification.mismatch.search.library import EffectRows
from identification.mismatch.settings import CAPTURE
from identification.mismatch.unknown.angle import ANGLES
from identification.mismatch.unknown.angle_search import Angle, HeldAngle, angle_of, without_angles
from identification.mismatch.unknown.claims import AngleCurve, ClassClaim
from identification.mismatch.unknown.dependence import Dependence
from identification.mismatch.unknown.evidence import FREE
from identification.mismatch.unknown.forms import CURVE_POINTS, nearest_forms, on_unseen_rows, size_of_weights
from identification.mismatch.unknown.inputs import Along
from identification.mismatch.unknown.selection import Selection


def angle_claim(
    found: Dependence, item: HeldAngle, before: FloatArray, problem: Problem, candidates: Sequence[EffectRows]
) -> ClassClaim:
    """problem, candidates: of the fitted rows. before: (n,) Nm that the fit leaves of the held-out rows."""
    alone, (name, joint) = found.alone, item.angle
    places, weights, covariance = angle_of(alone, [item.angle])
    here = alone.rows.part < alone.rows.folds
    columns = [
        np.concatenate([rows.whitened[here][:, rows.columns : -1][:, own] for own in places], axis=1)
        for rows in alone.rows.joints
    ]
    torque = np.stack([part @ weights for part in columns])
    shown = np.sqrt((off(problem.basis, torque.ravel()).reshape(torque.shape) ** 2).sum(axis=1))
    most, joints = int(shown.argmax()), np.flatnonzero(shown > CAPTURE * shown.max(initial=0.0))
    rms, interval = _size(alone, columns, most, weights, covariance)
    forms = nearest_forms(problem, candidates, joint, torque)
    curve = _curve(found, item.angle, weights, covariance)
    gain = _gain(found, item.angle, before)
    others = tuple(dict.fromkeys(other for other, place in item.alternatives if place == joint))
    sentence = _sentence(item, curve, rms, interval, most, joints.tolist())
    if gain.size:
        sentence += on_unseen_rows(float(gain[most]), float(found.after[1][most]), "that joint's RMS")
    shows_on = tuple((joints + 1).tolist())
    return ClassClaim(
        name, joint + 1, rms, interval, item.loss, gain, others, forms, sentence, curve, angle=True, shows_on=shows_on
    )


def _size(
    alone: Selection, columns: Sequence[FloatArray], joint: int, weights: FloatArray, covariance: FloatArray
) -> tuple[float, tuple[float, float]]:
    """RMS in Nm on one joint (from 0) of what base parameters cannot take up, on the fitted rows, with its interval.

    columns: of all joints, whitened (R, m): base parameters take up the torque of all of them together.
    """
    rows = alone.rows
    here = rows.part < rows.folds
    base = [item.whitened[here][:, item.columns : item.columns + rows.base] for item in rows.joints]
    information = np.sum([part.T @ part for part in base], axis=0) + FREE * np.eye(rows.base)
    taken = np.linalg.solve(information, sum(part.T @ own for part, own in zip(base, columns, strict=True)))
    visible = (columns[joint] - base[joint] @ taken) * rows.problem.noise[joint, here][:, None]
    return size_of_weights(visible.T @ visible / rows.samples[0], weights, covariance)


def _curve(found: Dependence, angle: Angle, weights: FloatArray, covariance: FloatArray) -> AngleCurve:
    rows, (name, joint) = found.alone.rows, angle
    coordinate = ANGLES[name][0]
    running = Along(rows.inputs[0], rows.fitted, joint, coordinate, CURVE_POINTS)
    bases = [item for item in rows.angles if (item.name, item.joint) == angle]
    columns = np.concatenate([item.displacement(running) for item in bases], axis=1)
    std = np.sqrt(np.maximum(np.einsum("sm,mk,sk->s", columns, covariance, columns), 0.0))
    return AngleCurve(coordinate, "rad" if coordinate == "position" else "Nm", running.place, columns @ weights, std)


def _gain(found: Dependence, angle: Angle, before: FloatArray) -> FloatArray:
    """(n,) Nm that an angle takes off the RMS of held-out rows; empty without any."""
    alone = found.alone
    if not alone.rows.heldout:
        return np.zeros(0)
    rest = without_angles(alone, [angle])
    return np.asarray(np.minimum(found.left(rest)[1], before) - found.after[1])


def _sentence(
    item: HeldAngle,
    curve: AngleCurve,
    rms: float,
    interval: tuple[float, float],
    most: int,
    joints: Sequence[int],
) -> str:
    words, joint = item.angle[0].replace("_", " "), item.angle[1] + 1
    span = float(np.ptp(curve.mean_rad))
    where = ", ".join(str(number + 1) for number in joints)
    text = (
        f"Joint {joint}: its true angle is not the measured one, it differs by a function of its {words}, "
        f"{span:.2g} rad from the least to the most, as of a gear that yields or runs untrue. That makes {rms:.2g} Nm "
        f"RMS ({interval[0]:.2g} to {interval[1]:.2g}) on joint {most + 1} beyond what the base parameters take up"
    )
    text += f", and shows on joints {where}." if len(joints) > 1 else "."
    if item.alternatives:
        listed = " or ".join(f"the {name.replace('_', ' ')} of joint {place + 1}" for name, place in item.alternatives)
        text += f" These data cannot tell it from {listed}."
    return text
