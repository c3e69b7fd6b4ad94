"""The next motion: the one after which the truth stands out most probably, of purposeful and random ones, improved.

A random search with a fixed number of trials, so that the same seed gives the same motion on every machine. Here: the
search. Not here: whether the arm may drive it; the caller asks that of the best ones in order.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import softmax

from identification.arrays import FloatArray
from identification.base_parameters import BaseRegressor
from identification.investigation.added_mass import AddedMass
from identification.investigation.columns import Form, NoiseLevel, Sums, Whitened, form_rows, planned, sums_of
from identification.investigation.discrepancy import Discrepancies
from identification.investigation.equivalences import Equivalence, inseparable
from identification.investigation.experiments import PERIOD_S, Experiment, Room, experiments, varied
from identification.investigation.forecast import Forecast, forecast
from identification.investigation.hypotheses import Assessment
from identification.investigation.separation import Layout, beside_names, separations, special_cases
from identification.mismatch.evidence import Evidence, PlannedRows

TRIALS, IMPROVEMENTS = 48, 96
KEPT = 4
"""Best trials that are improved."""
HANDED_ON, ALIKE = 8, 2
"""Motions handed to the preflight in their order, and how many of one kind and joint: what one meets, its like meet."""
PERIODS = (4, 8, 16)
"""How often a motion is repeated: noise is measured from four periods on. Also what is left, where it is little."""
ENOUGH = 0.95


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """One motion with what it would tell."""

    experiment: Experiment
    periods: int
    forecast: Forecast

    @property
    def seconds(self) -> float:
        """Length of the recorded motion."""
        return self.periods * PERIOD_S


@dataclass(frozen=True, slots=True, eq=False)
class Design:
    """choices: motions, the best first. equivalences: hypotheses that none of all motions tried tells apart."""

    choices: tuple[Choice, ...]
    equivalences: tuple[Equivalence, ...]


@dataclass(frozen=True, eq=False)
class Chooser:
    """Everything a forecast needs: hypotheses alive, what is recorded, how new rows come about. Not slotted: caches.

    over_all: whether free functions go over the ranges of all motions, the new one among them, as they do once it is
    recorded; else they begin anew where it leaves the recorded ones, which asks for no product of recorded rows.
    """

    assessment: Assessment
    regressor: BaseRegressor
    values: FloatArray
    known: tuple[Form, ...]
    layout: Layout
    noise: NoiseLevel
    mass: AddedMass | None = None
    over_all: bool = False

    @classmethod
    def of(
        cls,
        assessment: Assessment,
        evidences: Sequence[Evidence],
        regressor: BaseRegressor,
        values: FloatArray,
        known: Sequence[Form] = (),
        mass: AddedMass | None = None,
    ) -> Chooser:
        """evidences: those that were assessed, with their own noise. values: base parameters (p,) fitted to them.

        mass: on the flange when the next motion is driven.
        """
        layout = Layout.of(assessment.alive)
        pairs = zip(evidences, assessment.evidences, strict=True)
        longest, inflated = max(pairs, key=lambda pair: pair[0].periods)
        noise = NoiseLevel.of(longest, inflated)
        return cls(assessment, regressor, values, tuple(known), layout, noise, mass)

    @cached_property
    def thorough(self) -> Chooser:
        """The same with every shape of the hypotheses' grids, and free functions over what all motions reach: slower,
        for what is promised. The diagnosis that a forecast is held against gives a rival the shape that suits it best.
        """
        return replace(self, layout=Layout.of(self.assessment.alive, None), over_all=True)

    @cached_property
    def recorded(self) -> Sums:
        """All recordings as one body of evidence."""
        first, *others = (item.sums(self.assessment.discrepancies) for item in self._whitened)
        return sum(others, start=first)

    @cached_property
    def _whitened(self) -> tuple[Whitened, ...]:
        return tuple(Whitened.of(item, self.layout.forms) for item in self.assessment.evidences)

    @cached_property
    def _wider(self) -> dict[Experiment, tuple[Discrepancies, Sums]]:
        """Of each motion asked for: free functions over the ranges of all motions, and the recordings with them."""
        return {}

    def rows(self, experiment: Experiment, periods: int) -> PlannedRows:
        """Rows of a motion: settled findings among the nominal columns, misfit without a name among the noise."""
        like = self.assessment.evidences[0].motion
        rows = planned(experiment.states, PERIOD_S, like, self.regressor, self.values, self.noise, periods)
        if self.mass is not None:
            rows = replace(rows, motion=self.mass.carried(rows.motion))
        if not self.known:
            return rows
        nominal = np.concatenate([rows.nominal, *(form_rows(rows, form) for form in self.known)], axis=2)
        return PlannedRows(rows.motion, rows.project, nominal, rows.noise)

    def foretell(self, experiment: Experiment, periods: int) -> Forecast:
        """What a motion would tell, in addition to all recordings."""
        alive, beside = self.assessment.alive, self.assessment.discrepancies
        rows, recorded = self.rows(experiment, periods), self.recorded
        if self.over_all:
            if experiment not in self._wider:
                wider = beside.over([*(item.motion for item in self.assessment.evidences), rows.motion])
                classes = zip(*(item.classes(wider) for item in self._whitened), strict=True)
                self._wider[experiment] = wider, replace(recorded, classes=tuple(sum(own) for own in classes))
            beside, recorded = self._wider[experiment]
        after = recorded + sums_of(rows, self.layout.forms, beside=beside)
        told = separations(after, self.layout, alive, beside)
        told[special_cases(after, self.layout, alive)] = np.inf
        return forecast(alive, self.separated, told, (self.shown_beside, beside_names(after, alive, beside)))

    @cached_property
    def separated(self) -> FloatArray:
        """(H, H) λ of the pairs on what is recorded."""
        return separations(self.recorded, self.layout, self.assessment.alive, self.assessment.discrepancies)

    @cached_property
    def shown_beside(self) -> FloatArray:
        """(H,) λ of the classes beside each hypothesis on what is recorded."""
        return beside_names(self.recorded, self.assessment.alive, self.assessment.discrepancies)

    def choose(
        self,
        random: np.random.Generator,
        room: Room,
        seconds_left: float,
        progress: Callable[[float], None] | None = None,
    ) -> Design:
        """The best motions of at most seconds_left; none where none fits into the time.

        others: motions to weigh beside those that are drawn (the shipped ones).
        """
        possible = lengths(seconds_left)
        if not possible:
            return Design((), ())
        stream = experiments(random, room, self._joints())
        best_gain = np.zeros_like(self.separated)
        count = 0

        def valued(experiment: Experiment) -> tuple[float, Experiment]:
            nonlocal count
            found = self.foretell(experiment, possible[0])
            np.maximum(best_gain, found.gain, out=best_gain)
            count += 1
            if progress is not None:
                progress(count / (TRIALS + IMPROVEMENTS))
            return self._value(found), experiment

        tried = [valued(next(stream)) for _ in range(TRIALS)]
        for number in range(IMPROVEMENTS):
            best = _best(tried)[:KEPT]
            tried.append(valued(varied(random, room, best[number % len(best)], 0.5 * 0.97**number)))
        ordered: list[Experiment] = []
        for one in _best(tried):
            alike = [other for other in ordered if (other.kind, other.joint) == (one.kind, one.joint)]
            if len(alike) < ALIKE and len(ordered) < HANDED_ON:
                ordered.append(one)
        choices = self._promised(ordered, possible[0])
        periods = self.thorough._enough(choices[0].experiment, possible)
        if periods != possible[0]:
            choices = self._promised(ordered, periods)
        alive = self.assessment.alive
        pairs = inseparable(alive, self.separated + best_gain)
        return Design(tuple(choices), tuple(Equivalence.of(alive[i], alive[j]) for i, j in pairs))

    def _value(self, found: Forecast) -> float:
        """Chance of a name, and where that is none or all, how many nats are gained where they are fewest.

        Were nothing there that has a name, no motion would be better than another: forms count as if one were true.
        """
        alive = self.assessment.alive
        # From the log odds: beside a large error of the model every probability of a form is 0 in floating point.
        odds = np.array([-np.inf if item.without_name else item.log_odds for item in alive])
        weights = softmax(odds) if np.isfinite(odds).any() else np.zeros(len(odds))
        off = ~np.eye(len(weights), dtype=bool)
        least = np.where(off, found.gain, np.inf).min(axis=1)
        chance = found.probability + found.named
        return chance + 0.05 * float(weights @ np.log1p(np.minimum(least, 1e6)))

    def _promised(self, motions: Sequence[Experiment], periods: int) -> list[Choice]:
        """What each motion would tell by every shape of the hypotheses, the best first."""
        choices = [Choice(one, periods, self.thorough.foretell(one, periods)) for one in motions]
        return sorted(choices, key=lambda choice: -self._value(choice.forecast))

    def _enough(self, experiment: Experiment, possible: Sequence[int]) -> int:
        """As many periods as are enough; few where none are: after them the next motion is chosen better."""
        for periods in possible:
            if self.foretell(experiment, periods).named >= ENOUGH:
                return periods
        return possible[0]

    def _joints(self) -> list[int]:
        """Joints, from 0, of the hypotheses that are alive, the most probable first; all where none has a joint."""
        named = [item.place.joint - 1 for item in self.assessment.alive if item.place.joint is not None]
        return list(dict.fromkeys(named))[:3] or list(range(self.assessment.evidences[0].n))


def lengths(seconds_left: float) -> tuple[int, ...]:
    """Numbers of periods to choose from: after each of them time is left for another motion, or none at all."""
    most = int(seconds_left / PERIOD_S + 1e-9)
    found = [count for count in PERIODS if count + PERIODS[0] <= most]
    return (*found, most) if PERIODS[0] <= most < PERIODS[-1] + PERIODS[0] else tuple(found)


def _best(tried: Sequence[tuple[float, Experiment]]) -> list[Experiment]:
    return [one for _, one in sorted(tried, key=lambda entry: -entry[0])]
