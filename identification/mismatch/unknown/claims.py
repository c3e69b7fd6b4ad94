"""What is said of a class: its size with an interval, how sure, what else it could be, its curve, in words.

Value objects and their JSON (contract §6, `classes`); nothing is decided here. Built by `judgement`, read by the
findings and the report.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from identification.arrays import FloatArray

__all__ = ["ClassClaim", "ClassCurve", "ClassModel", "NearestForm", "Offer"]


@dataclass(frozen=True, slots=True, eq=False)
class ClassCurve:
    """Torque of a class over its own variable: mean ± std, Nm, (B,) each; place: in `unit`, within its range."""

    coordinate: str
    unit: str
    place: FloatArray
    mean: FloatArray
    std: FloatArray

    def to_json(self) -> dict[str, Any]:
        """Plain JSON types."""
        return {
            "coordinate": self.coordinate,
            "unit": self.unit,
            "place": self.place.tolist(),
            "mean_nm": self.mean.tolist(),
            "std_nm": self.std.tolist(),
        }


@dataclass(frozen=True, slots=True)
class NearestForm:
    """A form of the library and the share of the class's visible energy that it can take, 0 … 1."""

    effect: str
    share: float


@dataclass(frozen=True, slots=True, eq=False)
class ClassClaim:
    """One claim: a torque on a joint that depends on this, whatever its form.

    name: class name of contract §6. joint: from 1. rms_nm: of the part that base parameters cannot take up, on the
    fitted rows, with its 95 % interval. significance: nats of evidence lost without it. heldout_gain_nm: (n,) Nm, RMS
    without it minus RMS with it on held-out rows, all weights from the fitted ones, at most what all classes bring;
    empty without any. alternatives: classes that could stand in its place. named: the names that stand on the joint
    leave nothing of it.
    """

    name: str
    joint: int
    rms_nm: float
    interval_nm: tuple[float, float]
    significance: float
    heldout_gain_nm: FloatArray
    alternatives: tuple[str, ...]
    nearest_forms: tuple[NearestForm, ...]
    sentence: str
    curve: ClassCurve | None = None
    named: bool = False

    def to_json(self) -> dict[str, Any]:
        """The claim as contract §6 has it, with its curve."""
        return {
            "class": self.name,
            "joint": self.joint,
            "rms_nm": _number(self.rms_nm),
            "ci95_nm": [_number(value) for value in self.interval_nm],
            "significance": _number(self.significance),
            "heldout_gain_nm": [_number(float(value)) for value in self.heldout_gain_nm],
            "alternatives": list(self.alternatives),
            "nearest_forms": [{"effect": form.effect, "share": _number(form.share)} for form in self.nearest_forms],
            "named": self.named,
            "sentence": self.sentence,
            "curve": None if self.curve is None else self.curve.to_json(),
        }


@dataclass(frozen=True, slots=True, eq=False)
class ClassModel:
    """All classes together, no name beside them: RMS of the fit without them and with them, per joint.

    fitted_before, fitted_after, heldout_before, heldout_after: (n,) Nm; the held-out ones empty without held-out rows.
    """

    fitted_before: FloatArray
    fitted_after: FloatArray
    heldout_before: FloatArray
    heldout_after: FloatArray

    def to_json(self) -> dict[str, Any]:
        """Plain JSON types."""
        return {
            name: [_number(float(value)) for value in getattr(self, key)]
            for name, key in (
                ("fit_before_nm", "fitted_before"),
                ("fit_after_nm", "fitted_after"),
                ("heldout_before_nm", "heldout_before"),
                ("heldout_after_nm", "heldout_after"),
            )
        }


@dataclass(frozen=True, slots=True, eq=False)
class Offer:
    """Class terms for `model.json`, base parameters (p,) fitted beside them with deviations, RMS (n,) Nm."""

    terms: Mapping[str, Any]
    base: FloatArray
    std: FloatArray
    fitted_rms: FloatArray
    heldout_rms: FloatArray


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None
