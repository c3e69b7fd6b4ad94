"""Whether a name is earned: odds over the best model without it but with all classes, capture, invariance.

A name's columns stand beside the base parameters, common to all joints, its size known beforehand to the order of what
was found. Without it the classes of its joints are chosen anew: a name that they explain better falls. A class that a
name describes completely is no rival of it.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc

from identification.arrays import FloatArray, IntArray
from identification.mismatch.problem import Problem, off
from identification.mismatch.search.library import Library
from identification.mismatch.search.refinement import Member
from identification.mismatch.settings import ALTERNATIVE, CAPTURE, DIFFERENT, LEAST_SHOWN, MOST, PRIOR_COST, SPEAK
from identification.mismatch.unknown.angle_search import Angle, settled_angles, worth
from identification.mismatch.unknown.choice import eliminated
from identification.mismatch.unknown.classes import CLASSES
from identification.mismatch.unknown.evidence import ABSENT
from identification.mismatch.unknown.rows import Rows
from identification.mismatch.unknown.selection import FULL_ROUNDS, JointState, Selection


@dataclass(frozen=True, slots=True, eq=False)
class Named:
    """A name as all rows see it. columns: (n, R, k) Nm per unit. size: (k,) units found. cost: nats of its choice."""

    effect: str
    joints: tuple[int, ...]
    columns: FloatArray
    size: FloatArray
    cost: float

    @property
    def described(self) -> frozenset[int]:
        """Numbers of the classes that the name describes."""
        return frozenset(number for number, kind in enumerate(CLASSES) if self.effect in kind.described)


@dataclass(frozen=True, slots=True)
class Standing:
    """Of one name. odds: nats over the best model without it. rivals: classes that could carry most of it.

    shown: λ, the name's energy off the base parameters over the noise. kept: most nats that a rival which lost half of
    them to the name keeps. beside: classes that the name's joints hold once it is in, with their nats. agree: chance
    that its coefficients differ so much between fitted and held-out rows; 1 without any. earned: whether it stands.
    weak: whether it would, but that another torque, which shares all of λ but `capture`, would cost fewer nats than two
    classes have to differ by: it may as well be that other one, whoever wrote it.
    """

    odds: float
    shown: float
    rivals: tuple[str, ...]
    kept: float
    beside: Mapping[str, float]
    agree: float
    earned: bool
    weak: bool


def named(member: Member, size: FloatArray, elsewhere: Library | None, rows: Rows) -> Named:
    """A member of the model on the rows of both roles. size: its coefficients; elsewhere: library of the held-out."""
    there = None if elsewhere is None else elsewhere.rows(member.effect, member.place, member.rows.shape)
    count = int((rows.part < rows.folds).sum())
    columns = np.zeros((rows.problem.n, rows.problem.rows, size.size))
    columns[list(member.rows.joints), :count] = member.rows.rows
    if there is not None:
        columns[list(there.joints), count:] = there.rows
    return Named(member.effect.name, shown_on(rows.problem, columns @ size), columns, size, member.rows.cost)


def shown_on(problem: Problem, torque: FloatArray) -> tuple[int, ...]:
    """Joints (from 0) that a torque (n, R) Nm acts on, and of what shows there more than a tenth of the most.

    What shows is what the base parameters leave, over the noise: they take most of what a zero offset does to the
    weight of the arm, and where most of its torque is least of it may show.
    """
    white = problem.whitened(torque[..., None], range(problem.n))
    visible = off(problem.basis, white.ravel()).reshape(torque.shape)
    rms = np.sqrt((visible**2).sum(axis=1)) * torque.any(axis=1)
    return tuple(np.flatnonzero(rms > CAPTURE * rms.max(initial=0.0)).tolist())


def standings(
    every: Rows, names: Sequence[Named], asked: Sequence[int], chosen: Sequence[Sequence[int]]
) -> dict[int, Standing]:
    """Those names that are asked, by their number, each beside all others. chosen: as in `_together`."""
    if not asked:
        return {}
    wholes = _together(every, names, chosen)
    behind = np.cumsum([0, *(name.size.size for name in reversed(names))])[::-1]
    return {index: _standing(wholes, names[index], int(behind[index + 1])) for index in asked}


def held_beside(every: Rows, names: Sequence[Named], chosen: Sequence[Sequence[int]]) -> dict[int, frozenset[str]]:
    """Joint (from 0) → the particular classes, and the angles (`of_angle`), that it holds once all the names are in.

    Where the noise is measured they are chosen anew; else they are what is left of the groups that were chosen without
    names, as on rows of an unknown noise another choice says little. There a class may stand by the prediction of
    stretches and weigh less than SPEAK here: gone is what also weighs less than half of what it does without the names.
    """
    angles, before = set[Angle](), list[dict[int, float]]()
    if every.problem.noise_is_measured:
        wholes = _together(every, names, chosen)
        whole = max(wholes, key=worth)
        if worth(whole) >= worth(wholes[-1]) - PRIOR_COST + SPEAK:
            angles = {(item.name, item.joint) for item in whole.rows.angles}
    else:
        bare, whole = (
            Selection.of(rows, rows.parts, predicted=True).with_groups(chosen)
            for rows in (every, every.with_columns([(name.columns, name.size) for name in names]))
        )
        before = _losses(bare)
    found = {
        joint: frozenset(
            CLASSES[number].within or CLASSES[number].name
            for number, loss in losses.items()
            if loss >= (min(SPEAK, MOST * before[joint][number]) if before else SPEAK)
            and not CLASSES[number].background
        )
        for joint, losses in enumerate(_losses(whole))
        if every.asked[joint]
    }
    for name, joint in angles:
        found[joint] = found.get(joint, frozenset()) | {of_angle(name)}
    return found


def _losses(whole: Selection) -> list[dict[int, float]]:
    """Nats lost without each family of classes of each joint."""
    return [whole.losses(joint, state, whole.families(joint, state)) for joint, state in enumerate(whole.states)]


def of_angle(name: str) -> str:
    """What the angle of a joint is off by, told from a torque of the same class."""
    return f"{name} of the angle"


def _together(every: Rows, names: Sequence[Named], chosen: Sequence[Sequence[int]]) -> list[Selection]:
    """All names and classes beside them, with the angles that are off, where any is, and without; the latter last."""
    found = [_with_classes(every, names, chosen)]
    if every.angles:
        found = [settled_angles(found[0]), _with_classes(every.without_angles(), names, [()] * len(chosen))]
    return found


def _with_classes(every: Rows, names: Sequence[Named], chosen: Sequence[Sequence[int]]) -> Selection:
    """All names, and the classes that the joints hold beside them, chosen anew on those that a name shows on.

    chosen: groups of each joint's classes without names.
    """
    rows = every.with_columns([(name.columns, name.size) for name in names])
    whole = Selection.of(rows, rows.parts)
    rows = whole.rows
    shown = {joint for name in names for joint in name.joints}
    for joint in range(rows.problem.n):
        if not rows.asked[joint] or not whole.asks(joint):
            continue
        if joint in shown or not chosen[joint]:
            whole.states[joint] = eliminated(whole, joint)
        else:
            whole.states[joint] = whole.settled(joint, whole.unsettled(joint, chosen[joint]), FULL_ROUNDS, FULL_ROUNDS)
    return whole


def _own(selection: Selection, name: Named, behind: int) -> IntArray:
    """Where in F the columns of a name stand."""
    end = selection.rows.prior.size - behind
    return np.arange(end - name.size.size, end)


def _with_and_without(whole: Selection, name: Named, behind: int) -> tuple[Selection, Selection]:
    """The best that there is with a name and without it."""
    prior = whole.rows.prior.copy()
    prior[_own(whole, name, behind)] *= ABSENT
    rest = Selection(replace(whole.rows, prior=prior), whole.worlds, whole.signs, list(whole.states))
    for joint in name.joints:
        if whole.rows.asked[joint]:
            held = whole.states[joint]
            rest.states[joint] = eliminated(rest, joint, name.described)
            whole = _taken_over(whole, joint, rest.states[joint])
            rest = _taken_over(rest, joint, rest.without(joint, held, sorted(name.described)))
    return whole, settled_angles(rest)


def _standing(wholes: Sequence[Selection], name: Named, behind: int) -> Standing:
    """wholes: as `_together` gives them. behind: columns in F behind those of the name."""
    best = max(wholes, key=worth)
    whole, rest = _with_and_without(best, name, behind)
    if worth(whole) - worth(rest) - PRIOR_COST - name.cost >= ALTERNATIVE:
        # A name that is not worth it here is worth no more beside another best model without it.
        pairs = [(whole, rest), *(_with_and_without(each, name, behind) for each in wholes if each is not best)]
        whole, rest = (max(options, key=worth) for options in zip(*pairs, strict=True))
    own, without = _own(whole, name, behind), _own(rest, name, behind)
    odds = worth(whole) - worth(rest) - PRIOR_COST - name.cost
    base = whole.posterior(0, whole.states[0])
    size = base.base[own]
    rivals, kept, beside, particular = [], 0.0, dict[str, float](), 0.0

    def torque_of(joint: int) -> FloatArray:
        rows = whole.rows.joints[joint]
        return np.asarray(rows.whitened[:, rows.columns + own] @ size)

    for joint in name.joints:
        losses, left = (side.losses(joint, side.states[joint]) for side in (rest, whole))
        for number, loss in left.items():
            beside[CLASSES[number].name] = max(loss, beside.get(CLASSES[number].name, 0.0))
            particular = particular if CLASSES[number].background else max(loss, particular)
        for number, loss in losses.items():
            if loss < SPEAK or _carried(rest, joint, number, torque_of(joint), without) < MOST:
                continue
            rivals.append(CLASSES[number].name)
            # One that is missed as much with the name as without it is other physics on the same joint.
            if left.get(number, 0.0) <= MOST * loss:
                kept = max(kept, left.get(number, 0.0))
    if not whole.rows.angles or odds < ALTERNATIVE:
        rivals += [of_angle(item.name) for item in rest.rows.angles]
    agree = _agreement(whole, own)
    # A function of unknown form has a mean of its own: a constant beside one is part of it.
    part = particular >= SPEAK and any(CLASSES[number].name == "constant" for number in name.described)
    shown, unnamed = energies(whole, name.joints, own, size)
    clear = shown >= LEAST_SHOWN
    stands = (
        odds >= (SPEAK if _unnamed(whole) else ALTERNATIVE)
        # A name that shows less than the classes beside it may be what their functions fail to describe.
        and shown >= unnamed
        and kept <= odds
        and agree >= DIFFERENT
        and not part
    )
    different = tuple(dict.fromkeys(rivals))
    return Standing(odds, shown, different, kept, beside, agree, earned=stands and clear, weak=stands and not clear)


def _taken_over(selection: Selection, joint: int, state: JointState) -> Selection:
    """With the classes that another hypothesis holds on a joint, where they weigh more than those chosen for this one.

    Classes go one at a time, the least missed first: what stays need not be the best there is.
    """
    option = selection.settled(joint, selection.state(joint, state.groups, state.hyper), FULL_ROUNDS)
    better = selection.score(joint, option) > selection.score(joint, selection.states[joint])
    return selection.with_state(joint, option) if better else selection


def _unnamed(whole: Selection) -> bool:
    """Whether torque of no known form is beside the names on any joint: odds are then only as good as its functions."""
    if whole.rows.angles:
        return True
    found = (whole.losses(joint, state).values() for joint, state in enumerate(whole.states))
    return any(loss >= SPEAK for losses in found for loss in losses)


def energies(whole: Selection, joints: Collection[int], own: IntArray, size: FloatArray) -> tuple[float, float]:
    """λ of a name, and of all classes of its joints together beside it, off the base parameters. own: its columns.

    Of the name on all joints: base parameters take up its torque of all of them together.
    """
    problem = whole.rows.problem
    named, unnamed = np.zeros((2, problem.n, problem.rows))
    for joint, (rows, state) in enumerate(zip(whole.rows.joints, whole.states, strict=True)):
        named[joint] = rows.whitened[:, rows.columns + own] @ size
        weights, base = whole.mean(joint, state)
        if joint in joints:
            unnamed[joint] = rows.whitened[:, whole.columns(joint, state)] @ weights
            for place in whole.rows.angle_columns:
                unnamed[joint] += rows.whitened[:, rows.columns : -1][:, place] @ base[place]
    left = off(problem.basis, np.column_stack([named.ravel(), unnamed.ravel()]))
    shown, beside = (left**2).sum(axis=0).tolist()
    return shown, beside


def _carried(rest: Selection, joint: int, number: int, torque: FloatArray, own: IntArray) -> float:
    """Share of a name's whitened torque (R,) on a joint that one class can carry beside the base parameters."""
    state: JointState = rest.states[joint]
    places = rest.classes(joint, state)[number]
    rows = rest.rows.joints[joint]
    base = np.delete(rows.whitened[:, rows.columns : -1], own, axis=1)
    columns = np.concatenate([rows.whitened[:, rest.columns(joint, state, places)], base], axis=1)
    left = torque - columns @ np.linalg.lstsq(columns, torque, rcond=1e-9)[0]
    plain = torque - base @ np.linalg.lstsq(base, torque, rcond=1e-9)[0]
    return 1.0 - float(left @ left) / max(float(plain @ plain), 1e-300)


def _agreement(whole: Selection, own: IntArray) -> float:
    """Chance that coefficients from the fitted and the held-out rows alone, beside the same classes, differ so much."""
    if not whole.rows.heldout:
        return 1.0
    rows = whole.rows.limited([state.groups for state in whole.states], heldout=True)
    estimates = []
    for parts in (range(rows.folds), range(rows.folds, len(rows.parts))):
        side = Selection(rows, (rows.of(list(parts)),), (1.0,))
        for joint, state in enumerate(whole.states):
            places = tuple(sorted(state.groups).index(group) for group in state.groups)
            side.states.append(side.state(joint, places, state.hyper))
        now = side.posterior(0, side.states[0])
        place = now.covariance.shape[0] - now.base.size + own
        estimates.append((now.base[own], now.covariance[np.ix_(place, place)]))
    (first, spread), (second, other) = estimates
    change = first - second
    distance = float(change @ np.linalg.solve(spread + other, change))
    return float(chdtrc(change.size, distance))
