"""The next motion: the one after which the truth stands out most probably, of purposeful and random ones, improved.

A random search with a fixed number of trials, so that the same seed gives the same motion on every machine. Here: the
search. Not here: whether the arm may drive it; the caller asks that of the best ones in order.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from identification.base_parameters import BaseRegressor
from identification.investigation.added_mass import AddedMass
from identification.investigation.columns import Form, NoiseLevel, Sums, form_rows, planned, sums_of
from identification.investigation.equivalences import Equivalence, action_for, inseparable
from identification.investigation.experiments import PERIOD_S, Experiment, Room, experiments, varied
from identification.investigation.forecast import Forecast, forecast
from identification.investigation.hypotheses import Assessment, Hypothesis
from identification.investigation.separation import Layout, separations
from identification.mismatch.detectability import PlannedRows
from identification.mismatch.evidence import Evidence

FloatArray = npt.NDArray[np.float64]

TRIALS, IMPROVEMENTS = 48, 24
KEPT = 4
"""Best trials that are improved, and motions handed to the preflight in their order."""
PERIODS = (4, 8, 16)
"""How often a motion may be repeated: noise is measured from four periods on."""
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
    """Everything a forecast needs: hypotheses alive, what is recorded, how new rows come about. Not slotted: caches."""

    assessment: Assessment
    regressor: BaseRegressor
    values: FloatArray
    known: tuple[Form, ...]
    layout: Layout
    recorded: Sums
    noise: NoiseLevel
    mass: AddedMass | None = None

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
        beside = assessment.discrepancies
        parts = [sums_of(item, layout.forms, beside=beside) for item in assessment.evidences]
        recorded = parts[0]
        for part in parts[1:]:
            recorded = recorded + part
        pairs = zip(evidences, assessment.evidences, strict=True)
        longest, inflated = max(pairs, key=lambda pair: pair[0].periods)
        noise = NoiseLevel.of(longest, inflated)
        return cls(assessment, regressor, values, tuple(known), layout, recorded, noise, mass)

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
        after = self.recorded + sums_of(self.rows(experiment, periods), self.layout.forms, beside=beside)
        return forecast(alive, self.separated, separations(after, self.layout, alive, beside))

    @cached_property
    def separated(self) -> FloatArray:
        """(H, H) λ of the pairs on what is recorded."""
        return separations(self.recorded, self.layout, self.assessment.alive, self.assessment.discrepancies)

    def choose(
        self,
        random: np.random.Generator,
        room: Room,
        seconds_left: float,
        others: Sequence[Experiment] = (),
        progress: Callable[[float], None] | None = None,
    ) -> Design:
        """The best motions of at most seconds_left; none where none fits into the time.

        others: motions to weigh beside those that are drawn (the shipped ones).
        """
        possible = [count for count in PERIODS if count * PERIOD_S <= seconds_left]
        if not possible:
            return Design((), ())
        stream = experiments(random, room, self._joints())
        tried: list[tuple[float, Experiment]] = []
        best_gain = np.zeros_like(self.separated)

        def look(experiment: Experiment) -> None:
            found = self.foretell(experiment, possible[0])
            np.maximum(best_gain, found.gain, out=best_gain)
            tried.append((self._value(found), experiment))
            if progress is not None:
                progress(len(tried) / (TRIALS + IMPROVEMENTS + len(others)))

        def ordered() -> list[Experiment]:
            return [one for _, one in sorted(tried, key=lambda entry: -entry[0])]

        for one in (*others, *(next(stream) for _ in range(TRIALS))):
            look(one)
        for number in range(IMPROVEMENTS):
            best = ordered()[:KEPT]
            look(varied(random, room, best[number % len(best)], 0.5 * 0.97**number))
        choices = tuple(self._repeated(one, possible) for one in ordered()[:KEPT])
        alive = self.assessment.alive
        pairs = inseparable(alive, self.separated + best_gain)
        return Design(choices, tuple(_equivalence(alive[i], alive[j]) for i, j in pairs))

    def _value(self, found: Forecast) -> float:
        """Probability to tell, and where that is none or all, how many nats are gained where they are fewest."""
        weights = np.array([item.probability for item in self.assessment.alive])
        off = ~np.eye(len(weights), dtype=bool)
        least = np.where(off, found.gain, np.inf).min(axis=1)
        return found.probability + 0.05 * float(weights @ np.log1p(np.minimum(least, 1e6)))

    def _repeated(self, experiment: Experiment, possible: Sequence[int]) -> Choice:
        """With as many periods as are enough."""
        for periods in possible:
            found = self.foretell(experiment, periods)
            if found.probability >= ENOUGH:
                break
        return Choice(experiment, periods, found)

    def _joints(self) -> list[int]:
        """Joints, from 0, of the hypotheses that are alive, the most probable first; all where none has a joint."""
        named = [item.place.joint - 1 for item in self.assessment.alive if item.place.joint is not None]
        return list(dict.fromkeys(named))[:3] or list(range(self.assessment.evidences[0].n))


def _equivalence(first: Hypothesis, second: Hypothesis) -> Equivalence:
    return Equivalence(first.name, second.name, action_for(first.effect or "", second.effect or ""))
