"""A drift too weak for the contrasts alone: one that is zero at first also stands in the mean, with most of its torque.

Of a torque that grows evenly from zero three quarters of the squares are in the mean of the periods, where they look
like an offset, and a quarter is between the periods. Seen in the mean alone a weak drift is named an offset. Not here:
drifts that the contrasts prove, whose mean is left free (`between_periods`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc

from identification.arrays import FloatArray
from identification.mismatch.changes.between_periods import Change, with_level
from identification.mismatch.changes.contact_search import without_outliers
from identification.mismatch.changes.contrasts import Contrasts, log10_chance
from identification.mismatch.effects.base import CERTAIN, Estimate, Place
from identification.mismatch.effects.torque_sensor_drift import EXPONENTIAL, LINEAR, TorqueSensorDrift
from identification.mismatch.evidence import Evidence
from identification.mismatch.findings import Alternative
from identification.mismatch.problem import Problem, off
from identification.mismatch.search.search import SearchResult
from identification.mismatch.search.trial import fitted
from identification.mismatch.settings import PRIOR_COST, DiagnosisSettings
from identification.signals.outliers import FEWEST_PERIODS

SETTLING = (0.2, 0.5)
"""Time constants tried beside the even course, as shares of the recording; a shorter one is all but an offset."""


@dataclass(frozen=True, slots=True, eq=False)
class _Course:
    """A drift from zero per unit of the effect's coefficient on one joint (from 0), and how both parts of it look.

    by_period: (K, R) Nm. mean: (n R,) its mean, whitened. contrasts: (K, R) whitened.
    """

    joint: int
    shape: dict[str, float]
    by_period: FloatArray
    mean: FloatArray
    contrasts: FloatArray


def find_drift_in_mean(
    problem: Problem,
    evidences: Sequence[Evidence],
    known: Sequence[Change],
    result: SearchResult,
    settings: DiagnosisSettings,
) -> Change | None:
    """The drift from zero that explains mean and contrasts of a recording together better than anything without it.

    None unless what it explains reaches complete_score, it leaves nothing but noise beside members of the search, and
    these together are likelier than what the search settled on. What stood in its place there is an alternative where
    it comes within the margin. result: of the search on `problem`, with the changes `known`.
    """
    if not problem.noise_is_measured:
        return None
    best: tuple[float, Change] | None = None
    for number, evidence in enumerate(evidences):
        if evidence.period_torque is None or evidence.periods < FEWEST_PERIODS:
            continue
        own = [change for change in known if change.evidence == number]
        contrasts = Contrasts(evidence)
        contrasts.z = without_outliers(contrasts)
        for change in own:
            contrasts.z -= contrasts.whiten(change.contribution[..., None], range(evidence.n))[..., 0]
        closed = {change.estimate.place.joint for change in own if change.effect.name == TorqueSensorDrift.name}
        for course in _courses(problem, number, contrasts, closed):
            found = _weighed(problem, number, contrasts.z[:, :, course.joint], course, result, settings)
            if found is None:
                continue
            worth = found[0] - (0.0 if course.shape["course"] == LINEAR else PRIOR_COST)
            if best is None or worth > best[0]:
                best = worth, found[1]
    return None if best is None else best[1]


def _courses(problem: Problem, number: int, contrasts: Contrasts, closed: set[int | None]) -> Iterator[_Course]:
    """An even course and a few that settle, on every joint that has no drift yet."""
    effect, motion, evidence = TorqueSensorDrift(), contrasts.motion, contrasts.evidence
    last = float(motion.start_s[-1] + motion.time[-1])
    shapes = [{"course": float(LINEAR)}]
    shapes += [{"course": float(EXPONENTIAL), "time_s": share * last} for share in SETTLING]
    for shape in shapes:
        factor = effect.envelope(motion, shape)
        rows = np.stack([evidence.project((period - factor[0, 0])[:, None])[:, 0] for period in factor])
        for joint in range(evidence.n):
            if joint + 1 in closed:
                continue
            whole = np.zeros((problem.n, problem.rows))
            whole[joint, problem.evidence == number] = rows.mean(axis=0)
            yield _Course(
                joint=joint,
                shape=shape,
                by_period=rows,
                mean=(whole * problem.weight).ravel(),
                contrasts=contrasts.whiten(rows[:, :, None, None], [joint])[:, :, 0, 0],
            )


def _weighed(
    problem: Problem,
    number: int,
    target: FloatArray,
    course: _Course,
    result: SearchResult,
    settings: DiagnosisSettings,
) -> tuple[float, Change] | None:
    """How much likelier members of the search beside a drift are than all of them without it, and the drift.

    target: (K, R) contrasts of its joint. With those members that do not act on its joint, and with all where each of
    the others is worth what the search asks of one: beside a drift an offset costs nothing else.
    """
    length = float(np.vdot(course.contrasts, course.contrasts))
    alone = float(np.vdot(course.contrasts, target))
    if alone**2 < CERTAIN**2 * length:
        return None
    # The even course has half of the chance of a false name to itself, as where contrasts alone are asked.
    cost = float(np.log(2.0 if course.shape["course"] == LINEAR else 2.0 * len(SETTLING)))
    members = result.trial.members
    elsewhere = tuple(member for member in members if course.joint not in member.rows.joints)
    best: tuple[float, Change] | None = None
    for kept in dict.fromkeys((elsewhere, members)):
        beside = fitted(problem, kept, settings)
        visible = off(beside.problem.basis, course.mean)
        information = float(visible @ visible) + length
        size = (float(visible @ beside.problem.residual) + alone) / information
        gain = size**2 * information
        between = size * (2.0 * alone - size * length)
        left = beside.penalised - (gain - between)
        ahead = 0.5 * (result.trial.penalised - left + between) - cost
        price = settings.provisional_score * (len(kept) - len(elsewhere))
        if 0.5 * gain - cost < settings.complete_score or ahead <= (0.0 if best is None else best[0] + price):
            continue
        torque = problem.torque - size * course.mean
        if not fitted(replace(problem, torque=torque, residual=off(problem.basis, torque)), kept, settings).complete:
            continue
        score = 0.5 * gain - cost
        rivals = [member for member in members if member not in kept]
        even = len(rivals) == 1 and result.trial.complete and ahead < settings.margin_of_indistinguishable
        others = tuple(Alternative(item.effect.name, item.place.joint) for item in rivals if even)
        best = ahead, _change(problem, number, course, size, information, score, others)
    return best


def _change(
    problem: Problem,
    number: int,
    course: _Course,
    size: float,
    information: float,
    score: float,
    alternatives: tuple[Alternative, ...],
) -> Change:
    contribution = np.zeros((*course.by_period.shape, problem.n))
    contribution[:, :, course.joint] = size * course.by_period
    gain, tests = size**2 * information, problem.n * (1.0 + len(SETTLING))
    place, variance = Place(joint=course.joint + 1), np.array([[1.0 / information]])
    return Change(
        evidence=number,
        effect=TorqueSensorDrift(),
        estimate=Estimate(place, course.shape, np.array([size]), variance, {}),
        gain=gain,
        score=score,
        log10_chance=log10_chance(float(chdtrc(1, gain)), tests),
        contribution=contribution,
        mean_columns=with_level(contribution.mean(axis=0)[..., None]),
        alternatives=alternatives,
    )
