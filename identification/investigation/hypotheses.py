"""What may still be missing: every form of the library weighed against "nothing more", and those that are alive.

The weight of a form is its evidence: how much it explains of what base parameters and settled findings leave, less what
a form of its kind costs. Noise is taken as large as what the best form leaves, joint by joint and band by band, so that
an unknown background makes hypotheses hard to tell, not certain.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from identification.investigation.columns import Form, form_rows, forms_of
from identification.mismatch.effects import effect_named
from identification.mismatch.effects.base import Place
from identification.mismatch.evidence import Evidence

FloatArray = npt.NDArray[np.float64]

__all__ = ["NOTHING", "Assessment", "Hypothesis", "assess", "describe"]

NOTHING_MORE = 4.0
"""Prior odds of "nothing more" against everything else together, which all effects at all places share evenly."""
USUAL_STRENGTH = 1000.0
"""λ that an effect of usual size has; a coefficient costs half its logarithm (Occam)."""
WITHIN = 7.0
"""Nats below the most probable hypothesis up to which one is alive: odds of a thousand to one."""
MOST_ALIVE, MOST_WEIGHED_ANEW = 8, 24
BANDS_HZ = (0.0, 0.55, 2.05, 10.05, math.inf)
"""Bands in which a misfit without a name is taken for noise of its own strength."""
_VISIBLE = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """One thing that may be missing; effect None: nothing more is.

    forms: its shapes on the grid. best: the shape with the most evidence. coefficients: (m,) of it, with covariance.
    log_odds: nats against "nothing more", prior included. probability: among all hypotheses of the assessment.
    """

    effect: str | None
    place: Place
    forms: tuple[Form, ...]
    best: Form | None
    coefficients: FloatArray
    covariance: FloatArray
    log_odds: float
    probability: float = 0.0

    @property
    def name(self) -> str:
        """In words, with its place."""
        return describe(self.effect, self.place)

    @property
    def size(self) -> float:
        """Of the leading coefficients, and relative_std: how well it is known."""
        return float(np.linalg.norm(self.coefficients))

    @property
    def relative_std(self) -> float:
        """Standard deviation of the size over the size."""
        strength = float(self.coefficients @ np.linalg.pinv(self.covariance, hermitian=True) @ self.coefficients)
        return 1.0 / math.sqrt(strength) if strength > 0.0 else math.inf


NOTHING = Hypothesis(None, Place(), (), None, np.zeros(0), np.zeros((0, 0)), 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Assessment:
    """alive: hypotheses, the most probable first, probabilities summing to one. evidences: with noise that holds the
    misfit without a name, and with the settled findings among the nominal columns. inflation: (bands, n) factor of
    the noise.
    """

    alive: tuple[Hypothesis, ...]
    evidences: tuple[Evidence, ...]
    inflation: FloatArray

    @property
    def leader(self) -> Hypothesis:
        """The most probable hypothesis."""
        return self.alive[0]

    @property
    def certain(self) -> float:
        """Probability of the leader."""
        return self.alive[0].probability


def describe(effect: str | None, place: Place) -> str:
    """An effect with its place, in words."""
    if effect is None:
        return "nothing more"
    where = "" if place.joint is None else f" at joint {place.joint}"
    other = "" if place.other_joint is None else f" and {place.other_joint}"
    return f"{effect.replace('_', ' ')}{where}{other}"


def assess(
    evidences: Sequence[Evidence],
    known: Sequence[Form] = (),
    asked: Collection[tuple[str, int | None]] = (),
) -> Assessment:
    """Weigh every form of the library on these evidences together.

    known: settled findings. asked: effects with their joints (from 1) that stay alive whatever their evidence says
    (claimed by the diagnosis, or among its alternatives).
    """
    rows = tuple(_with_known(item, known) for item in evidences)
    skip = {(form.effect, form.place) for form in known}
    weighed = _weigh(rows, skip)
    inflation = np.ones((len(BANDS_HZ) - 1, rows[0].n))
    for _ in range(2):
        best = max(weighed, key=lambda item: item.log_odds, default=NOTHING)
        inflation = inflation * _beyond_noise(rows, best if best.log_odds > 0.0 else NOTHING)
        rows = tuple(_inflated(item, evidence, inflation) for item, evidence in zip(rows, evidences, strict=True))
        if np.all(inflation == 1.0):
            break
        # Noise that is larger than it was makes all evidence less: what had little stays behind.
        ordered = sorted(weighed, key=lambda item: -item.log_odds)
        among = {(item.effect or "", item.place) for item in ordered[:MOST_WEIGHED_ANEW]}
        among |= {(item.effect or "", item.place) for item in weighed if (item.effect, item.place.joint) in asked}
        weighed = _weigh(rows, skip, among)
    return Assessment(_alive(weighed, asked), rows, inflation)


def _alive(weighed: Sequence[Hypothesis], asked: Collection[tuple[str, int | None]]) -> tuple[Hypothesis, ...]:
    everything = [NOTHING, *weighed]
    top = max(item.log_odds for item in everything)
    total = sum(math.exp(item.log_odds - top) for item in everything)
    everything = [replace(item, probability=math.exp(item.log_odds - top) / total) for item in everything]
    ordered = sorted(everything, key=lambda item: -item.log_odds)
    wanted = [item for item in ordered if (item.effect, item.place.joint) in asked or item.effect is None]
    near = [item for item in ordered if item.log_odds >= top - WITHIN]
    kept = list(dict.fromkeys([ordered[0], *wanted, *near]))[: MOST_ALIVE + len(wanted)]
    kept.sort(key=lambda item: -item.log_odds)
    share = sum(item.probability for item in kept)
    return tuple(replace(item, probability=item.probability / share) for item in kept)


def _weigh(
    rows: Sequence[Evidence], skip: Collection[tuple[str, Place]], among: Collection[tuple[str, Place]] | None = None
) -> list[Hypothesis]:
    """Every effect at every place with its evidence against nothing. among: these alone, None for all."""
    nominal = [_whitened(item.nominal, item) for item in rows]
    torque = [_whitened(item.torque[..., None], item)[..., 0] for item in rows]
    gram = sum(np.einsum("rnp,rnq->pq", part, part, optimize=True) for part in nominal)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(gram), 1e-300))
    inverse = np.linalg.pinv(gram * np.outer(scale, scale), 1e-12, hermitian=True) * np.outer(scale, scale)
    values = inverse @ sum(np.einsum("rnp,rn->p", part, t) for part, t in zip(nominal, torque, strict=True))
    left = [t - part @ values for part, t in zip(nominal, torque, strict=True)]
    found = []
    everything = tuple(forms_of(rows[0].motion))
    count = len(everything)
    for effect, place, forms in everything:
        if (effect.name, place) in skip or (among is not None and (effect.name, place) not in among):
            continue
        scored = []
        for form in forms:
            strength, across, energy = np.zeros((form.size,) * 2), np.zeros(form.size), 0.0
            shared = np.zeros((len(values), form.size))
            for item, part, rest in zip(rows, nominal, left, strict=True):
                columns = effect_named(form.effect).columns(item.motion, place, dict(form.shape))
                if columns is None:
                    continue
                joints = list(columns.joints)
                weight = np.where(item.used, 1.0 / item.noise, 0.0)[:, joints, None]
                own = (item.project(columns.values) * weight).reshape(-1, form.size)
                strength += own.T @ own
                shared += part[:, joints].reshape(len(own), -1).T @ own
                across += own.T @ rest[:, joints].ravel()
            energy = float(np.trace(strength))
            strength = strength - shared.T @ inverse @ shared
            if energy <= 0.0 or float(np.trace(strength)) < _VISIBLE * energy:
                continue
            covariance: FloatArray = np.linalg.pinv(strength, 1e-9, hermitian=True).astype(np.float64)
            coefficients = covariance @ across
            gain = 0.5 * float(across @ coefficients)
            if effect.one_sided and coefficients[0] < 0.0:
                gain = 0.0
            scored.append((gain, form, coefficients, covariance))
        if not scored:
            continue
        gains = np.array([item[0] for item in scored])
        best = scored[int(gains.argmax())]
        freedom = best[1].size
        shrink = USUAL_STRENGTH / (1.0 + USUAL_STRENGTH)
        evidence = float(gains.max()) * shrink + math.log(float(np.mean(np.exp(gains - gains.max()))))
        log_odds = evidence - 0.5 * freedom * math.log1p(USUAL_STRENGTH) - math.log(NOTHING_MORE * count)
        found.append(Hypothesis(effect.name, place, forms, best[1], best[2], best[3], log_odds))
    return found


def _beyond_noise(rows: Sequence[Evidence], best: Hypothesis) -> FloatArray:
    """(bands, n) by how much more than its noise the rest is when base parameters and the best form are fitted."""
    stacked, torque, bands = [], [], []
    for item in rows:
        parts = [item.nominal]
        if best.best is not None:
            parts.append(form_rows(item, best.best))
        stacked.append(_whitened(np.concatenate(parts, axis=2), item))
        torque.append(_whitened(item.torque[..., None], item)[..., 0])
        bands.append(np.digitize(item.frequency, BANDS_HZ[1:-1]))
    matrix, measured, band = np.concatenate(stacked), np.concatenate(torque), np.concatenate(bands)
    flat = matrix.reshape(-1, matrix.shape[2])
    scale = np.linalg.norm(flat, axis=0)
    scale[scale == 0.0] = np.inf
    solution = np.linalg.lstsq(flat / scale, measured.ravel(), rcond=1e-9)[0] / scale
    rest = measured - matrix @ solution
    factor = np.ones((len(BANDS_HZ) - 1, measured.shape[1]))
    for number in range(len(factor)):
        part = rest[band == number]
        if len(part):
            # Rows that noise alone explains at odds of a hundred to one count as noise.
            expected = 1.0 + 2.33 * math.sqrt(2.0 / len(part))
            mean = np.mean(part**2, axis=0)
            factor[number] = np.where(mean > expected, np.sqrt(mean), 1.0)
    return factor


def _inflated(item: Evidence, original: Evidence, inflation: FloatArray) -> Evidence:
    band = np.digitize(item.frequency, BANDS_HZ[1:-1])
    return replace(item, noise=original.noise * inflation[band])


def _with_known(evidence: Evidence, known: Sequence[Form]) -> Evidence:
    if not known:
        return evidence
    return replace(
        evidence, nominal=np.concatenate([evidence.nominal, *(form_rows(evidence, form) for form in known)], axis=2)
    )


def _whitened(values: FloatArray, evidence: Evidence) -> FloatArray:
    """(R, n, m) over the noise, rows that do not count as zeros."""
    weight = np.where(evidence.used, 1.0 / evidence.noise, 0.0)
    return np.asarray(values * weight[..., None])
