"""What changes from period to period: contrasts over the period index, never mixed with the mean of the periods.

The strongest candidate of all families is refined, claimed, and the space it lives in is closed before the next search:
all contrasts of its joint's constant torque (drift) or friction (thermal), all torque in its window (contact, and the
moment of a change of payload). What is left of an imperfectly shaped effect is thus not claimed a second time. At the
end all are fitted jointly, what the others explain is dropped, and a contact that comes back is one finding. It
comes before the mean is searched: what is found here also stands in the mean.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.changes.candidates import Candidate
from identification.mismatch.changes.contact_force import LACK_KNOTS
from identification.mismatch.changes.contact_search import find_contact, without_outliers
from identification.mismatch.changes.contrasts import Contrasts, Fit, solve
from identification.mismatch.changes.lasting import find_drift, find_payload, find_thermal
from identification.mismatch.changes.uncertainty import shape_covariance
from identification.mismatch.effects.base import CERTAIN, Effect, Estimate, Place
from identification.mismatch.effects.external_contact import ExternalContact
from identification.mismatch.effects.own_joint import joint_index
from identification.mismatch.effects.payload_change import PayloadChange
from identification.mismatch.effects.thermal_friction import ThermalFriction
from identification.mismatch.effects.torque_sensor_drift import TorqueSensorDrift
from identification.mismatch.evidence import Evidence
from identification.mismatch.findings import Alternative
from identification.mismatch.settings import UNLIKELY
from identification.recordings.recording import Recording
from identification.signals.outliers import FEWEST_PERIODS

MOST_CHANGES = 5
WINDOW_MARGIN_S = 0.1
BESIDE_FLAGGED_S = 0.5
"""A jolt rings on for about as long beside the rows that stand out of it."""


@dataclass(frozen=True, slots=True, eq=False)
class Change:
    """One effect that differs between the periods of one recording.

    evidence: position of the recording in the evidences searched. effect, estimate: what it is; columns are
    `effect.columns(motion, estimate.place, estimate.shape)` with `values_by_period`, times estimate.coefficients.
    gain: drop of the whitened squares of the contrasts. score: log-likelihood units, half the gain less what a search
    of this size gains on noise. log10_chance: log10 of the chance that noise does this anywhere in the search.
    contribution: (K, R, n) Nm rows of each period, to be subtracted; its mean over K is the part in the mean.
    mean_columns: (R, n, m) rows of the mean's columns; keep them free beside the base parameters when the mean is
    searched, as the mean says more on them than the contrasts do. alternatives: what else could stand in its place.
    """

    evidence: int
    effect: Effect
    estimate: Estimate
    gain: float
    score: float
    log10_chance: float
    contribution: FloatArray
    mean_columns: FloatArray
    alternatives: tuple[Alternative, ...] = ()


def with_level(mean_columns: FloatArray) -> FloatArray:
    """A drift's columns (R, n, m) of the mean and a constant on its joint: no contrast tells from where it started."""
    level = np.zeros_like(mean_columns[..., :1])
    level[0, mean_columns.any(axis=(0, 2))] = 1.0
    return np.concatenate([mean_columns, level], axis=2)


def find_between_periods(
    evidences: Sequence[Evidence], effects: Sequence[Effect], banned: frozenset[tuple[str, Place]] = frozenset()
) -> tuple[Change, ...]:
    """All changes in all recordings, strongest first; recordings with fewer than three periods have none.

    effects: those of the stage "between_periods" among them are searched. banned: names and places that are not asked.
    """
    changes: list[Change] = []
    for number, evidence in enumerate(evidences):
        if evidence.period_torque is not None and evidence.periods >= FEWEST_PERIODS:
            changes.extend(_search(number, evidence, effects, banned))
    return tuple(sorted(changes, key=lambda change: -change.gain))


def beside_flagged_rows(recording: Recording) -> list[tuple[float, float]]:
    """Spans (s from the first sample) around rows that the import left out as garbled, several of them close together.

    A jolt of which samples were left out would else be a push; one row alone is an outlier, and says nothing of those
    beside it. The rows are found as holes of the time stamps.
    """
    flagged = [(item.first_row, item.last_row) for item in recording.report.of_kind("garbled_rows")]
    if not flagged:
        return []
    since = recording.time - recording.time[0]
    missing = np.round(np.diff(recording.time) / recording.sampling_period_s - 1.0)
    holes = np.flatnonzero(missing > 0.0)
    row = holes + 1 + np.concatenate([[0.0], np.cumsum(missing[holes])[:-1]])
    ours = [any(first <= number + 1 <= last for first, last in flagged) for number in row]
    holes, rows = holes[ours], missing[holes[ours]]
    spans = [(float(since[at]) - BESIDE_FLAGGED_S, float(since[at + 1]) + BESIDE_FLAGGED_S) for at in holes]
    return [(low, high) for low, high in spans if rows[(since[holes] > low) & (since[holes] < high)].sum() > 1]


@dataclass(slots=True)
class _Closed:
    """What is explained already: joints of drift and of thermal friction (from 0), spans of contacts in s."""

    drift: set[int] = field(default_factory=set)
    thermal: set[int] = field(default_factory=set)
    spans: list[tuple[float, float]] = field(default_factory=list)


def _search(
    number: int, evidence: Evidence, effects: Sequence[Effect], banned: frozenset[tuple[str, Place]]
) -> list[Change]:
    contrasts = Contrasts(evidence)
    contrasts.z = whole = without_outliers(contrasts)
    period = evidence.motion.samples * evidence.motion.sampling_period_s
    # Of a jolt in one period the mean has a share too, which all others lack.
    time = evidence.recording.time
    length = float(time[-1] - time[0])
    ends = [(-BESIDE_FLAGGED_S, BESIDE_FLAGGED_S), (length - BESIDE_FLAGGED_S, length + BESIDE_FLAGGED_S)]
    closed = _Closed(
        drift={joint_index(place) for name, place in banned if name == TorqueSensorDrift.name},
        thermal={joint_index(place) for name, place in banned if name == ThermalFriction.name},
        spans=ends
        + [
            (low + shift * period, high + shift * period)
            for low, high in beside_flagged_rows(evidence.recording)
            for shift in range(-evidence.periods, evidence.periods + 1)
        ],
    )
    claimed: list[Candidate] = []
    bound = float(np.log10(UNLIKELY))
    while len(claimed) < MOST_CHANGES:
        found: list[Candidate] = []
        # A push is the costliest to look for: last, and only where it may explain more than what was found.
        for effect in sorted(effects, key=lambda effect: isinstance(effect, ExternalContact)):
            least = max((candidate.fit.gain for candidate in found), default=0.0)
            candidate = _candidate(contrasts, effect, closed, least)
            if (
                candidate is not None
                and candidate.log10_chance < bound
                and (candidate.effect.name, candidate.place) not in banned
            ):
                found.append(candidate)
        if not found:
            break
        best = max(found, key=lambda item: item.fit.gain - 2.0 * np.log(item.fit.rank + 1.0))
        claimed.append(best)
        contrasts.z = _close(contrasts, whole, claimed, closed)
    contrasts.z = whole
    claimed = _merge_contacts(contrasts, claimed)
    while claimed:
        fits = _joint_fit(contrasts, claimed)
        chances = [fit.log10_chance(candidate.tests) for fit, candidate in zip(fits, claimed, strict=True)]
        weakest = int(np.argmax(chances))
        if chances[weakest] <= bound:
            changes = [_change(number, contrasts, *pair) for pair in zip(claimed, fits, strict=True)]
            certainty = [change.effect.certainty(change.estimate) for change in changes]
            weakest = int(np.argmin(certainty))
            if certainty[weakest] >= CERTAIN:
                return changes
        del claimed[weakest]
    return []


def _candidate(contrasts: Contrasts, effect: Effect, closed: _Closed, least: float) -> Candidate | None:
    """The best change of one kind. least: gain below which no push is looked for."""
    match effect:
        case TorqueSensorDrift():
            return find_drift(contrasts, effect, closed.drift)
        case ThermalFriction():
            return find_thermal(contrasts, effect, closed.thermal)
        case PayloadChange():
            return find_payload(contrasts, effect)
        case ExternalContact():
            return find_contact(contrasts, effect, closed.spans, least)
    return None


def _close(contrasts: Contrasts, whole: FloatArray, claimed: Sequence[Candidate], closed: _Closed) -> FloatArray:
    """The contrasts without what is claimed, and without the space that each claim's residue would live in."""
    contrasts.z = whole
    rest = whole.copy()
    for candidate, fit in zip(claimed, _joint_fit(contrasts, claimed), strict=True):
        joints, rows = contrasts.rows(candidate.effect, candidate.place, candidate.shape, candidate.columns)
        rest[:, :, list(joints)] -= contrasts.whiten(rows, joints) @ fit.coefficients
    for candidate in claimed:
        match candidate.effect:
            case TorqueSensorDrift() | ThermalFriction():
                found = contrasts.repeated(candidate.effect, candidate.place, candidate.shape)
                assert found is not None
                joint = found[0][0]
                basis = np.linalg.qr(contrasts.whiten_repeated(found[2], found[0])[:, 0])[0]
                rest[:, :, joint] -= (rest[:, :, joint] @ basis) @ basis.T
                (closed.drift if isinstance(candidate.effect, TorqueSensorDrift) else closed.thermal).add(joint)
            case PayloadChange():
                moment = candidate.shape["time_s"]
                _close_span(contrasts, rest, closed, moment - WINDOW_MARGIN_S, moment + WINDOW_MARGIN_S)
            case _:
                assert candidate.span_s is not None
                margin = WINDOW_MARGIN_S + 0.15 * (candidate.span_s[1] - candidate.span_s[0])
                _close_span(contrasts, rest, closed, candidate.span_s[0] - margin, candidate.span_s[1] + margin)
    return rest


def _close_span(contrasts: Contrasts, rest: FloatArray, closed: _Closed, first: float, last: float) -> None:
    """Take out of the periods concerned whatever smooth torque acts between two times on any joint."""
    motion = contrasts.motion
    closed.spans.append((first, last))
    knots = np.linspace(first, last, LACK_KNOTS)
    width = knots[1] - knots[0]
    for period, start in enumerate(motion.start_s):
        time = start + motion.time
        if not np.any((time > first) & (time < last)):
            continue
        hats = np.maximum(0.0, 1.0 - np.abs(time[:, None] - knots) / width)
        rows = contrasts.evidence.project(hats[:, hats.any(axis=0)])
        for joint in range(contrasts.evidence.n):
            white = contrasts.whiten_repeated(rows[:, None, :], [joint])[:, 0]
            basis, size, _ = np.linalg.svd(white, full_matrices=False)
            basis = basis[:, size > 1e-6 * size[0]]
            rest[period, :, joint] -= basis @ (basis.T @ rest[period, :, joint])


def _joint_fit(contrasts: Contrasts, claimed: Sequence[Candidate]) -> list[Fit]:
    """One fit of all together. gain of each: what is lost when it alone is left out."""
    n, size = contrasts.evidence.n, sum(len(candidate.fit.coefficients) for candidate in claimed)
    white = np.zeros((*contrasts.z.shape[:2], n, size))
    blocks = []
    first = 0
    for candidate in claimed:
        joints, rows = contrasts.rows(candidate.effect, candidate.place, candidate.shape, candidate.columns)
        block = slice(first, first + rows.shape[-1])
        white[:, :, list(joints), block] = contrasts.whiten(rows, joints)
        blocks.append(block)
        first = block.stop
    together = contrasts.fit(white, range(n))
    matrix = white.reshape(-1, size)
    gram, right = matrix.T @ matrix, matrix.T @ contrasts.z.reshape(-1)
    fits = []
    for candidate, block in zip(claimed, blocks, strict=True):
        others = np.r_[0 : block.start, block.stop : size]
        without = float(right[others] @ solve(gram[np.ix_(others, others)], right[others])[0]) if others.size else 0.0
        inflation = candidate.dispersion
        fits.append(
            replace(
                candidate.fit,
                gain=(together.gain - without) / inflation,
                coefficients=together.coefficients[block],
                covariance=together.covariance[block, block] * inflation,
            )
        )
    return fits


def _merge_contacts(contrasts: Contrasts, claimed: Sequence[Candidate]) -> list[Candidate]:
    """Contacts at one place of several periods are one that comes back.

    The link of a weak return is less certain than that of the strongest, so the strongest names it.
    """
    period = contrasts.motion.samples * contrasts.motion.sampling_period_s
    merged: list[Candidate] = []
    for candidate in sorted(claimed, key=lambda one: -one.fit.gain):
        for place, other in enumerate(merged):
            if candidate.span_s is None or other.span_s is None:
                continue
            length = other.span_s[1] - other.span_s[0]
            starts = [value for name, value in other.shape.items() if name.startswith("start_")]
            apart = (sum(candidate.span_s) - sum(other.span_s)) / 2.0
            if abs((apart + 0.5 * period) % period - 0.5 * period) < 0.5 * length:
                came_back = other.shape["start_s"] + round(apart / period) * period
                shape: Mapping[str, float] = {**other.shape, f"start_{len(starts) + 1}_s": came_back}
                merged[place] = replace(other, shape=shape)
                break
        else:
            merged.append(candidate)
    return merged


def _change(number: int, contrasts: Contrasts, candidate: Candidate, fit: Fit) -> Change:
    joints, rows = contrasts.rows(candidate.effect, candidate.place, candidate.shape, candidate.columns)
    periods, lines, n = contrasts.z.shape
    contribution = np.zeros((periods, lines, n))
    contribution[:, :, list(joints)] = rows @ fit.coefficients
    mean_columns = np.zeros((lines, n, rows.shape[-1]))
    mean_columns[:, list(joints)] = rows.mean(axis=0)
    added = candidate.added_covariance
    if added is None:
        where = candidate.effect, candidate.place, candidate.shape
        added = candidate.dispersion * shape_covariance(contrasts, *where, fit.coefficients, candidate.columns)
    whole = contrasts.repeated(candidate.effect, candidate.place, candidate.shape)
    assert whole is not None
    size = whole[1].shape[-1]
    coefficients, covariance = np.zeros(size), np.zeros((size, size))
    coefficients[candidate.columns] = fit.coefficients
    covariance[candidate.columns, candidate.columns] = fit.covariance + added
    return Change(
        evidence=number,
        effect=candidate.effect,
        estimate=Estimate(candidate.place, candidate.shape, coefficients, covariance, candidate.shape_std),
        gain=fit.gain,
        score=fit.score(candidate.tests),
        log10_chance=fit.log10_chance(candidate.tests),
        contribution=contribution,
        mean_columns=with_level(mean_columns) if isinstance(candidate.effect, TorqueSensorDrift) else mean_columns,
    )
