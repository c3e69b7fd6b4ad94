"""How far a motion tells hypotheses apart: λ of each pair, base parameters and the rival's own size refitted.

λ of truth h against rival r is min over base parameters and r's coefficients of the squared distance, in units of the
noise, of what h predicts on all recordings together. Half of it is the expected log odds (T-optimality: Atkinson and
Fedorov, Biometrika 62, 1975).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import chdtrc

from identification.investigation.columns import Form, Sums, sums_of
from identification.investigation.discrepancy import Discrepancies, Variances
from identification.investigation.hypotheses import Hypothesis
from identification.mismatch.evidence import Evidence
from identification.mismatch.unknown.settings import ClaimSettings

FloatArray = npt.NDArray[np.float64]

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
    def of(cls, hypotheses: Sequence[Hypothesis], shapes: int = 3) -> Layout:
        """The best shape of each hypothesis and its neighbours on the grid."""
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
    """(H, H) λ of each hypothesis (row), were it true, against each rival (column); 0 on the diagonal.

    The classes that a rival has beside it take up what they can at their size. A rival may also take on the classes
    that stand on the truth's joint where no form is, at what they cost beforehand. Against "nothing more" it is what is
    visible of the effect at all. In the row of "nothing more" stands what a rival of the size that it has now would
    show: so much speaks against it where it is not there.
    """
    places = layout.places
    count = len(hypotheses)
    result = np.zeros((count, count))
    plain = next((item.beside for item in hypotheses if item.effect is None), ())
    for j, rival in enumerate(hypotheses):
        rest = _rest(sums, beside, rival.beside)
        richer: dict[int, tuple[FloatArray, float]] = {}
        for i, truth in enumerate(hypotheses):
            if i == j or truth.best is None:
                continue
            own, size = places[truth.best], truth.coefficients
            if rival.best is None:
                result[i, j] = result[j, i] = max(0.0, float(size @ rest[own, own] @ size))
                continue
            forms = [places[form] for form in rival.forms if form in places]
            left = _left(rest, own, forms, size)
            joint = -1 if truth.place.joint is None else truth.place.joint - 1
            if beside is not None and plain and joint >= 0:
                if joint not in richer:
                    richer[joint] = _with_classes(sums, beside, rival.beside, plain, joint)
                free, cost = richer[joint]
                left = min(left, _left(free, own, forms, size) + 2.0 * cost)
            result[i, j] = left
    return result


def _rest(sums: Sums, beside: Discrepancies | None, variances: Variances) -> FloatArray:
    return sums.projected(() if beside is None else beside.deviations(variances))


def _left(rest: FloatArray, own: slice, forms: Sequence[slice], size: FloatArray) -> float:
    """λ of a size of some columns that none of a rival's forms takes up."""
    whole = float(size @ rest[own, own] @ size)
    return max(0.0, whole - max(_explained(rest, own, form, size) for form in forms))


def _with_classes(
    sums: Sums, beside: Discrepancies, variances: Variances, plain: Variances, joint: int
) -> tuple[FloatArray, float]:
    """What is left beside further classes on a joint (from 0), and the nats that they cost."""
    own, more = variances[joint], np.maximum(variances[joint], plain[joint])
    added = {basis.number for basis, old, new in zip(beside.bases[joint], own, more, strict=True) if new > old == 0.0}
    if not added:
        return _rest(sums, beside, variances), 0.0
    taken = (*variances[:joint], more, *variances[joint + 1 :])
    occam = sums.occam(joint, beside.deviations(taken)[joint]) - sums.occam(joint, beside.deviations(variances)[joint])
    return _rest(sums, beside, taken), ClaimSettings().prior_cost * len(added) + max(0.0, occam)


def _explained(rest: FloatArray, own: slice, other: slice, size: FloatArray) -> float:
    """What of a hypothesis's λ a form takes up."""
    block = rest[other, other]
    scale = 1.0 / np.sqrt(np.maximum(np.diag(block), 1e-300))
    across = (rest[other, own] @ size) * scale
    return float(across @ np.linalg.pinv(block * np.outer(scale, scale), 1e-9, hermitian=True) @ across)


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
