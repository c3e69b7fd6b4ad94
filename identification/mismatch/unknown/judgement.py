"""The answer without forms: which classes each joint's torque depends on beside the nominal model, and what they bring.

Classes are chosen on fitted and held-out rows together; sizes, curves and held-out figures come from weights and
variances of the fitted rows alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.claims import Claims
from identification.mismatch.prepared import Prepared
from identification.mismatch.problem import Problem
from identification.mismatch.search.detection import band_power
from identification.mismatch.search.extension import torque_beside
from identification.mismatch.search.library import EffectRows
from identification.mismatch.settings import ROWS_TELL, SPEAK, UNLIKELY
from identification.mismatch.unknown.angle_claims import angle_claim
from identification.mismatch.unknown.claims import ClassClaim, ClassCurve, ClassModel, NearestForm, Offer
from identification.mismatch.unknown.classes import CLASSES
from identification.mismatch.unknown.dependence import Dependence, beside_names
from identification.mismatch.unknown.evidence import FREE
from identification.mismatch.unknown.forms import CURVE_POINTS, nearest_forms, on_unseen_rows, size_of_weights
from identification.mismatch.unknown.inputs import Along
from identification.mismatch.unknown.left import shortened
from identification.mismatch.unknown.named import of_angle
from identification.mismatch.unknown.offer import offer, refusal
from identification.mismatch.unknown.predictive import LEAST_CHANGE
from identification.mismatch.unknown.rows import Rows
from identification.mismatch.unknown.selection import Held, JointState, Selection


@dataclass(frozen=True, slots=True, eq=False)
class Judgement:
    """claims: what is said of classes. model: what all that stands, said or not, is worth. offer: for `model.json`.
    notes: torque without a name that is not part of it.
    """

    claims: tuple[ClassClaim, ...]
    model: ClassModel
    offer: Offer | None
    notes: tuple[str, ...]


def judge(
    found: Dependence,
    fitted: Prepared,
    unseen: Prepared | None,
    names: Claims,
    problem: Problem,
    candidates: Sequence[EffectRows],
) -> Judgement:
    """Classes of what the nominal model leaves, and what the model gains by classes beside the names that stand.

    problem, candidates: of the fitted rows, to find the nearest forms.
    """
    offered: Offer | None = None
    left_out = found.dropped
    if unseen is not None and names.heldout_after is not None:
        beside = found.alone
        if names.extension.members:
            torque = [torque_beside(names.extension, item.library(), item.torque) for item in (fitted, unseen)]
            beside = beside_names(found, torque)
        offered, more = offer(beside, found.left, names.heldout_after, names.extension.problem.weight)
        left_out += more
    before = np.zeros(0) if names.heldout_before is None else names.heldout_before.rms_nm
    gain = cache(partial(_gain, found, before))
    heard = [item for item in found.held if item.loss >= SPEAK]
    standing = {item: weight for item in heard if (weight := _weight(found, item, gain)) > 0.0}
    smooth = [item for item in standing if CLASSES[item.number].background]
    # A smooth error that other joints show may have any form on this one, that of a class too.
    needed = max((standing[item] for item in smooth), default=0.0)
    chosen = sorted((item for item in standing if standing[item] >= needed), key=lambda item: -standing[item])
    claims = _claims(found, chosen, gain, problem, candidates)
    asked = (item for item in found.angles if item.loss >= max(SPEAK, needed))
    angles = [angle_claim(found, item, before, problem, candidates) for item in asked]
    claims = sorted([*claims, *angles], key=lambda claim: -claim.significance) if angles else claims
    least = _least_torque(found, problem)
    claims = [claim for claim in claims if claim.interval_nm[0] > least[claim.joint - 1]]
    if problem.noise_is_measured and not smooth:
        said = {joint - 1 for claim in claims for joint in (claim.joint, *claim.shows_on)}
        beyond = np.maximum(names.power.probability.min(axis=1), _chance_beside_classes(found, problem)) < UNLIKELY
        claims += [_somewhere(names, problem, joint) for joint in np.flatnonzero(beyond).tolist() if joint not in said]
    claims = [_with_names(claim, names) for claim in claims]
    model = ClassModel(names.before.rms_nm, found.after[0], before, found.after[1])
    notes = [refusal(left_out)] if left_out else []
    if smooth:
        notes.append(_background([item.joint + 1 for item in smooth]))
    return Judgement(tuple(claims), model, offered, tuple(notes))


def _least_torque(found: Dependence, problem: Problem) -> FloatArray:
    """(n,) Nm RMS that a class has to have on the fitted rows: what may as well be nothing is no finding, nor is what
    rows of an unknown noise do not tell.
    """
    if problem.noise_is_measured:
        return np.zeros(problem.n)
    torque = problem.torque.reshape(problem.weight.shape) * problem.noise
    return np.asarray(ROWS_TELL * np.sqrt((torque**2).sum(axis=1) / found.alone.rows.samples[0]))


def _chance_beside_classes(found: Dependence, problem: Problem) -> FloatArray:
    """(n,) least chance, over the bands, that what the classes leave of the fitted rows is noise.

    Torque without a name on one joint bends the base parameters, and without its class shows on others too.
    """
    left = found.left.of_rows(found.alone)[0] * problem.weight
    return np.asarray(band_power(problem, left.ravel()).probability.min(axis=1))


def _gain(found: Dependence, before: FloatArray, item: Held) -> FloatArray:
    """(n,) Nm that a class takes off the RMS of held-out rows; empty without any. before: (n,) Nm of the fit.

    Without it the others may be worth less than nothing: then nothing of them would stay.
    """
    alone, joint = found.alone, item.joint
    if not alone.rows.heldout:
        return np.zeros(0)
    family = alone.families(joint, alone.states[joint])[item.number]
    without = found.left(shortened(alone, joint, family))[1]
    return np.asarray(np.minimum(without, before) - found.after[1])


def _weight(found: Dependence, item: Held, gain: Callable[[Held], FloatArray]) -> float:
    """Nats; where the noise is not known the logarithm of how many times larger the joint's held-out RMS is without it.

    Fitted rows of an unknown noise are no proof for each other. What predicts other rows worse weighs nothing, nor does
    what changes that RMS by no more than base parameters of another joint's terms may. What may stand in the model
    beside the names is another question (`offer`): a class that shows need not be usable on another motion.
    """
    if found.every.problem.noise_is_measured or not found.every.heldout:
        return item.loss
    if (item.joint, item.number) in found.dropped:
        return 0.0
    share = gain(item)[item.joint] / found.after[1][item.joint]
    return float(np.log1p(share)) if share >= LEAST_CHANGE else 0.0


def _claims(
    found: Dependence,
    chosen: Sequence[Held],
    gain: Callable[[Held], FloatArray],
    problem: Problem,
    candidates: Sequence[EffectRows],
) -> list[ClassClaim]:
    """What of some classes may be said, in their order."""
    alone, claims = found.alone, []
    for item in chosen:
        state = alone.states[item.joint]
        if any(CLASSES[number].background for number in (item.number, *item.alternatives)):
            # What a smooth background describes as well is nothing particular.
            continue
        if CLASSES[item.number].name == "constant" and len(alone.classes(item.joint, state)) > 1:
            # Part of whatever else the joint's torque depends on.
            continue
        taken, after = gain(item), found.after[1]
        unseen = on_unseen_rows(taken[item.joint], after[item.joint], "the joint's RMS") if taken.size else ""
        claims.append(_claim(alone.rows, alone, item, state, taken, unseen, problem, candidates))
    return claims


def _with_names(claim: ClassClaim, names: Claims) -> ClassClaim:
    """A claim that knows whether the names leave any of it; torque on one joint may come from a name on another."""
    if claim.name == "broadband" or not names.trial.members:
        return claim
    left = names.beside.get(claim.joint - 1, frozenset())
    same = {of_angle(claim.name)} if claim.angle else {claim.name, *claim.alternatives}
    return replace(claim, named=not left & same)


def _background(joints: Sequence[int]) -> str:
    """What is said where a smooth function of the state explains most of what is left. joints: from 1."""
    named = ", ".join(map(str, sorted(joints)))
    return (
        f"Joint{'s' if len(joints) > 1 else ''} {named}: what the model leaves is a smooth function of the state. "
        "Only what stands out from it is named."
    )


def _somewhere(names: Claims, problem: Problem, joint: int) -> ClassClaim:
    """Where something is left on a joint (from 0) that repeats with the motion and that no class and no name takes."""
    power, left = names.power, names.after
    energy, deviation = left.excess_energy[joint], left.excess_deviation[joint]
    rms, low, high = (float(np.sqrt(max(energy + sign * 1.96 * deviation, 0.0))) for sign in (0.0, -1.0, 1.0))
    bands = np.flatnonzero(power.probability[joint] < UNLIKELY)
    ranges = [problem.frequency[problem.band == band] for band in bands]
    places = " and ".join(f"{values.min():.2g} to {values.max():.2g} Hz" for values in ranges)
    sentence = (
        f"Joint {joint + 1}: {rms:.2g} Nm RMS ({low:.2g} to {high:.2g}) beyond the noise between "
        f"{places}, which repeat with the motion and depend on nothing that was asked."
    )
    nats = -float(np.log(max(float(power.probability[joint].min()), 1e-300)))
    return ClassClaim("broadband", joint + 1, rms, (low, high), nats, np.zeros(0), (), (), sentence, None)


def _claim(
    rows: Rows,
    alone: Selection,
    item: Held,
    state: JointState,
    gain: FloatArray,
    unseen: str,
    problem: Problem,
    candidates: Sequence[EffectRows],
) -> ClassClaim:
    """unseen: what is said of held-out rows."""
    joint, kind = item.joint, CLASSES[item.number]
    now = alone.posterior(joint, state)
    held = alone.classes(joint, state)
    places = sorted(place for number in alone.families(joint, state)[item.number] for place in held[number])
    within = np.flatnonzero(np.isin(state.gram.group, places))
    weights, covariance = now.weights[within], now.covariance[within[:, None], within]
    here = rows.part < rows.folds
    columns = rows.joints[joint].whitened[here][:, alone.columns(joint, state, places)]
    rms, interval = _size(rows, joint, columns, weights, covariance)
    torque = np.zeros((problem.n, problem.rows))
    torque[joint] = columns @ weights
    forms = nearest_forms(problem, candidates, joint, torque)
    if kind.name == "constant":
        forms = (NearestForm("torque_offset", 1.0),)
    name = kind.within or kind.name
    others = (CLASSES[other] for other in item.alternatives)
    alternatives = tuple(dict.fromkeys(other.name for other in others if not other.within and other.name != name))
    curve = _curve(rows, item, state, places, weights, covariance)
    sentence = _sentence(kind.words, item, rms, interval, alternatives, forms) + unseen
    return ClassClaim(name, joint + 1, rms, interval, item.loss, gain, alternatives, forms, sentence, curve)


def _size(
    rows: Rows, joint: int, columns: FloatArray, weights: FloatArray, covariance: FloatArray
) -> tuple[float, tuple[float, float]]:
    """RMS in Nm of the part that base parameters cannot take up, on the fitted rows, and its 95 % interval."""
    here = rows.part < rows.folds
    base = [item.whitened[here][:, item.columns : item.columns + rows.base] for item in rows.joints]
    information = np.sum([part.T @ part for part in base], axis=0) + FREE * np.eye(base[0].shape[1])
    taken = np.linalg.solve(information, base[joint].T @ columns)
    visible = (columns - base[joint] @ taken) * rows.problem.noise[joint, here][:, None]
    square = visible.T @ visible / rows.samples[0]
    return size_of_weights(square, weights, covariance)


def _curve(
    rows: Rows, item: Held, state: JointState, places: Sequence[int], weights: FloatArray, covariance: FloatArray
) -> ClassCurve | None:
    """Mean and deviation over the class's own variable, moving in the positive direction; None without one."""
    kind, joint = CLASSES[item.number], item.joint
    if not kind.coordinate:
        return None
    running = Along(rows.inputs[0], rows.fitted, joint, kind.coordinate, CURVE_POINTS)
    own, parts, hidden = rows.joints[joint], [], np.zeros(CURVE_POINTS)
    for number in places:
        functions = own.bases[state.groups[number]].columns(running)
        parts.append(functions @ own.shown[state.groups[number]])
        # What no row shows is as it was beforehand.
        hidden += state.hyper.variance[number] * ((functions**2).sum(axis=1) - (parts[-1] ** 2).sum(axis=1))
    columns = np.concatenate(parts, axis=1)
    std = np.sqrt(np.maximum(np.einsum("sm,mk,sk->s", columns, covariance, columns) + hidden, 0.0))
    revolute = bool(rows.inputs[0].motion.robot.kinematics.revolute[joint])
    units = {"position": ("rad", "m"), "velocity": ("rad/s", "m/s")}.get(kind.coordinate, ("Nm", "N"))
    return ClassCurve(kind.coordinate, units[0 if revolute else 1], running.place, columns @ weights, std)


def _sentence(
    words: str,
    item: Held,
    rms: float,
    interval: tuple[float, float],
    alternatives: Sequence[str],
    forms: Sequence[NearestForm],
) -> str:
    text = (
        f"Joint {item.joint + 1}: a torque that {words}, {rms:.2g} Nm RMS ({interval[0]:.2g} to {interval[1]:.2g}) "
        "beyond what the base parameters take up."
    )
    if alternatives:
        text += f" These data cannot tell it from {' or '.join(name.replace('_', ' ') for name in alternatives)}."
    if forms:
        text += f" Nearest form: {forms[0].effect.replace('_', ' ')}, {100 * forms[0].share:.0f} % of it."
    return text
