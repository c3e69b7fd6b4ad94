"""What is said of a class: its size with an interval, how sure, what else it could be, its curve, in words.

Value objects and their JSON (contract §6, `classes`); nothing is decided here. Built by `judgement`, read by the
findings and the report.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from identification.arrays import FloatArray
from identification.json_values import json_list, number, plain


@dataclass(frozen=True, slots=True, eq=False)
class ClassCurve:
    """Torque of a class over its own variable: mean ± std, Nm, (B,) each; place: in `unit`, within its range."""

    coordinate: str
    unit: str
    place: FloatArray
    mean_nm: FloatArray
    std_nm: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class AngleCurve:
    """By what a joint's true angle is more than the measured one: mean ± std, rad, (B,) each."""

    coordinate: str
    unit: str
    place: FloatArray
    mean_rad: FloatArray
    std_rad: FloatArray


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
    leave nothing of it. angle: it is the joint's angle that depends on this, and is not the measured one; then rms_nm
    is of the joint that this shows on most, and shows_on (from 1) are all that it shows on.
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
    curve: ClassCurve | AngleCurve | None = None
    named: bool = False
    angle: bool = False
    shows_on: tuple[int, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """The claim as contract §6 has it, with its curve."""
        return {
            "class": self.name,
            "joint": self.joint,
            "rms_nm": number(self.rms_nm),
            "ci95_nm": json_list(self.interval_nm),
            "significance": number(self.significance),
            "heldout_gain_nm": json_list(self.heldout_gain_nm),
            "alternatives": list(self.alternatives),
            "nearest_forms": plain(self.nearest_forms),
            "named": self.named,
            "angle": self.angle,
            "shows_on": list(self.shows_on),
            "sentence": self.sentence,
            "curve": plain(self.curve),
        }


@dataclass(frozen=True, slots=True, eq=False)
class ClassModel:
    """All classes together, no name beside them: RMS of the fit without them and with them, per joint.

    Each (n,) Nm; the held-out ones are empty without held-out rows.
    """

    fit_before_nm: FloatArray
    fit_after_nm: FloatArray
    heldout_before_nm: FloatArray
    heldout_after_nm: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Offer:
    """Class terms for `model.json`, base parameters (p,) fitted beside them with deviations, RMS (n,) Nm."""

    terms: Mapping[str, Any]
    base: FloatArray
    std: FloatArray
    fitted_rms: FloatArray
    heldout_rms: FloatArray
