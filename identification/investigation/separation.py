"""How far a motion tells hypotheses apart: λ of each pair, base parameters and the rival's own size refitted.

λ of truth h against rival r is min over base parameters and r's coefficients of the squared distance, in units of the
noise, of what h predicts on all recordings together. Half of it is the expected log odds (T-optimality: Atkinson and
Fedorov, Biometrika 62, 1975).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from identification.arrays import BoolArray, FloatArray
from identification.investigation.columns import Form, Sums, sums_of
from identification.investigation.discrepancy import Discrepancies, Variances
from identification.investigation.equivalences import ONE_TORQUE
from identification.investigation.free_functions import lead
from identification.investigation.hypotheses import Hypothesis
from identification.mismatch.evidence import Evidence
from identification.mismatch.settings import PRIOR_COST
from identification.mismatch.unknown.classes import CLASSES

SAME = 1e-6
"""Share of its own λ below which what tells one hypothesis from another is rounding."""


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """Which columns of normal equations belong to which form."""

    forms: tuple[Form, ...]

    @property
    def places(self) -> Mapping[Form, slice]:
        """Columns of each form behind those of the base parameters."""
        found, start = {}, 0
        for form in self.forms:
            found[form] = slice(start, start + form.size)
            start += form.size
        return found

    @classmethod
    def of(cls, hypotheses: Sequence[Hypothesis], shapes: int | None = 3) -> Layout:
        """The best shape of each hypothesis and so many of its neighbours on the grid; None: the whole grid."""
        forms: dict[Form, None] = {}
        for item in hypotheses:
            if item.best is None:
                continue
            middle = item.forms.index(item.best) if item.best in item.forms else 0
            near = sorted(range(len(item.forms)), key=lambda number: abs(number - middle))[:shapes]
            forms.update(dict.fromkeys([item.best, *(item.forms[number] for number in near)]))
        return cls(tuple(forms))


def separations(
    sums: Sums, layout: Layout, hypotheses: Sequence[Hypothesis], beside: Discrepancies | None = None
) -> FloatArray:
    """(H, H) λ of each hypothesis (row), were it true, against each rival (column). Diagonal: λ of it beside the base
    parameters alone, which the diagnosis asks of a name.

    The classes that a rival has beside it take up what they can at their size. Against "nothing more" it is what is
    visible of the effect at all, or what the free functions that come nearest to it cannot take up, with what these
    cost. In the row of "nothing more" stands what a rival of the size that it has now would show: so much speaks
    against it where it is not there.
    """
    places = layout.places
    count = len(hypotheses)
    result = np.zeros((count, count))
    alone = _rest(sums, None, ())
    for i, item in enumerate(hypotheses):
        if item.best is not None:
            own = places[item.best]
            result[i, i] = max(0.0, float(item.coefficients @ alone[own, own] @ item.coefficients))
    for j, rival in enumerate(hypotheses):
        rest = _rest(sums, beside, rival.beside)
        for i, truth in enumerate(hypotheses):
            if i == j or truth.best is None:
                continue
            own, size = places[truth.best], truth.coefficients
            if rival.best is None:
                result[i, j] = result[j, i] = max(0.0, float(size @ rest[own, own] @ size))
                if beside is not None:
                    result[i, j] = min(result[i, j], _free_functions(sums, beside, rival.beside, truth, own))
                continue
            forms = [places[form] for form in rival.forms if form in places]
            result[i, j] = _left(rest, own, forms, size)
    return result


def beside_names(sums: Sums, hypotheses: Sequence[Hypothesis], beside: Discrepancies | None) -> FloatArray:
    """(H,) λ that the classes beside each hypothesis are expected to show on its joint, base parameters taken off."""
    result = np.zeros(len(hypotheses))
    for i, item in enumerate(hypotheses):
        if beside is None or item.best is None or item.place.joint is None:
            continue
        joint = item.place.joint - 1
        spread = beside.deviations(item.beside)[joint]
        there = np.flatnonzero(spread)
        if there.size:
            rest = sums.projected((), (joint, there))
            result[i] = spread[there] ** 2 @ np.diagonal(rest)[-there.size :]
    return result


def special_cases(sums: Sums, layout: Layout, hypotheses: Sequence[Hypothesis]) -> BoolArray:
    """(H, H) whether a hypothesis (row) is a special case of a rival (column) that has further coefficients, as an
    offset is of a spring: whatever is recorded, the rival explains as much.
    """
    places, rest = layout.places, _rest(sums, None, ())
    result = np.zeros((len(hypotheses), len(hypotheses)), dtype=bool)
    for i, truth in enumerate(hypotheses):
        for j, rival in enumerate(hypotheses):
            if truth.best is None or rival.best is None or rival.coefficients.size <= truth.coefficients.size:
                continue
            own, size = places[truth.best], truth.coefficients
            left = _left(rest, own, [places[form] for form in rival.forms if form in places], size)
            result[i, j] = left < ONE_TORQUE * float(size @ rest[own, own] @ size)
    return result


def _rest(sums: Sums, beside: Discrepancies | None, variances: Variances) -> FloatArray:
    return sums.projected(() if beside is None else beside.deviations(variances))


def _left(rest: FloatArray, own: slice, forms: Sequence[slice], size: FloatArray) -> float:
    """λ of a size of some columns that none of a rival's forms takes up."""
    whole = float(size @ rest[own, own] @ size)
    return max(0.0, whole - max(_explained(rest, own, form, size) for form in forms))


def _free_functions(sums: Sums, beside: Discrepancies, variances: Variances, truth: Hypothesis, own: slice) -> float:
    """Twice the nats by which a name leads the best free function in its place, among those that are at hand.

    One that stands in the rival already may be larger or smaller with the motion in: the size that suits it counts.
    """
    found = math.inf
    if truth.place.joint is None:
        return found
    joint = truth.place.joint - 1
    group = np.repeat(np.arange(len(beside.bases[joint])), [2 * basis.centre.size for basis in beside.bases[joint]])
    rivals = [
        place for place, (basis, held) in enumerate(zip(beside.bases[joint], truth.beside[joint], strict=True))
        if held == 0.0 and truth.effect not in CLASSES[basis.number].described
    ]  # fmt: skip
    standing = [place for place in rivals if variances[joint][place] > 0.0]
    size = truth.coefficients
    for places in ([place for place in rivals if place not in standing], *([place] for place in standing)):
        kept = np.flatnonzero(np.isin(group, places))
        others = [each.copy() for each in variances]
        others[joint][places] = 0.0
        rest = sums.projected(beside.deviations(tuple(others)), (joint, kept))
        first = len(rest) - kept.size
        strength = float(size @ rest[own, own] @ size)
        for place in places:
            chosen = first + np.flatnonzero(group[kept] == place)
            nats = lead(strength, rest[chosen[:, None], chosen], rest[chosen, own] @ size)
            found = min(found, 2.0 * (nats + PRIOR_COST))
    return found


def _explained(rest: FloatArray, own: slice, other: slice, size: FloatArray) -> float:
    """What of a hypothesis's λ a form takes up."""
    block = rest[other, other]
    scale = 1.0 / np.sqrt(np.maximum(np.diag(block), 1e-300))
    across = (rest[other, own] @ size) * scale
    values, vectors = np.linalg.eigh(block * np.outer(scale, scale))
    seen = values > 1e-9 * values[-1]
    return float((((across @ vectors[:, seen]) ** 2) / values[seen]).sum())


def agreement(
    evidences: Sequence[Evidence], form: Form, beside: Discrepancies | None = None, variances: Variances = ()
) -> float:
    """Chance of coefficients that differ between recordings as these do, or more, if all of them have one torque.

    Each recording's own estimate, base parameters of its own refitted, classes of these variances beside it, against
    the mean weighted by precision: χ² with m (recordings − 1) degrees of freedom. 1 where fewer than two recordings
    show the form.
    """
    strengths, sums = [], []
    for item in evidences:
        found = sums_of(item, [form], item.torque[..., None], beside)
        rest = found.projected(() if beside is None else beside.deviations(variances))
        own, across = rest[: form.size, : form.size], rest[: form.size, form.size]
        if np.linalg.eigvalsh(own)[0] > SAME * float(np.trace(own)) > 0.0:
            strengths.append(own)
            sums.append(across)
    if len(strengths) < 2:
        return 1.0
    mean = np.linalg.solve(np.sum(strengths, axis=0), np.sum(sums, axis=0))
    parts = [np.linalg.solve(own, across) - mean for own, across in zip(strengths, sums, strict=True)]
    square = sum(float(part @ own @ part) for part, own in zip(parts, strengths, strict=True))
    return float(chdtrc(form.size * (len(strengths) - 1), square))
