"""The state of all joints, some classes on each: variances, weights, and what the whole is worth.

Here: estimates and their evidence. Not here: which classes are tried (`choice`).

Where the noise is measured, hypotheses are compared by their evidence. Where it is not, rows of one kind are no proof
for each other, and they are compared by how well each stretch of time is predicted from the others (the chain rule with
every stretch last in turn).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from identification.arrays import FloatArray, IntArray
from identification.mismatch.settings import PRIOR_COST, VARIANCE_CAP
from identification.mismatch.unknown.classes import CLASSES, Basis
from identification.mismatch.unknown.evidence import (
    LEAST_NOISE,
    Hyper,
    JointGram,
    Marginal,
    Posterior,
    Shared,
    beside,
    largest_gain,
    log_prior,
    loss_without,
    marginal,
    mean,
    posterior,
    settled_variance,
    squares_of,
    updated,
)
from identification.mismatch.unknown.rows import Rows

FULL_ROUNDS, FEW_ROUNDS = 8, 3
"""Rounds of the fixed point with all classes of a joint, and after a change."""
START = 0.1
"""Share of a joint's misfit that each group is given to begin with."""
GRID = 12
"""Variances that a class is tried with before it is put in."""


@dataclass(frozen=True, slots=True)
class Held:
    """A class that stands on a joint (from 0), with nats lost without it and the classes as good in its place."""

    number: int
    joint: int
    loss: float
    alternatives: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class JointState:
    """One joint with the classes that it holds. groups: numbers of its groups in `JointRows.bases`.

    gram, part: of all rows that are fitted. grams, elsewhere: the same of other worlds, as far as they were asked for;
    states of the same groups share the former.
    """

    groups: tuple[int, ...]
    gram: JointGram
    hyper: Hyper
    part: Marginal
    elsewhere: dict[int, Marginal] = field(default_factory=dict)
    grams: dict[int, JointGram] = field(default_factory=dict)


@dataclass(slots=True, eq=False)
class Selection:
    """The state of all joints while classes are put in and taken out.

    worlds: sets of parts whose evidence counts; the first holds all, and is what variances are estimated on. signs:
    how often each counts. predicted: the noise of a joint is what is left of stretches of time that are predicted from
    the others, the same in all bands.
    """

    rows: Rows
    worlds: tuple[tuple[JointGram, ...], ...]
    signs: tuple[float, ...]
    states: list[JointState] = field(default_factory=list)
    held: list[Held] = field(default_factory=list)
    banned: frozenset[int] = frozenset()
    predicted: bool = False

    @classmethod
    def nominal(cls, rows: Rows, parts: Sequence[int], *, predicted: bool = False) -> Selection:
        """No class on any joint, noise as the rows have it: the least squares of the nominal model.

        Its rows are these, with products of each part and band where they are weighed by band and lack them.
        """
        predicted = predicted and not rows.problem.noise_is_measured and len(parts) > 1
        rows = rows if predicted or rows.by_band else rows.resolved()

        def of(chosen: Sequence[int]) -> tuple[JointGram, ...]:
            grams = rows.of(chosen)
            return tuple(gram.one_band() for gram in grams) if predicted else grams

        total = of(parts)
        worlds, signs = [total], [1.0]
        if not rows.problem.noise_is_measured and len(parts) > 1:
            worlds += [tuple(whole.less(own) for whole, own in zip(total, of([part]), strict=True)) for part in parts]
            signs = [float(len(parts)), *(-1.0 for _ in parts)]
        result = cls(rows, tuple(worlds), tuple(signs), predicted=predicted)
        start = np.ones(total[0].count.size)
        result.states = [result.state(joint, (), Hyper(np.zeros(0), start)) for joint in range(rows.problem.n)]
        return result

    @classmethod
    def of(cls, rows: Rows, parts: Sequence[int], *, predicted: bool = False) -> Selection:
        """No class on any joint; noise estimated."""
        result = cls.nominal(rows, parts, predicted=predicted)
        for _ in range(FULL_ROUNDS):
            for joint in range(rows.problem.n):
                result.states[joint] = result.settled(joint, result.states[joint], 1)
        return result

    def state(self, joint: int, groups: tuple[int, ...], hyper: Hyper) -> JointState:
        """A joint with some groups under given variances."""
        gram = self.worlds[0][joint].only(groups)
        return JointState(groups, gram, hyper, marginal(gram, hyper))

    def with_group(self, joint: int, basis: Basis, columns: FloatArray) -> Selection:
        """A copy whose rows have one group more on a joint, (R, m) whitened, which no state holds yet."""
        rows = self.rows.with_group(joint, basis, columns)
        grams = list(self.worlds[0])
        grams[joint] = rows.of_joint(joint, rows.parts)
        return replace(self, rows=rows, worlds=(tuple(grams),), states=list(self.states), held=list(self.held))

    def with_state(self, joint: int, state: JointState) -> Selection:
        """A copy with another state of one joint."""
        states = list(self.states)
        states[joint] = state
        return replace(self, states=states, held=[])

    def part(self, joint: int, state: JointState, world: int) -> Marginal:
        """A joint's rows of one world under a state."""
        if world == 0:
            return state.part
        if world not in state.elsewhere:
            state.elsewhere[world] = marginal(self._gram(joint, state, world), state.hyper)
        return state.elsewhere[world]

    def _gram(self, joint: int, state: JointState, world: int) -> JointGram:
        if world not in state.grams:
            state.grams[world] = self.worlds[world][joint].only(state.groups)
        return state.grams[world]

    def others(self, joint: int, world: int) -> Shared:
        """All joints but one."""
        parts = [self.part(number, state, world) for number, state in enumerate(self.states) if number != joint]
        return Shared.of(parts, self.rows.prior)

    def settled(self, joint: int, state: JointState, rounds: int, quiet: int = 0) -> JointState:
        """A joint after some rounds of the fixed point, the other joints as they are.

        quiet: rounds before them in which the noise is held: a class that is new would find its torque taken for noise.
        """
        beside = self.others(joint, 0)
        cap = VARIANCE_CAP * max(float(self.rows.misfit[joint]), 1e-24)
        hyper, part = state.hyper, state.part
        if quiet and state.groups:
            hyper = replace(hyper, variance=settled_variance(state.gram, hyper, beside, cap, quiet))
            part = marginal(state.gram, hyper)
        for _ in range(rounds):
            now = posterior(state.gram, part, beside.plus(part))
            new = updated(state.gram, hyper, now, cap, self.rows.noise_rows, self.rows.noise_odds)
            hyper = replace(new, noise=hyper.noise) if self.predicted else new
            part = marginal(state.gram, hyper)
        if self.predicted:
            hyper = replace(hyper, noise=np.full_like(hyper.noise, self._predicted_noise(joint, state, hyper)))
            part = marginal(state.gram, hyper)
        return JointState(state.groups, state.gram, hyper, part, grams=state.grams)

    def _predicted_noise(self, joint: int, state: JointState, hyper: Hyper) -> float:
        """Mean square of what each stretch of a joint's rows leaves that is predicted from the others.

        Columns that describe every fitted row leave nothing of these, whatever they are worth elsewhere.
        """
        squares, count = 0.0, 0.0
        for world in range(1, len(self.worlds)):
            others = self._gram(joint, state, world)
            part = marginal(others, hyper)
            shared = self.others(joint, world).plus(part)
            more, rows = squares_of(state.gram.less(others), part, shared, hyper.noise)
            squares, count = squares + more, count + rows
        return max(squares / max(count, 1.0), LEAST_NOISE)

    def score(self, joint: int, state: JointState) -> float:
        """Nats of the whole hypothesis with this joint in this state, the prior cost of its classes taken off."""
        evidence = sum(
            sign * self.others(joint, world).plus(self.part(joint, state, world)).log_evidence
            for world, sign in enumerate(self.signs)
        )
        prior = log_prior(state.hyper.noise, self.rows.noise_rows, self.rows.noise_odds)
        return evidence + prior - PRIOR_COST * len(self.classes(joint, state))

    def total(self) -> float:
        """Nats of the whole hypothesis, the prior cost of all classes taken off."""
        joints = range(len(self.states))
        evidence = sum(
            sign * Shared.of(
                [self.part(joint, self.states[joint], world) for joint in joints], self.rows.prior
            ).log_evidence
            for world, sign in enumerate(self.signs)
        )  # fmt: skip
        prior = sum(log_prior(state.hyper.noise, self.rows.noise_rows, self.rows.noise_odds) for state in self.states)
        count = sum(len(self.classes(joint, self.states[joint])) for joint in joints)
        return evidence + prior - PRIOR_COST * count

    def classes(self, joint: int, state: JointState) -> dict[int, list[int]]:
        """Number of each class that a state holds, with the positions of its groups in the state."""
        found: dict[int, list[int]] = {}
        for position, group in enumerate(state.groups):
            found.setdefault(self.rows.joints[joint].bases[group].number, []).append(position)
        return found

    def families(self, joint: int, state: JointState) -> dict[int, list[int]]:
        """Number of each class that a state holds, with those that are part of it there (`DependenceClass.within`)."""
        present = self.classes(joint, state)
        number_of = {CLASSES[number].name: number for number in present}
        found: dict[int, list[int]] = {}
        for number in present:
            found.setdefault(number_of.get(CLASSES[number].within, number), []).append(number)
        return found

    def columns(self, joint: int, state: JointState, places: Sequence[int] | None = None) -> IntArray:
        """Columns of B in the order of a state's weights, of all its groups or of those at some places."""
        chosen = state.groups if places is None else [state.groups[place] for place in places]
        found = [np.flatnonzero(self.rows.joints[joint].group == group) for group in chosen]
        return np.concatenate([np.zeros(0, dtype=np.int64), *found])

    def mean(self, joint: int, state: JointState) -> tuple[FloatArray, FloatArray]:
        """Weights (m,) of a joint under a state, and base parameters (p,)."""
        return mean(state.part, self.others(joint, 0).plus(state.part))[:2]

    def posterior(self, joint: int, state: JointState) -> Posterior:
        """Weights of a joint under a state."""
        return posterior(state.gram, state.part, self.others(joint, 0).plus(state.part))

    def losses(
        self, joint: int, state: JointState, families: Mapping[int, Sequence[int]] | None = None
    ) -> dict[int, float]:
        """Nats that the evidence falls without each class of a state or each family of them, all else as it is.

        families: classes of each, by the number that it goes by. A claim counts the families of `Selection.families`.
        """
        if not state.groups:
            return {}
        now, held = self.posterior(joint, state), self.classes(joint, state)
        parts = {number: (number,) for number in held} if families is None else families
        return {
            number: loss_without(state.gram, state.hyper, now, [place for part in family for place in held[part]])
            for number, family in parts.items()
        }

    def without(self, joint: int, state: JointState, numbers: Sequence[int]) -> JointState:
        """A state without some classes, not yet estimated anew."""
        bases = self.rows.joints[joint].bases
        kept = [place for place, group in enumerate(state.groups) if bases[group].number not in numbers]
        # Of the state's own products: all those of a joint are many times as large.
        hyper, gram = Hyper(state.hyper.variance[kept], state.hyper.noise), state.gram.only(kept)
        return JointState(tuple(state.groups[place] for place in kept), gram, hyper, marginal(gram, hyper))

    def with_class(self, joint: int, state: JointState, number: int) -> JointState:
        """A state with all groups of a class, not yet estimated anew."""
        bases = self.rows.joints[joint].bases
        return self.with_added(joint, state, [group for group, basis in enumerate(bases) if basis.number == number])

    def with_added(self, joint: int, state: JointState, groups: Sequence[int]) -> JointState:
        """A state with those of some groups that it does not hold, not yet estimated anew."""
        added = tuple(group for group in groups if group not in state.groups)
        start = np.full(len(added), self._start(joint))
        hyper = Hyper(np.concatenate([state.hyper.variance, start]), state.hyper.noise)
        return self.state(joint, (*state.groups, *added), hyper)

    def asks(self, joint: int) -> bool:
        """Whether a class that a joint does not hold might gain more than it costs.

        On a joint without any the noise is the measured one, or what takes it for noise would hide the class.
        """
        state = self.states[joint]
        if not state.groups and self.rows.noise_rows:
            state = self.state(joint, (), Hyper(state.hyper.variance, np.ones_like(state.hyper.noise)))
        return max(self.gains(joint, state).values(), default=0.0) > PRIOR_COST

    def gains(self, joint: int, state: JointState) -> dict[int, float]:
        """Nats that each absent class would gain, its variance the best of a grid, all else as it is."""
        gram = self.worlds[0][joint]
        held = self.columns(joint, state)
        absent = np.setdiff1d(np.arange(gram.columns), held)
        if not absent.size:
            return {}
        bases = self.rows.joints[joint].bases
        number_of = np.array([bases[group].number for group in gram.group[absent]])
        kinds = {int(number): absent[number_of == number] for number in np.unique(number_of)}
        ordered = np.concatenate(list(kinds.values()))
        total = np.tensordot(1.0 / state.hyper.noise, gram.gram, axes=1)
        visible = [total[own[:, None], own] for own in kinds.values()]
        products = visible, total[held[:, None], ordered], total[ordered][:, gram.columns :]
        gains = zip(kinds, self.gains_of(joint, state, *products), strict=True)
        return {number: gain for number, gain in gains if number not in self.banned}

    def gains_of(
        self, joint: int, state: JointState, visible: Sequence[FloatArray], held: FloatArray, rest: FloatArray
    ) -> list[float]:
        """Nats that absent columns of each kind would gain, their products as `beside` takes them."""
        variances = float(self.rows.misfit[joint]) * np.geomspace(1e-3, VARIANCE_CAP, GRID)
        shared = self.others(joint, 0).plus(state.part)
        return [largest_gain(*own, variances) for own in beside(visible, held, rest, state.part, shared)]

    def with_groups(self, chosen: Sequence[Sequence[int]]) -> Selection:
        """A copy whose joints hold some groups each, with variances and weights of their own."""
        result = replace(self, states=list(self.states), held=[])
        for turn in range(2):
            for joint, groups in enumerate(chosen):
                if self.rows.asked[joint]:
                    state = result.states[joint] if turn else self.unsettled(joint, groups)
                    result.states[joint] = result.settled(joint, state, FULL_ROUNDS, quiet=0 if turn else FULL_ROUNDS)
        return result

    def unsettled(self, joint: int, groups: Sequence[int]) -> JointState:
        """A joint with some groups, not yet estimated, the noise as measured where it is."""
        noise = self.states[joint].hyper.noise
        start = np.full(len(groups), self._start(joint))
        return self.state(joint, tuple(groups), Hyper(start, np.ones_like(noise) if self.rows.noise_rows else noise))

    def _start(self, joint: int) -> float:
        """Nm², the variance that a new group begins with."""
        return START * max(float(self.rows.misfit[joint]), 1e-24)

    def full(self, joint: int) -> JointState:
        """A joint with all classes that its rows hold, not yet estimated."""
        return self.unsettled(joint, range(len(self.rows.joints[joint].bases)))
