"""Evidences of one role, fitted or held out, what changes between their periods, and their torque without that.

What the search, the claims and the summary are given.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from identification.arrays import FloatArray
from identification.base_parameters import BaseRegressor
from identification.fitting.settings import Split
from identification.mismatch.changes.between_periods import Change, find_between_periods
from identification.mismatch.effects import EFFECTS
from identification.mismatch.evidence import Evidence, fit_parameters, with_parameters
from identification.mismatch.problem import Problem, build_problem
from identification.mismatch.reduction import build_evidence
from identification.mismatch.search.library import Library
from identification.mismatch.settings import DiagnosisSettings
from identification.recordings.recording import Recording
from identification.robots import RobotModel


@dataclass(frozen=True, slots=True, eq=False)
class Prepared:
    """evidences: one per stretch. changes: what differs between their periods. torque: (R, n) Nm each, without that."""

    evidences: tuple[Evidence, ...]
    changes: tuple[Change, ...]
    torque: tuple[FloatArray, ...]

    @property
    def nuisance(self) -> list[tuple[int, FloatArray]]:
        """Columns of the changes, kept free in the mean: (evidence, (R, n, m))."""
        return [(change.evidence, change.mean_columns) for change in self.changes]

    def library(self) -> Library:
        """All effects on these evidences; a new one, which remembers the rows it is asked for."""
        return Library(EFFECTS, self.evidences)

    def problem(self) -> Problem:
        """The rows of the evidences, columns of changes between periods kept free."""
        return build_problem(self.evidences, self.torque, self.nuisance)

    def with_change(self, change: Change) -> Prepared:
        """The same with one change more."""
        torque = list(self.torque)
        torque[change.evidence] = torque[change.evidence] - change.contribution.mean(axis=0)
        return replace(self, changes=(*self.changes, change), torque=tuple(torque))

    def renewal(self, regressor: BaseRegressor, library: Library) -> Callable[[FloatArray], Library]:
        """The library seen from other base parameters (and whatever stands behind them), for the search."""

        def renewed(values: FloatArray) -> Library:
            base = values[: regressor.size]
            return library.seen_from(tuple(with_parameters(item, regressor, base) for item in self.evidences))

        return renewed


def prepare(
    recordings: Sequence[Recording],
    robot: RobotModel,
    regressor: BaseRegressor,
    settings: DiagnosisSettings,
    split: Split | None,
    values: FloatArray | None = None,
) -> Prepared:
    """values: base parameters whose torque the effects see; with them the rows are those that the split holds out.

    None: the rows to fit, and the parameters that fit them all together. Raises RecordingError for a recording that
    cannot be used.
    """
    evidences = [
        part
        for recording in recordings
        for part in build_evidence(recording, robot, regressor, settings, split, held_out=values is not None)
    ]
    if values is None and len(evidences) > 1:
        values = fit_parameters(evidences)
    if values is not None:
        evidences = [with_parameters(evidence, regressor, values) for evidence in evidences]
    return _prepared(evidences, find_between_periods(evidences, EFFECTS))


def without_changes(prepared: Prepared, number: int, instead: Sequence[Change]) -> Prepared:
    """The same with other changes in one evidence. instead: found in that evidence alone."""
    kept = [change for change in prepared.changes if change.evidence != number]
    found = [*kept, *(replace(change, evidence=number) for change in instead)]
    return _prepared(prepared.evidences, sorted(found, key=lambda change: -change.gain))


def _prepared(evidences: Sequence[Evidence], changes: Sequence[Change]) -> Prepared:
    torque = [evidence.torque.copy() for evidence in evidences]
    for change in changes:
        torque[change.evidence] -= change.contribution.mean(axis=0)
    return Prepared(tuple(evidences), tuple(changes), tuple(torque))
