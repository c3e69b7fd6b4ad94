"""A push that comes with every period: it stands in the mean of the periods, beside the base parameters.

A window free in time and a force free in direction describe much that is no push, so one is claimed only where it
leaves nothing but noise and nothing of the library does so as well: see `diagnosis`, which asks. Not here: pushes in
single periods (`contact_search`), and what is claimed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, chdtri

from identification.arrays import FloatArray, IntArray
from identification.mismatch.changes.between_periods import Change
from identification.mismatch.changes.candidates import REFINED
from identification.mismatch.changes.contact_force import locate_push, refine_window, seen_on, window_gain
from identification.mismatch.changes.contact_search import CONTACT_DURATIONS_S, turned
from identification.mismatch.changes.contrasts import log10_chance
from identification.mismatch.changes.push_fit import WINDOW
from identification.mismatch.effects.base import Estimate
from identification.mismatch.effects.external_contact import ExternalContact
from identification.mismatch.evidence import Evidence
from identification.mismatch.heldout import misfit_probability, residuals
from identification.mismatch.motion import Motion
from identification.mismatch.problem import Problem
from identification.mismatch.search.extension import extend
from identification.mismatch.search.library import Library
from identification.mismatch.search.refinement import Member
from identification.mismatch.search.search import SearchResult
from identification.mismatch.search.trial import fitted
from identification.mismatch.settings import ALTERNATIVE, CAPTURE, MOST, UNLIKELY, DiagnosisSettings
from identification.signals.periodic import to_lines

SHARE_OF_NARROWEST = 0.125
"""Distance of the windows that are tried, as a share of their duration."""
FEWEST_JOINTS = 2


def find_repeated_contact(
    problem: Problem,
    evidences: Sequence[Evidence],
    result: SearchResult,
    settings: DiagnosisSettings,
    another_motion: Callable[[], float] = float,
) -> Change | None:
    """The push in every period of one recording that explains most; None where it could not be claimed anyway.

    result: what the search settled on without a push. Its score (half the drop of the whitened squares, less the cost
    of the coefficients and of the choice of the window) must reach push_score beyond what that explains, where that
    leaves nothing but noise. another_motion: misfit per row (`excess_per_row`) of recordings of another motion, where a
    push at a moment of this one is not: what they show is of other kinds. A torque seen on one joint alone may be
    anything that sits at one angle: it is no push.
    """
    if not problem.noise_is_measured:
        return None
    known = 0.5 * (result.before.squares - result.trial.penalised) if result.trial.complete else 0.0
    misfit = excess_per_row(problem)
    # A push makes most of all misfit: beside more than that of other kinds none is looked for.
    least = max(known + settings.push_score, 0.5 * MOST * misfit * _rows_that_count(problem))
    scans = [
        (MeanGround(problem, number, evidence), number)
        for number, evidence in enumerate(evidences)
        if evidence.motion.periodic
    ]
    hopeful = [(*pair, scan) for pair in scans if (scan := _scan(pair[0])).may_reach(least)]
    if not hopeful or another_motion() > (1.0 - MOST) * misfit:
        return None
    found = [_on_recording(ground, number, scan, least) for ground, number, scan in hopeful]
    return max((item for item in found if item is not None), key=lambda item: item.score, default=None)


def _rows_that_count(problem: Problem) -> float:
    return float((problem.weight > 0.0).sum())


def excess_per_row(problem: Problem) -> float:
    """Whitened squares that the base parameters leave beyond the noise's own, per row."""
    count = _rows_that_count(problem)
    return float(problem.residual @ problem.residual - (count - problem.basis.shape[1])) / count


def explains_better(
    problem: Problem, contact: Change, beside: SearchResult, without: SearchResult, settings: DiagnosisSettings
) -> bool:
    """Whether a push and what the search found beside it leave nothing but noise, as nothing without it does.

    What was found beside it must not do so alone either: a search that begins elsewhere may end elsewhere. problem: the
    one without the push.
    """
    if not beside.trial.complete:
        return False
    cost = 0.5 * contact.gain - contact.score
    alone = fitted(problem, beside.trial.members, settings)
    known = min((trial.penalised for trial in (alone, without.trial) if trial.complete), default=np.inf)
    return known - beside.trial.penalised - 2.0 * cost >= 2.0 * settings.push_score


def misfit_elsewhere(
    push: Change,
    problem: Problem,
    members: Sequence[Member],
    library: Library,
    torque: Sequence[FloatArray],
    settings: DiagnosisSettings,
) -> bool:
    """Whether joints that a push acts on are wrong on recordings of another motion too, where it is not.

    A spring between two joints looks like a push that comes at the same moment of every period: it is a function of
    the position, and the motion repeats. Another motion tells them apart, as the spring is there as well. problem: with
    the push taken off; library, torque: of the recordings that were not fitted. Tested band by band with the scatter
    that the model's parameters have there.
    """
    left = residuals(extend(problem, members), library.evidences, library, torque)
    loudness = ((push.contribution[0] * problem.weight[:, problem.evidence == push.evidence].T) ** 2).sum(axis=0)
    felt = loudness >= CAPTURE * loudness.max()
    chance = misfit_probability(left, library.evidences)[felt]
    return bool(chance.min() < settings.consistency_probability)


def _on_recording(ground: MeanGround, number: int, scan: Scan, least_score: float) -> Change | None:
    cost, tests = scan.cost, scan.tests
    shape = refine_window(ground, scan.start, scan.duration)
    seen = seen_on(ground, shape) > chdtri(1, UNLIKELY)
    if 0.5 * window_gain(ground, shape) - cost < least_score or seen.sum() < FEWEST_JOINTS:
        return None
    change = _at(ground, number, shape, cost, tests, 2.0 * (least_score + cost))
    return change if change is not None and change.score >= least_score else None


def beside(
    problem: Problem, evidences: Sequence[Evidence], contact: Change, result: SearchResult, settings: DiagnosisSettings
) -> Change:
    """The push once more, with what was found beside it taken off: another effect's torque is no sign of a larger link.

    problem: the one without the push.
    """
    if not result.trial.members:
        return contact
    ground = MeanGround(
        fitted(problem, result.trial.members, settings).problem, contact.evidence, evidences[contact.evidence]
    )
    window = {name: contact.estimate.shape[name] for name in WINDOW}
    cost = 0.5 * contact.gain - contact.score
    return _at(ground, contact.evidence, window, cost, float(np.exp(cost))) or contact


def _at(
    ground: MeanGround, number: int, window: Mapping[str, float], cost: float, tests: float, least: float = 0.0
) -> Change | None:
    """The push in a window; None where no link comes near the least gain."""
    effect, evidence = ExternalContact(), ground.evidence
    push = locate_push(ground, effect, window, least=least)
    if push is None:
        return None
    whole = {**push.shape, "start_s": push.shape["start_s"] % ground.period, "period_s": ground.period}
    tangent = np.zeros((evidence.frequency.size, evidence.n, push.tangent.shape[-1]))
    tangent[:, list(push.joints)] = evidence.project(push.tangent[0])
    contribution = tangent[..., :3] @ push.force
    return Change(
        evidence=number,
        effect=effect,
        estimate=Estimate(push.place, whole, push.force, push.covariance, push.shape_std),
        gain=push.gain,
        score=0.5 * push.gain - cost,
        log10_chance=log10_chance(float(chdtrc(len(WINDOW) + 6, push.gain)), tests),
        contribution=np.broadcast_to(contribution, (evidence.periods, *contribution.shape)),
        mean_columns=tangent,
    )


class MeanGround:
    """The mean of one recording beside the base parameters; see `Ground`. Times wrap around the period."""

    def __init__(self, problem: Problem, number: int, evidence: Evidence) -> None:
        self.problem, self.evidence = problem, evidence
        self.motion: Motion = evidence.motion
        self._rows = np.flatnonzero(problem.evidence == number)
        self.weight: FloatArray = problem.weight[:, self._rows].T
        self.residual: FloatArray = problem.residual.reshape(problem.n, problem.rows)[:, self._rows].T
        basis = problem.basis.reshape(problem.n, problem.rows, -1)[:, self._rows]
        self.basis: FloatArray = np.ascontiguousarray(basis.transpose(1, 0, 2))
        self.period = self.motion.samples * self.motion.sampling_period_s

    def course(self, factor_of: Callable[[FloatArray], FloatArray], near: IntArray | None = None) -> FloatArray:
        """(1, S): what is asked of times before and after the period comes from the next and the one before."""
        time = self.motion.time if near is None else self.motion.time[near]
        parts = [factor_of(time + shift) for shift in (-self.period, 0.0, self.period)]
        return np.asarray(np.sum(parts, axis=0)[None], dtype=np.float64)

    def rows(self, values: FloatArray, joints: Sequence[int]) -> FloatArray:
        """(n R, m), all joints of all recordings: the base parameters couple them."""
        problem, chosen = self.problem, np.array(joints)
        columns = np.zeros((problem.n, problem.rows, values.shape[-1]))
        white = self.evidence.project(values[0]) * self.weight[:, chosen, None]
        columns[np.ix_(chosen, self._rows)] = white.transpose(1, 0, 2)
        flat = columns.reshape(-1, values.shape[-1])
        # Once will do here: the residual that they are compared with is off the basis.
        return np.asarray(flat - problem.basis @ (problem.basis.T @ flat), dtype=np.float64)

    def target(self, joints: Sequence[int]) -> FloatArray:
        """(n R,)."""
        del joints
        return self.problem.residual

    def free(self, factors: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Normal equations of free torques."""
        white = self.weight * self.evidence.project(factors[0][:, None])
        shadow = np.einsum("rj,rjp->pj", white, self.basis)
        return np.diag((white**2).sum(axis=0)) - shadow.T @ shadow, (white * self.residual).sum(axis=0)


@dataclass(frozen=True, slots=True)
class Scan:
    """Gain, start and duration (s) of the half-sine window in which free torques gain most, and the number of tests."""

    gain: float
    start: float
    duration: float
    tests: float

    @property
    def cost(self) -> float:
        """Log-likelihood that the choice of the window costs."""
        return ALTERNATIVE * (len(WINDOW) + 2) + float(np.log(max(self.tests, 1.0)))

    def may_reach(self, score: float) -> bool:
        """Whether a push in a refined window may score so much."""
        return 0.5 * REFINED * self.gain - self.cost >= score


def _scan(ground: MeanGround) -> Scan:
    """The best half-sine window for free torques.

    All positions of a window at once, by inverse Fourier transforms; see `contact_search`.
    """
    lines = (len(ground.weight) - 1) // 2
    grid = 4 * lines
    best, tests = (0.0, 0.0, 0.0), 0.0
    for duration in CONTACT_DURATIONS_S:
        if not 4.0 * ground.motion.sampling_period_s <= duration <= 0.3 * ground.period:
            continue
        bump = np.where(ground.motion.time < duration, np.sin(np.pi * ground.motion.time / duration), 0.0)
        rows = ground.weight * to_lines(bump[:, None], lines)
        step = max(1, int(SHARE_OF_NARROWEST * duration / ground.period * grid))
        right = turned(rows[None], ground.residual[None], grid)[0, ::step]
        shadow = turned(rows[None], ground.basis.transpose(2, 0, 1), grid)[:, ::step]
        gram = np.einsum("pgi,pgj->gij", shadow, shadow)
        gram = np.diag((rows**2).sum(axis=0)) * (1.0 + 1e-9) - gram
        torque = np.linalg.solve(gram, right[..., None])[..., 0]
        gains = (torque * right).sum(axis=1)
        tests += 3.0 * ground.problem.n * ground.period / duration
        at = int(np.argmax(gains))
        if gains[at] > best[0]:
            best = (float(gains[at]), at * step * ground.period / grid, duration)
    return Scan(*best, tests)
