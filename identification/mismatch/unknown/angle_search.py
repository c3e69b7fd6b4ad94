"""Whether the angle of a joint is off: one hypothesis per joint and input.

Each is put beside the classes that the joints hold and beside none. The best is asked with classes chosen anew, and
stands where the whole is worth what a class costs more than without it. Asked only where the noise is measured.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cholesky, lapack, solve_triangular

from identification.arrays import FloatArray
from identification.mismatch.effects.joint_zero_offset import LARGEST_RAD
from identification.mismatch.settings import ALTERNATIVE, PRIOR_COST
from identification.mismatch.unknown.angle import ANGLES, SMALLEST_RAD, AngleBasis
from identification.mismatch.unknown.evidence import ABSENT, FREE, Shared, largest_gain
from identification.mismatch.unknown.rows import Rows, worth_asking
from identification.mismatch.unknown.selection import FEW_ROUNDS, FULL_ROUNDS, Selection

DEVIATIONS_RAD = np.geomspace(1e-6, LARGEST_RAD, 16)
"""Deviations that an angle is tried with before it is put in."""

Angle = tuple[str, int]
"""Name in ANGLES and joint (from 0)."""


@dataclass(frozen=True, slots=True)
class HeldAngle:
    """An angle that is off, with nats lost without it, and others that are as good in its place."""

    angle: Angle
    loss: float
    alternatives: tuple[Angle, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class _Hypothesis:
    """columns: of each of the bases, (n, R, m) Nm; whitened: the same over the noise."""

    angle: Angle
    bases: tuple[AngleBasis, ...]
    columns: tuple[FloatArray, ...]
    whitened: tuple[FloatArray, ...]


def worth(selection: Selection) -> float:
    """Nats of the whole hypothesis, comparable between different numbers of angles."""
    rows = selection.rows
    columns = sum(item.functions for item in rows.angles)
    return selection.total() + 0.5 * columns * float(np.log(FREE)) - PRIOR_COST * len(_held(rows))


def _held(rows: Rows) -> set[Angle]:
    return {(item.name, item.joint) for item in rows.angles}


def with_angles(
    selection: Selection, every: Rows, chosen_on: Callable[[Rows], Selection]
) -> tuple[Selection, tuple[HeldAngle, ...]]:
    """The selection, or one that holds angles besides where that is worth it; and these.

    every: the rows without what was put in one by one. chosen_on: puts the classes on rows.
    """
    if not every.problem.noise_is_measured:
        return selection, ()
    # Each joint alone may hold no more than noise; narrow functions take most of the time.
    narrow = int(worth_asking(every.problem, every.band).sum()) > 1
    known, held = _hypotheses(every, narrow=narrow), list[HeldAngle]()
    while True:
        plain, now = Selection.nominal(every, every.parts), worth(selection)
        free = [item for item in known if item.angle not in _held(every)]
        beside = [max(_gains(selection, item))[0] for item in free]
        each = [_gains(plain, item) for item in free]
        alone = [max(gains)[0] for gains in each]
        # Worth asking: what gains beside the classes, and what alone gains what these do.
        least = now - worth(plain)
        asked = {max(range(len(free)), key=gain.__getitem__) for gain in (beside, alone)} if free else set()
        asked = {place for place in asked if beside[place] > PRIOR_COST or alone[place] > least}
        options = []
        for place in asked:
            # Each group as large as explains most alone.
            sizes = [size for _, size in each[place]]
            rows = every.with_angle(free[place].bases, free[place].columns, sizes)
            option = settled_angles(chosen_on(rows))
            options.append((worth(option), free[place].angle, option, rows))
        if not options:
            return selection, tuple(held)
        best = max(options, key=lambda item: item[0])
        if best[0] <= now + PRIOR_COST:
            return selection, tuple(held)
        near = tuple(item[1] for item in options if item is not best and item[0] > best[0] - ALTERNATIVE)
        held.append(HeldAngle(best[1], best[0] + PRIOR_COST - now, near))
        selection, every = best[2], replace(best[3], prior=best[2].rows.prior)


def _hypotheses(rows: Rows, *, narrow: bool) -> list[_Hypothesis]:
    """One for each joint that turns and each input. narrow: with the groups behind the first."""
    found = []
    for joint in np.flatnonzero(rows.inputs[0].motion.robot.kinematics.revolute).tolist():
        for name, (_, groups) in ANGLES.items():
            parts = [AngleBasis.of(name, group, joint, rows.inputs) for group in range(len(groups) if narrow else 1)]
            bases = tuple(item for item in parts if item is not None)
            if not bases:
                continue
            columns = tuple(columns_of(rows, item) for item in bases)
            whitened = tuple(part * rows.problem.weight[..., None] for part in columns)
            found.append(_Hypothesis((name, joint), bases, columns, whitened))
    return found


def columns_of(rows: Rows, basis: AngleBasis) -> FloatArray:
    """(n, R, m) Nm of each unit weight on all joints."""
    pairs = zip(rows.evidences, rows.inputs, strict=True)
    parts = [np.stack([item.project(torque) for torque in basis.torque(inputs)]) for item, inputs in pairs]
    return np.concatenate(parts, axis=1)


def _gains(selection: Selection, hypothesis: _Hypothesis) -> list[tuple[float, float]]:
    """Nats that each group alone would gain with the best of its deviations, and that, rad, all else as it is."""
    return [_gain(selection, part) for part in hypothesis.whitened]


def _gain(selection: Selection, columns: FloatArray) -> tuple[float, float]:
    """Nats and deviation (rad) of one group, (n, R, m) whitened."""
    rows, size = selection.rows, columns.shape[2]
    inner, rest = np.zeros((size, size)), np.zeros((size, rows.prior.size + 1))
    for joint, state in enumerate(selection.states):
        own, weighted = rows.joints[joint], columns[joint] / state.hyper.noise[rows.band][:, None]
        inner += columns[joint].T @ weighted
        rest += weighted.T @ own.whitened[:, own.columns :]
        if state.groups:
            across = own.whitened[:, selection.columns(joint, state)].T @ weighted
            half = solve_triangular(state.part.factor, state.part.root[:, None] * across, lower=True)
            inner -= half.T @ half
            rest -= half.T @ state.part.solved
    shared = Shared.of([state.part for state in selection.states], rows.prior)
    solved = np.linalg.solve(shared.precision, np.column_stack([rest[:, :-1].T, shared.target]))
    visible, target = inner - rest[:, :-1] @ solved[:, :-1], rest[:, -1] - rest[:, :-1] @ solved[:, -1]
    gains = [largest_gain(visible, target, np.array([value**2])) for value in DEVIATIONS_RAD]
    best = int(np.argmax(gains))
    return gains[best], float(DEVIATIONS_RAD[best])


def settled_angles(selection: Selection) -> Selection:
    """With the variances of angles by some rounds of the fixed point, classes as they are; then these anew."""
    rows = selection.rows
    if not rows.angles:
        return selection
    for _ in range(2):
        parts, prior = [state.part for state in selection.states], selection.rows.prior.copy()
        for _ in range(FULL_ROUNDS):
            shared = Shared.of(parts, prior)
            inverse = lapack.dtrtri(cholesky(shared.precision, lower=True, check_finite=False), lower=1)[0]
            spread, weights = (inverse**2).sum(axis=0), inverse.T @ (inverse @ shared.target)
            for own in rows.angle_columns:
                determined = weights[own].size - float(spread[own] @ prior[own])
                square = float(weights[own] @ weights[own]) / max(determined, 1e-3)
                prior[own] = 1.0 / np.clip(square, SMALLEST_RAD**2, LARGEST_RAD**2)
        selection = replace(selection, rows=replace(selection.rows, prior=prior), states=list(selection.states))
        for joint, state in enumerate(selection.states):
            selection.states[joint] = selection.settled(joint, state, FEW_ROUNDS)
    return selection


def angle_of(selection: Selection, angles: Sequence[Angle]) -> tuple[list[slice], FloatArray, FloatArray]:
    """Where in F some angles stand, their weights (m,) and their covariance (m, m), all rows of the selection seen."""
    places = [
        own
        for item, own in zip(selection.rows.angles, selection.rows.angle_columns, strict=True)
        if (item.name, item.joint) in angles
    ]
    now = selection.posterior(0, selection.states[0])
    first = now.covariance.shape[0] - now.base.size
    chosen = np.concatenate([np.arange(own.start, own.stop) for own in places])
    return places, now.base[chosen], now.covariance[np.ix_(first + chosen, first + chosen)]


def without_angles(selection: Selection, angles: Sequence[Angle]) -> Selection:
    """A selection without some angles, the joints estimated anew."""
    prior = selection.rows.prior.copy()
    for own in angle_of(selection, angles)[0]:
        prior[own] *= ABSENT
    rest = replace(selection, rows=replace(selection.rows, prior=prior), states=list(selection.states))
    for joint, state in enumerate(rest.states):
        rest.states[joint] = rest.settled(joint, state, FULL_ROUNDS)
    return rest
